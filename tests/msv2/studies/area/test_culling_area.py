"""The comparison of one culling pipeline with several units: its report, and its table in the documents."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")
from msv2.studies.area import culling
from spec.config import PAPER


def rows() -> dict[tuple[str, int], dict]:
    return {(row["part"], row["units"]): row for row in json.loads(culling.REPORT.read_text())["rows"]}


def test_the_table_is_the_reports() -> None:
    assert culling.fill(culling.PAGE, culling.REPORT, check=True) == 0, "run: make results ONLY=culling_area KEEP=1"


def test_a_changed_number_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    shutil.copy(culling.PAGE, page)
    text = page.read_text()
    page.write_text(text.replace("| 1 | 1 |", "| 1 | 2 |"))
    assert culling.fill(page, culling.REPORT, check=True) == 1
    assert culling.fill(page, culling.REPORT) == 0 and page.read_text() == text


def test_rows_have_one_throughput() -> None:
    """Units over cycles is the same in all rows of a part, and nothing that works all the time becomes fewer by sharing."""
    found = rows()
    for part, of in culling.PARTS.items():
        for units in (1, 2, 4, 8):
            row, one = found[part, units], found[part, 1]
            assert row["interval"] == units * one["interval"] == units * of.interval(PAPER)
            assert row["operators"] >= one["operators"] and row["nand2_equivalents"] > 0


def test_the_machine_has_what_needs_least() -> None:
    """PAPER's units are the first row of each part: fewest gates."""
    found = rows()
    for part in culling.PARTS:
        assert min((found[part, units]["nand2_equivalents"], units) for units in (1, 2, 4, 8))[1] == 1


def test_counts_are_those_of_the_units_of_today() -> None:
    """Operators, registers and multiplexers by the schedule, which need no synthesis."""
    for part, of in culling.PARTS.items():
        for machine, units in zip(culling.machines(PAPER), (1, 2, 4, 8), strict=True):
            counts, row = of.counts(machine), rows()[part, units]
            assert row["register_bits"] == units * counts.register_bits and row["mux_bits"] == units * counts.mux_bits
            assert row["operators"] == units * (sum(counts.operators.values()) + of.sums(machine))
