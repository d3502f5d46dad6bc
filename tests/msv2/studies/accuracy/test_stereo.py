"""Depths and disparities against the oracle."""

from __future__ import annotations

import json

from msv2.studies.accuracy import stereo


def test_the_report_of_depths(tmp_path):
    stereo.main([str(a) for a in ("embedded", "--size", "128x72", "--views", "3", "--out", tmp_path)][1:])
    rows = json.loads((tmp_path / "accuracy_stereo.json").read_text())["rows"]
    mine = [r for r in rows if r["scene"] == "embedded"]
    assert [r["levels"] for r in mine] == [1, 4]
    assert all(0.99 < r["within_budget"] <= 1 and 0.5 < r["depth_within"] <= 1 for r in mine)
    assert (tmp_path / "accuracy_stereo.md").read_text().count("| embedded, embedded_03 |") == 2
