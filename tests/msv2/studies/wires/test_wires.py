"""The study of placed units: its sums, its page, its command line, and that what the project assumes is what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from msv2.studies.wires import study
from msv2.studies.wires.page import page
from spec.errors import InputError
from spec.paths import REPORTS
from synth.physical.clock_tree import ClockTree
from synth.physical.parasitics import ASAP7_WIRES
from synth.physical.wired import Wired

KEPT = REPORTS / "wires.json"


def wired(unit: str, wire_ff: float, slack: float, wired_slack: float) -> Wired:
    return Wired(unit, 10, 4, 5.0, 6.25, 0.8, 12, 100.0, wire_ff, 50.0, slack, wired_slack, 1000.0,
                 ClockTree(4, 1, 8.0, 1.0, 2.0, 3.0), 12.0)


def test_sums_over_units() -> None:
    rows = [study.row(wired("a", 10.0, 0.0, -20.0)), study.row(wired("b", 20.0, 100.0, 91.0))]
    assert [row["derate"] for row in rows] == [1.02, 1.01] and rows[0]["wire_share"] == 0.2 and rows[0]["tree_share"] == 0.25
    assert study.overall(rows) == {"derate": 1.02, "wire_share": 0.3, "tree_share": 0.25}
    text = page({**study.overall(rows), "wires": vars(ASAP7_WIRES), "units": rows})
    assert "| `a` |" in text and "grows by 2.0 %" in text


def test_bad_arguments_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="units nothing are not known: pixel_core"):
        study.main(["--unit", "nothing", "--out", str(tmp_path)])
    monkeypatch.delenv("MSV2_PDK", raising=False)
    with pytest.raises(InputError, match="--lef must name"):
        study.lef_file(None)
    monkeypatch.setattr(study.placement, "available", lambda: False)
    with pytest.raises(InputError, match="coloquinte is not installed; the extra 'place' has it"):
        study.main(["--out", str(tmp_path)])


def test_the_kept_report_is_of_all_units() -> None:
    report = json.loads(KEPT.read_text())
    assert [row["unit"] for row in report["units"]] == list(study.PLACED)
    assert study.overall(report["units"]) == {key: report[key] for key in ("derate", "wire_share", "tree_share")}
