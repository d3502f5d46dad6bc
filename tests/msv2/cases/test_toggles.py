"""Coverage: Verilator's counts are read, merged and told by name, and a suite's quick runs are counted."""

from __future__ import annotations

from pathlib import Path

import pytest

from msv2.cases import toggles
from msv2.cases.mutants.targets import named
from msv2.studies.coverage import study
from spec.errors import InputError


def point(module: str, name: str, count: int, kind: str = "toggle") -> str:
    fields = {"f": "/a/dut.v", "l": "2", "t": kind, "page": f"v_toggle/{module}", "o": name, "h": "tb.dut"}
    return "C '" + "".join(f"\1{key}\2{value}" for key, value in fields.items()) + f"' {count}\n"


LINES = ["# SystemC::Coverage-3\n", *(point(*each) for each in (
    ("unit", "sums[0]:0->1", 3), ("unit", "sums[0]:1->0", 2), ("unit", "sums[1]:0->1", 1), ("unit", "sums[1]:1->0", 0),
    ("unit", "sums[2]:0->1", 0), ("unit", "sums[2]:1->0", 0), ("unit", "sums[4]:0->1", 0), ("unit", "valid:0->1", 1),
    ("unit", "valid:1->0", 1), ("unit", "__02412[0]:0->1", 0), ("unit", "item___05Fpayload__02ecount[1]:0->1", 0),
    ("unit", "item___05Fpayload[1]:0->1", 1), ("unit", "item___05Fpayload[1]:1->0", 0), ("unit.inner", "__024like[3]:0->1", 0),
    ("tb", "over:0->1", 0))), point("unit", "sums[5]:0->1", 0, "line")]


def test_a_bit_is_covered_that_rises_and_falls():
    assert toggles.merged(LINES) == {
        ("unit", "sums", 0): True, ("unit", "sums", 1): False, ("unit", "sums", 2): False, ("unit", "sums", 4): False,
        ("unit", "valid", 0): True, ("unit", "item__payload", 1): False, ("unit.inner", "$like", 3): False}


def test_runs_of_several_suites_are_merged():
    again = [point("unit", "sums[1]:1->0", 4), point("unit", "sums[2]:0->1", 4)]
    found = toggles.merged([*LINES, *again])
    assert found["unit", "sums", 1] and not found["unit", "sums", 2]


def test_holes_are_ranges_of_bits():
    assert toggles.holes(toggles.merged(LINES)) == [
        "unit: item__payload[1]", "unit: sums[4, 2:1]", "unit.inner: $like[3]"]


@pytest.mark.slow
@pytest.mark.rtl
def test_a_unit_by_itself(tmp_path: Path):
    """Most bits of the handover change, and its strobes do."""
    found = toggles.toggles_of(named("handover"), tmp_path)
    assert sum(found.values()) > 0.8 * len(found) > 50
    assert all(found[key] for key in found if key[1] in ("sink__valid", "sink__ready", "source__valid", "source__ready"))


def test_the_page_has_every_unit_and_hole():
    rows = [{"unit": "a", "machine": "tiny", "bits": 10, "covered": 9, "holes": ["a: x[3]"]},
            {"unit": "b", "machine": "tiny", "bits": 10, "covered": 10, "holes": []}]
    assert study.total(rows) == {"bits": 20, "covered": 19, "share": 0.95}
    text = study.pages(rows)
    assert "19 of 20 bits of 2 units are covered (95.0 %)" in text and "| a | `a: x[3]` |" in text


def test_an_unknown_unit_lists_the_others():
    with pytest.raises(InputError, match="chunk_sorter"):
        study.main(["--unit", "chunk_sorted"])
