"""Writes that waiting beats save: the count, and where its numbers are quoted."""

import re

import numpy as np
import pytest

from msv2.studies.scenes import View
from msv2.studies.write_combining import study
from msv2.studies.write_combining.study import saved_writes
from rtl.tile_lists.entry_writer import IntersectionWriter
from spec.memory import BEAT_ENTRIES
from spec.paths import ROOT

REPORT = ROOT / "reports" / "write_combining.md"


@pytest.mark.parametrize(("tile", "lines", "saved"), [
    ([], 1, 0),
    ([3], 4, 0),
    ([3, 3, 3, 3, 3, 3], 4, 4),  # two beats, of four entries and of two
    ([0, 1, 0, 1, 0], 2, 3),
    ([0, 1, 0, 1, 0], 1, 0),  # each sends the other's beat away
    ([0, 2, 0, 2, 0], 2, 0),
    ([0, 2, 2, 1, 0, 0, 2], 2, 2),
    ([5, 5, 5, 1, 5, 5, 5], 4, 3),  # a beat that comes back is filled to its end: its fourth entry alone, then two
])
def test_saved_writes_by_hand(tile, lines, saved):
    assert saved_writes(np.array(tile, np.int64), lines) == saved


@pytest.mark.parametrize("lines", [1, 2, 8, 64])
def test_saved_writes_are_those_of_lines_that_are_filled_and_sent(lines):
    tile = np.random.default_rng(lines).integers(0, 40, 3000) ** 2 // 40
    waiting, count, writes = {}, dict.fromkeys(range(40), 0), 0
    for t in tile.tolist():
        beat = (t, count[t] // BEAT_ENTRIES)
        if waiting.get(t % lines) != beat:
            writes += t % lines in waiting
            waiting[t % lines] = beat
        count[t] += 1
    assert saved_writes(tile, lines) == len(tile) - writes - len(waiting)


def shares(report: str) -> dict[str, dict[int, int]]:
    """Percentages of a report, by frame and lines."""
    rows = re.findall(r"^\| (\w+ \d+x\d+) \|(.*)$", report, re.MULTILINE)
    return {name: dict(zip(study.LINES, map(int, re.findall(r"(\d+) %", rest)), strict=True)) for name, rest in rows}


def test_docs_quote_the_report():
    of_frame, root = shares(REPORT.read_text()), REPORT.parents[1]
    assert list(of_frame) == [f"{view.scene} {view.size}" for view in study.FRAMES]
    assert str(REPORT.relative_to(root)) in IntersectionWriter.__doc__
    truck = of_frame["truck 1920x1080"]
    sentence = f"with 1,024 lines (32 KB) this saves {truck[1024]} % of truck's writes at 1080p, with 64 lines {truck[64]} %"
    assert sentence in " ".join((root / "docs" / "machine.md").read_text().split())


def test_the_report_is_what_the_command_writes(monkeypatch, tmp_path):
    """For the frame that needs no data and little time. Its number of entries is not compared: by one or two it depends on the
    CPU, whose vector instructions give the last bits of the scene's scales and rotations."""
    monkeypatch.setattr(study, "FRAMES", (View("embedded", "640x360"),))
    assert study.main(["--out", str(tmp_path / "report.md")]) == 0
    text, report = (tmp_path / "report.md").read_text(), REPORT.read_text()
    *head, row = text.splitlines()
    assert head == report.splitlines()[: len(head)] and "embedded 640x360" in row
    assert shares(text)["embedded 640x360"] == shares(report)["embedded 640x360"]


def test_frames_without_their_scene_are_left_out(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    monkeypatch.setattr(study, "FRAMES", (View("embedded", "64x48"), View("truck", "64x48")))
    out = tmp_path / "report.md"
    assert study.main(["--out", str(out)]) == 0 and "1 frames" in capsys.readouterr().out
    ((name, row),) = shares(out.read_text()).items()
    assert name == "embedded 64x48" and row[64] == row[4096] > 0  # 12 tiles: a line each
