"""What accuracy buys on v3: reduced models, the choice within a loss, the page."""

import json

import numpy as np
import pytest

from msv2.studies.presets import measure, page, study
from spec.constants import SH_C0
from tests.helpers.golden_samples import random_model


def row(choice, cycles, loss, scene="a"):
    return {"scene": scene, "choice": choice, "degree": 3, "points": 1.0, "psnr_db": None if not loss else 40.0,
            "psnr_photo_db": None, "loss_db": loss, "cycles": cycles, "ideal_cycles": cycles / 2}


def test_the_fastest_choice_within_each_loss_counts():
    rows = [row("exact", 100.0, 0.0), row("degree 0", 70.0, 0.09), row("support radius 2", 10.0, 0.0), row("less", 50.0, 0.4),
            row("too much", 20.0, 0.6)]
    found = {goal["goal"]: (goal["choice"], goal["reached"]) for goal in page.goals(rows)}
    assert found == {"a: balanced, 0.1 dB": ("degree 0", True), "a: fast, 0.5 dB": ("less", True),
                     "geometric mean: balanced, 0.1 dB": ("as above", True), "geometric mean: fast, 0.5 dB": ("as above", True)}
    both = [*rows, *(r | {"scene": "b", "cycles": 100.0} for r in rows)]
    assert page.goals(both)[-1]["found"] == pytest.approx(2**0.5) and not page.goals(both)[-1]["reached"]
    assert [r["choice"] for r in page.frontier(rows)] == ["support radius 2"]
    slower = [r | {"cycles": 90.0} if r["choice"] == "degree 0" else r for r in rows]
    assert not page.goals(slower)[0]["reached"]


@pytest.fixture(scope="module")
def model():
    return random_model(np.random.default_rng(5), 300, levels=1, sh=3)


def test_points_that_contribute_least_for_their_work_go_first(model):
    seen = measure.Shown(np.arange(300.0), np.full(300, 2), np.full((300, 3), 0.75))
    half = measure.reduced(model, measure.Choice("x", kept=0.5), seen)
    assert np.array_equal(half.means, model.means[150:]) and half.sh_degree == 3
    unseen = measure.Shown(seen.weight, np.where(np.arange(300) < 10, 0, 2), seen.colour)
    assert np.array_equal(measure.reduced(model, measure.Choice("x", kept=0.5), unseen).means[:10], model.means[:10])


def test_averaged_base_colours_are_those_of_the_pictures(model):
    seen = measure.Shown(np.append(np.ones(299), 0), np.ones(300, int), np.full((300, 3), 0.75))
    flat = measure.reduced(model, measure.Choice("x", degree=0, averaged=True), seen)
    assert flat.sh_degree == 0 and np.allclose(flat.sh_dc[:299, 0] * SH_C0 + 0.5, 0.75)
    assert np.array_equal(flat.sh_dc[299], model.sh_dc[299])


def test_pictures_without_harmonics_show_the_base_colours(model):
    flat = model.with_sh_degree(0)
    seen = measure.shown(flat)
    there = seen.weight > 0
    assert there.any() and np.allclose(seen.colour[there], np.maximum(flat.sh_dc[there, 0] * SH_C0 + 0.5, 0), atol=1e-4)
    assert (seen.work[there] > 0).all()


def test_a_small_run_has_every_choice_and_says_what_is_missed(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "CHOICES", measure.CHOICES[:7])
    monkeypatch.setattr(measure.rows, "__defaults__", (measure.CHOICES,))
    assert study.main(["embedded", "--size", "64x48", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "presets.json").read_text())
    found = {r["choice"]: r for r in content["rows"]}
    assert found["exact"]["loss_db"] == 0 and found["exact"]["psnr_db"] is None
    assert found["degree 2"]["cycles"] == found["exact"]["cycles"] > found["degree 0"]["cycles"]
    assert found["degree 0"]["loss_db"] > found["degree 2"]["loss_db"] > 0
    assert {r["degree"] for r in content["foveated"]} == {0, 1, 2, 3}
    text = (tmp_path / "presets.md").read_text()
    assert "**no**" in text and "## Frames of four levels by SH degree" in text
