"""The study of memories by size: its totals follow from its rows, and the kept report is of today's machines."""

from __future__ import annotations

import json

import pytest

from msv2.studies.area.estimate import estimate_area
from msv2.studies.memory_sizes.study import MACHINES, machine_row, page
from spec.paths import REPORTS
from synth.macro_sizes import ANCHORED, SCALED, SizedMacro

TABLE = SizedMacro(64, 32, 2048.0, 200.0), SizedMacro(1024, 32, 16384.0, 300.0)


def test_a_row_adds_up() -> None:
    config = MACHINES["v3"]
    row = machine_row("v3", config, TABLE)
    for way in ("flat", ANCHORED, SCALED):
        assert row["memory_mm2"][way] == pytest.approx(sum(store[f"{way}_um2"] for store in row["memories"]) / 1e6, abs=1e-4)
    assert row["mm2"]["flat"] == pytest.approx(estimate_area(config).mm2, abs=1e-4)
    assert row["mm2"][ANCHORED] - row["mm2"]["flat"] == pytest.approx(
        row["memory_mm2"][ANCHORED] - row["memory_mm2"]["flat"], abs=2e-4)
    assert row["memory_mm2"][ANCHORED] > row["memory_mm2"]["flat"]


def test_the_kept_report() -> None:
    report = json.loads((REPORTS / "memory_sizes.json").read_text())
    assert [row["machine"] for row in report["machines"]] == list(MACHINES)
    for row in report["machines"]:
        # Without the macros' files the estimate is off by 0.2 %.
        assert row["mm2"]["flat"] == pytest.approx(estimate_area(MACHINES[row["machine"]]).mm2, rel=5e-3)
    assert (REPORTS / "memory_sizes.md").read_text() == page(report)
