"""The pages of the tradeoff study: what they open with, what they say a decibel costs, crops, and labels that can be read."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra `plots`")

from matplotlib import pyplot

from msv2.studies.labels import overlapping
from msv2.studies.tradeoff import crops, frontiers, plot, report
from msv2.studies.tradeoff import study as command
from msv2.studies.web.check import markdown_problems, problems
from spec.paths import REPORTS

NAMES = ("tradeoff", "tradeoff_truck")


@pytest.fixture(autouse=True)
def close_figures():
    yield
    pyplot.close("all")


def kept(name: str) -> dict:
    return json.loads((REPORTS / f"{name}.json").read_text())


@pytest.mark.parametrize("name", NAMES)
def test_labels_of_the_diagrams_do_not_overlap(name):
    content = kept(name)
    for frontier in frontiers.frontiers(content):
        figure = plot.draw(frontier)
        assert overlapping(figure) == [], frontier.name
        words = {text.get_text() for text in figure.axes[0].texts}
        assert {mark.name for mark in frontier.marks} == words and 2 <= len(words) <= frontiers.MOST_LABELS
    for picture, part in report.DETAILS.items():
        if content[part]:
            assert overlapping(plot.details(picture, content)) == [], picture


@pytest.mark.parametrize("name", NAMES)
def test_kept_pages_are_those_of_the_kept_numbers_and_have_no_fault(name):
    page = REPORTS / f"{name}.html"
    assert problems(page) == [] and markdown_problems(REPORTS / f"{name}.md") == []
    text, content = page.read_text(), kept(name)
    for frontier in frontiers.frontiers(content):
        assert frontier.cost in text and frontier.cost in (REPORTS / f"{name}.md").read_text()
    opening = text[text.index('id="summary"') : text.index("<section>")]
    assert "<table" not in opening and opening.count("<figure>") > 2  # frontiers and crops, and no row of the tables


def test_the_document_opens_with_the_answer_of_the_kept_report():
    assert report.fill_document(kept("tradeoff"), check=True) == 0, \
        "run: msv2 study run tradeoff --pages reports/tradeoff.json --out reports"
    text = report.DOCUMENT.read_text()
    assert markdown_problems(report.DOCUMENT) == [] and text.index("table:answer") < 600


def test_a_changed_number_changes_the_answer():
    content = kept("tradeoff")
    default = next(row for row in content["machine"] if row["knob"] == "default")
    default["cycles"] *= 2
    assert report.fill_document(content, check=True) == 1


def test_a_decibel_of_the_machine_costs_what_the_rows_say():
    content = kept("tradeoff")
    rows = {(row["knob"], row["value"]): row for row in content["machine"]}
    default, levels = rows["default", ""], rows["levels", "4, untrained"]
    price = (default["cycles"] - levels["cycles"]) / 1e3 / levels["loss_db"]
    machine = frontiers.frontiers(content)[0]
    assert float(re.search(r"about ([\d.]+) µs", machine.cost)[1]) == pytest.approx(price, abs=0.05)
    marks = {mark.name: mark for mark in machine.marks}
    assert marks["4 levels, untrained"].time == pytest.approx(levels["cycles"] / 1e3)
    assert marks["model H, trained levels"].other and not marks["preset fast"].front


def test_without_a_gain_nothing_is_promised():
    content = kept("tradeoff")
    content["machine"] = [row for row in content["machine"] if row["knob"] == "default"]
    content["training"] = []
    found = frontiers.frontiers(content)
    assert [one.name for one in found] == ["machine", "simulation"] and found[0].cost.startswith("No setting buys time")


def test_the_last_decibel_of_training_is_the_dearest():
    content = kept("tradeoff")
    seconds = [1.0, 2.0, 4.0, 8.0, 16.0]
    stages = [{"stage": "dense", "level": 1, "psnr": 20.0, "seconds": 16.0, "entries": 100.0},
              {"stage": "finetune", "level": 1, "psnr": 19.5, "seconds": 20.0, "entries": 60.0}]
    content["training"] = [{"scene": "x", "variant": "H", "stages": stages, "curve": {
        "iteration": [1, 2, 3, 4, 5], "seconds": seconds, "psnr": [10.0, 12.0, 14.0, 19.0, 20.0], "points": [1] * 5}}]
    training = frontiers.frontiers(content)[2]
    assert "The last decibel takes 8 s of the 16 s" in training.cost and "gains 9.0 dB" in training.cost
    assert "4 s more and trades 0.5 dB of test views for 40 % fewer" in training.more
    assert [mark.time for mark in training.marks] == seconds


def test_crops_are_taken_where_pictures_differ_most():
    one = np.zeros((50, 60, 3))
    other = one.copy()
    other[30:36, 41:47] = 1.0
    x, y = crops.largest_difference(one, other, (10, 10))
    assert x <= 41 and x + 10 >= 47 and y <= 30 and y + 10 >= 36
    made = crops.sheet([crops.Crop(np.full((8, 12, 3), i, np.uint8), "") for i in range(4)])
    assert made.size == (3 * 12 + 2 * 4, 2 * 8 + 4) and made.getpixel((13, 0)) == (255, 255, 255)


def test_pages_of_a_kept_report_are_written_without_measuring(tmp_path, monkeypatch):
    content = kept("tradeoff")
    asked = []
    monkeypatch.setattr(crops, "crops", lambda content, path, variants: asked.append(path) or [
        crops.Crop(np.zeros((9, 12, 3), np.uint8), "the paper's machine: 1 µs")] * 3)
    monkeypatch.setattr(command, "machine", lambda *_: pytest.fail("measured"))
    argv = ["--pages", str(REPORTS / "tradeoff.json"), "--out", str(tmp_path), "--name", "x"]
    assert command.main(argv) == 0 and asked == ["embedded"]
    assert problems(tmp_path / "x.html") == [] and (tmp_path / "x_crops.png").is_file()
    assert not (tmp_path / "x.json").exists() and content == kept("tradeoff")
    monkeypatch.setattr(crops, "crops", lambda *_: pytest.fail("another scene"))
    assert command.main(["other.ply", *argv]) == 0


@pytest.mark.long
def test_crops_of_the_embedded_scene_show_what_settings_change(tmp_path):
    made = crops.crops(kept("tradeoff"), "embedded", size="192x108")
    assert [crop.caption.partition(":")[0] for crop in made] == [
        crops.ORIGINALS[True], "the paper's machine", "harmonics of degree 2", crops.ORIGINALS[True], "the paper's machine",
        "4 levels, untrained"]
    distance = [np.abs(one.pixels.astype(float) - other.pixels).mean() for one, other in (made[1:3], made[4:6])]
    assert 0 < distance[0] < distance[1]


