"""Shares that are measured on placed units, and the range that they and a second library give a frame's energy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msv2.studies.energy import estimates as module
from msv2.studies.energy.estimates import Estimates, Share, estimates
from msv2.studies.energy.frame import EnergyReport, EnergyRow, WorkCounts
from spec.errors import InputError

ROWS = {("unit", "dynamic"): 4.0, ("unit", "clock"): 2.0, ("unit", "sram"): 1.0, ("unit", "leakage"): 0.5,
        ("dram: reads", "dram"): 10.0, ("assumed: wires", "assumed"): 0.3, ("assumed: clock tree", "assumed"): 0.4}


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch) -> EnergyReport:
    known = Estimates(Share(0.3, 0.2, 0.4), Share(0.2, 0.1, 0.3), Share(0.3, 0.25, 0.35))
    monkeypatch.setattr("msv2.studies.energy.frame.estimates", lambda: known)
    rows = tuple(EnergyRow(unit, part, mj, 1, "", 1.0, "", "", "") for (unit, part), mj in ROWS.items())
    return EnergyReport(rows, 100, 1e9, WorkCounts())


def test_both_anchors_and_the_range_by_hand(report: EnergyReport) -> None:
    assert report.chip_mj == pytest.approx(7.5)
    assert report.other_chip_mj == pytest.approx(1.5 + 0.3 * 6.0)
    low, high = report.range_mj
    assert low == pytest.approx(11.5 + 0.25 * (6.0 + 0.3 * 0.2 / 0.3 + 0.4 * 0.1 / 0.2))
    assert high == pytest.approx(11.5 + 6.0 + 0.3 * 0.4 / 0.3 + 0.4 * 0.3 / 0.2)
    assert low < report.total_mj < high and report.as_json()["range_mj"] == [low, high]


def test_the_kept_reports_are_read() -> None:
    found = estimates()
    for share in (found.wires, found.clock_tree, found.anchor):
        assert 0 < share.low <= share.value <= share.high < 1


def test_a_missing_report_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "wires.json"
    for text in (None, "{", json.dumps({"units": []})):
        if text is not None:
            broken.write_text(text)
        monkeypatch.setattr(module, "WIRES", broken)
        with pytest.raises(InputError, match=r"wires\.json and energy_anchors\.json"):
            estimates.__wrapped__()
