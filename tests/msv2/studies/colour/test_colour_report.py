"""Errors and costs of colours: their report, and its tables in docs/colour.md."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from msv2.studies.area import culling
from msv2.studies.colour import study
from msv2.studies.colour.study import PAGE, REPORT, fill
from spec.config import MACHINES, PAPER
from spec.errors import InputError
from spec.paths import ROOT


@pytest.fixture(scope="module")
def report() -> dict:
    return json.loads(REPORT.read_text())


def test_the_page_is_the_reports() -> None:
    assert fill(PAGE, REPORT, check=True) == 0, "run: make results ONLY=colour KEEP=1"


@pytest.mark.parametrize("name", study.TABLES)
def test_a_changed_number_is_noticed(name: str, tmp_path: Path) -> None:
    """The last digit of each table."""
    page, text = tmp_path / "page.md", PAGE.read_text()
    table = re.search(rf"<!-- table:{name} -->\n(.*?)\n<!-- end -->", text, flags=re.S)[1]
    at = text.index(table) + max(found.start() for found in re.finditer(r"\d", table))
    page.write_text(text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :])
    assert fill(page, REPORT, check=True) == 1
    assert fill(page, REPORT) == 0 and page.read_text() == text


def test_a_changed_report_is_noticed(tmp_path: Path, report: dict) -> None:
    page, changed = tmp_path / "page.md", tmp_path / "colour.json"
    shutil.copy(PAGE, page)
    report["cost"][-1]["nand2_equivalents"] += 1
    changed.write_text(json.dumps(report))
    report["cost"][-1]["nand2_equivalents"] -= 1
    assert fill(page, changed, check=True) == 1 and page.read_text() == PAGE.read_text()


def test_a_page_without_a_table_is_rejected(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE.read_text().replace("table:colour_errors", "table:colours"))
    with pytest.raises(InputError, match="colour_errors"):
        fill(page, REPORT)


def test_errors_are_those_of_the_renderer_of_today(report: dict) -> None:
    assert report["errors"] == study.error_rows()


def test_more_bits_are_nearer_to_exact(report: dict) -> None:
    rms = [row["rms"] for row in report["errors"]]
    assert rms == sorted(rms, reverse=True) and rms[-1] == pytest.approx(12**-0.5, abs=5e-4)
    assert report["errors"][-1]["largest"] <= 0.5


def test_what_the_format_says_of_its_errors(report: dict) -> None:
    """The rounded numbers in `spec.config`'s words."""
    rms = {row["fraction"]: row["rms"] for row in report["errors"]}
    words = next(line for line in (ROOT / "docs" / "formats.md").read_text().splitlines() if line.startswith("| `sh_basis`"))
    used = PAPER.formats.sh_basis.frac_bits
    assert (f"With {used} fraction bits here the whole error is {rms[used]:.3f} ulps; with {used - 1} it is "
            f"{rms[used - 1]:.3f}.") in words


def test_counts_are_those_of_the_units_of_today(report: dict) -> None:
    """Everything that needs no synthesis."""
    assert report["functions"] == study.function_rows() and report["operand_bits"] == study.operand_bits()
    assert len(report["cost"]) == len(study.PARTS) * len(study.MACHINES)
    for row in report["cost"]:
        config = MACHINES[row["config"]]
        assert row["interval"] == study.splat_interval(config)
        assert row["multipliers"] == study.multipliers(config)[row["part"]]
        if row["register_bits"] is not None:
            assert row["register_bits"] == study.counts(config).register_bits


def test_the_unit_is_the_one_that_culling_compares(report: dict) -> None:
    """One unit at an interval has one size, in whichever report."""
    rows = {row["interval"]: row for row in json.loads(culling.REPORT.read_text())["rows"] if row["part"] == "colour_unit"}
    units = [row for row in report["cost"] if row["part"] == "colour_unit"]
    assert [row["config"] for row in units] == [config.name for config in study.MACHINES]
    for row in units:
        there = rows[row["interval"]]
        for key in ("flip_flops", "memory_bits", "nand2_equivalents", "register_bits"):
            assert there[key] == there["units"] * row[key], (row["config"], key)
        assert there["operators"] == there["units"] * row["multipliers"]
