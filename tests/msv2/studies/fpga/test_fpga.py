"""What units take on FPGAs: cells are counted by column, limits end a synthesis and are reported, the page is the report's."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from msv2.studies.fpga import study
from msv2.studies.fpga.measure import COLUMNS, CPU_SECONDS, FAMILIES, MEMORY_GB
from rtl.units import UNITS
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

needs_yosys = pytest.mark.skipif(study.flow.libyosys is None, reason="needs the extra `synth`")


def test_cells_are_counted_by_column() -> None:
    ecp5 = {"LUT4": 10, "CCU2C": 3, "PFUMX": 5, "TRELLIS_FF": 7, "TRELLIS_DPR16X4": 2, "DP16KD": 4, "MULT18X18D": 6}
    assert FAMILIES["ecp5"].count(ecp5) == {"lut": 16, "lut_ram": 12, "ff": 7, "bram": 4, "dsp": 6}
    xc7 = {"LUT2": 1, "LUT6": 2, "INV": 4, "CARRY4": 9, "FDRE": 3, "FDSE": 1, "RAM32M": 2, "RAMB18E1": 1, "RAMB36E1": 2,
           "DSP48E1": 5, "MUXF7": 8}
    assert FAMILIES["xc7"].count(xc7) == {"lut": 7, "lut_ram": 8, "ff": 4, "bram": 5, "dsp": 5}


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
def test_an_unknown_cell_is_no_nothing(family) -> None:
    with pytest.raises(ValueError, match=r"must be known, not \$mem_v2, X"):
        family.count({"X": 1, "$mem_v2": 1})


@needs_yosys
@pytest.mark.parametrize("family", FAMILIES)
def test_a_unit_is_synthesised(family: str, tmp_path: Path) -> None:
    """The product of two significands takes multipliers, and a conversion takes none; both have registers."""
    product, conversion = (study.synthesised(unit, "tiny", family, tmp_path) for unit in ("float_mul", "fixed_to_float"))
    assert product["dsp"] > 0 and conversion["dsp"] == 0
    for found in (product, conversion):
        assert found["lut"] > 0 and found["ff"] > 0 and found["bram"] == found["lut_ram"] == 0
        assert {name: found[name] for name in COLUMNS} == FAMILIES[family].count(found["cells"])


@needs_yosys
def test_a_limit_of_time_is_met(tmp_path: Path) -> None:
    """A second is too little for the projection unit."""
    program = ("import sys; from msv2.studies.fpga import measure; measure.CPU_SECONDS = 1; "
               "sys.exit(measure.main(sys.argv[1:]))")
    done = subprocess.run([sys.executable, "-c", program, "projection_unit", "tiny", "ecp5", str(tmp_path)], cwd=ROOT,
                          capture_output=True, text=True, check=False)
    assert done.returncode != 0 and study.failure(done.returncode, done.stdout + done.stderr) == study.LIMITED


def test_another_failure_is_no_limit() -> None:
    assert study.failure(1, "some\nERROR: Assert `x' failed in rtlil.cc\n") == (
        "the synthesis fails: ERROR: Assert `x' failed in rtlil.cc")
    assert study.failure(1, "") == "the synthesis fails: it says nothing"


@needs_yosys
def test_a_study_without_time_synthesises_nothing(tmp_path: Path) -> None:
    """A synthesis under way is ended, and what was not reached is not kept."""
    ask = ("float_add", "tiny", "xc7", "aaaa", tmp_path)
    assert study.kept(*ask, 0.0) == {"left_out": study.NOT_REACHED}
    begin = time.monotonic()
    assert study.kept(*ask, begin + 0.3) == {"left_out": study.NOT_REACHED} and time.monotonic() - begin < 60
    assert not list(tmp_path.glob("*.json"))
    with pytest.raises(InputError, match="minutes 0 is not accepted"):
        study.main(["--minutes", "0"])


def row(unit: str, config: str, lut: int | None, **more: object) -> study.Row:
    numbers = {"left_out": "too large"} if lut is None else {**dict.fromkeys(COLUMNS, 3), "lut": lut, "cells": {}}
    return {"unit": unit, "config": config, "ecp5": numbers, "xc7": numbers, **more}


def test_tables() -> None:
    rows = study.in_order([row("setup", "paper", 5), row("expand", "tiny", None), row("pixel_core", "tiny", 1234),
                           row("pixel_core", "paper", 1234, same_as="tiny")])
    assert [(one["unit"], one["config"]) for one in rows] == [
        ("pixel_core", "tiny"), ("expand", "tiny"), ("pixel_core", "paper"), ("setup", "paper")]
    tiny, paper = study.table(rows, "tiny").splitlines(), study.table(rows, "paper").splitlines()
    assert tiny[2:] == ["| `pixel_core` | 1,234 | 3 | 3 | 3 | 3 | 1,234 | 3 | 3 | 3 | 3 |"]
    assert paper[2:] == ["| `setup` | 5 | 3 | 3 | 3 | 3 | 5 | 3 | 3 | 3 | 3 |"]
    half = {**row("blend", "tiny", None), "xc7": row("blend", "tiny", 1)["xc7"]}
    assert study.left_out([*rows, row("collect", "tiny", None), half]).splitlines()[2:] == [
        "| tiny | both | `expand`, `collect` | too large |", "| tiny | ECP5 | `blend` | too large |"]
    assert study.left_out([]) == "No unit is left out."


@needs_yosys
def test_what_was_synthesised_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Under the netlist, and for the same commands and limits only."""
    found = [{"lut": 99, "cells": {"LUT4": 5}}, {"left_out": "too large"}, {"left_out": "again"}, {"left_out": "other limits"}]
    monkeypatch.setattr(study, "synthesised", lambda *what: found.pop(0))
    ask = ("setup", "tiny", "ecp5")
    assert study.kept(*ask, "aaaa", tmp_path)["lut"] == 99
    assert study.kept(*ask, "aaaa", tmp_path) == {**dict.fromkeys(COLUMNS, 0), "lut": 5, "cells": {"LUT4": 5}}
    assert study.kept(*ask, "bbbb", tmp_path) == study.kept(*ask, "bbbb", tmp_path) == {"left_out": "too large"}
    assert study.kept("setup", "tiny", "xc7", "bbbb", tmp_path) == {"left_out": "again"}
    monkeypatch.setattr(study, "CPU_SECONDS", 7)
    assert study.kept(*ask, "aaaa", tmp_path) == {"left_out": "other limits"} and not found


