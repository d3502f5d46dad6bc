"""The energy of units by two libraries: capacitances are those of the liberty file, and the kept report adds up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msv2.studies.energy_anchors.study import VOLTAGES, page, pin_capacitances
from msv2.studies.wires.study import PLACED
from spec.paths import REPORTS
from synth.scaling import TO_16NM
from tests.helpers.small_machine import LIBERTY


def test_capacitances_of_cells(tmp_path: Path) -> None:
    path = tmp_path / "small.lib"
    path.write_text(LIBERTY)
    assert pin_capacitances(path)["DFF"] == 2.0  # its clock and its data


def test_the_kept_report_adds_up() -> None:
    report = json.loads((REPORTS / "energy_anchors.json").read_text())
    assert [row["unit"] for row in report["units"]] == list(PLACED)
    sums = dict.fromkeys(VOLTAGES, 0.0)
    for row in report["units"]:
        for name, volt in VOLTAGES.items():
            assert row[name]["fj_16nm"] == pytest.approx(row[name]["pin_ff"] * volt ** 2 * TO_16NM[name].energy, rel=1e-4)
            sums[name] += row[name]["fj_16nm"]
        assert row["ratio"] == pytest.approx(row["nangate45"]["fj_16nm"] / row["asap7"]["fj_16nm"], abs=1e-4)
    assert report["ratio"] == pytest.approx(sums["nangate45"] / sums["asap7"], abs=1e-4)
    assert (REPORTS / "energy_anchors.md").read_text() == page(report)
