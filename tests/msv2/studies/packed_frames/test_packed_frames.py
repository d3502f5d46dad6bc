"""The study of packed frames: its numbers by hand, and what its report says."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from msv2.studies.packed_frames import study
from msv2.studies.packed_frames.study import mean_ratio, measured
from msv2.studies.scenes import View
from spec.paths import ROOT

REPORT = ROOT / "reports" / "packed_frames.json"


def test_the_numbers_of_a_frame_by_hand() -> None:
    pixels = np.zeros((16, 40, 4), np.uint8)  # three tiles of blocks that take a beat each, and a beat of the table
    found = measured("black", "40x16", pixels)
    assert found == {"frame": "black", "size": "40x16", "display_bytes": 2560, "packed_bytes": 32 * 13, "ratio": 0.1625,
                     "table_bytes": 32, "blocks_by_size": [0, 12, 0, 0, 0, 0, 0, 0, 0]}


def test_a_frame_that_does_not_come_back_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "unpack_frame", lambda data, width, height: np.ones((height, width, 4), np.uint8))
    with pytest.raises(RuntimeError, match="black, 16x16: the packed frame does not come back"):
        measured("black", "16x16", np.zeros((16, 16, 4), np.uint8))


def test_means() -> None:
    rows = [{"size": "a", "ratio": 0.25}, {"size": "a", "ratio": 1.0}, {"size": "b", "ratio": 0.5}]
    assert mean_ratio(rows, "a") == pytest.approx(0.5) and mean_ratio(rows, "b") == 0.5 and math.isnan(mean_ratio(rows, "c"))


def test_the_command_writes_page_and_json(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(study, "FRAMES", (View("embedded", "48x32", "24,16"),))
    assert study.main(["--out", str(tmp_path / "packed_frames.md")]) == 0
    content = json.loads((tmp_path / "packed_frames.json").read_text())
    assert len(content["rows"]) == 1 and content["means"].keys() == {"48x32"}
    noise, plain = content["bounds"]
    assert 1 < noise["ratio"] <= 1.03 and plain["ratio"] < 0.15
    text = (tmp_path / "packed_frames.md").read_text()
    assert "| embedded | 48x32 |" in text and "| noise | 640x360 |" in text and "1 frames" in capsys.readouterr().out


def test_the_report_reaches_the_goals() -> None:
    content = json.loads(REPORT.read_text())
    assert content["means"]["1920x1080"] <= 0.45 and content["means"]["640x360"] <= 0.61
    assert all(row["ratio"] <= {"1920x1080": 0.47, "640x360": 0.61}[row["size"]] for row in content["rows"])
    assert len(content["rows"]) == 8 and content["bounds"][0]["ratio"] <= 1.03