def test_the_same_unit_is_synthesised_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []
    monkeypatch.setattr(study, "kept", lambda *what: asked.append(what[:3]) or {"lut": 1})
    rows = study.measure(["float_add", "tile_merge_unit", "msv2_top"], tmp_path)
    assert asked.count(("float_add", "tiny", "ecp5")) == 1 and ("float_add", "paper", "ecp5") not in asked
    assert ("tile_merge_unit", "paper", "xc7") in asked and not [what for what in asked if what[0] == "msv2_top"]
    same = {(one["unit"], one["config"]): one.get("same_as") for one in rows}
    assert same == {("float_add", "tiny"): None, ("float_add", "paper"): "tiny", ("tile_merge_unit", "tiny"): None,
                    ("tile_merge_unit", "paper"): None, ("msv2_top", "tiny"): None, ("msv2_top", "paper"): None}


def test_an_unknown_unit_is_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'tile_merge_unit'"):
        study.main(["--unit", "tile_merge"])


def test_the_report_has_every_unit_and_the_page_is_the_reports() -> None:
    report = json.loads((REPORTS / "fpga.json").read_text())
    assert sorted((one["unit"], one["config"]) for one in report["rows"]) == sorted(
        (unit, config.name) for unit in UNITS for config in study.MACHINES)
    for one in report["rows"]:
        for name, family in FAMILIES.items():
            numbers = one[name]
            assert "left_out" in numbers or {key: numbers[key] for key in COLUMNS} == family.count(numbers["cells"])
    assert report["limits"] == {"cpu_seconds": CPU_SECONDS, "memory_gb": MEMORY_GB}
    assert study.main(["--check"]) == 0
    assert re.search(r"(?m)^\| `tile_merge_unit` \|", (ROOT / "docs" / "fpga.md").read_text())
