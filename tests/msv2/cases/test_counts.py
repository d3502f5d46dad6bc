"""Coverage: Verilator's counts are read, merged and told by name, and a suite's quick runs are counted."""

from __future__ import annotations

from pathlib import Path

import pytest

from msv2.cases import choices, toggles
from msv2.cases.choices import Way
from msv2.cases.counts import counted, points
from msv2.cases.mutants.targets import named
from msv2.studies.coverage import study
from spec.errors import InputError
from spec.paths import ROOT


def point(module: str, name: str, count: int, kind: str = "toggle", line: int = 2) -> str:
    fields = {"f": "/a/dut.v", "l": str(line), "n": "7", "t": kind, "page": f"v_{kind}/{module}", "o": name, "h": "tb.dut"}
    return "C '" + "".join(f"\1{key}\2{value}" for key, value in fields.items()) + f"' {count}\n"


LINES = ["# SystemC::Coverage-3\n", *(point(*each) for each in (
    ("unit", "sums[0]:0->1", 3), ("unit", "sums[0]:1->0", 2), ("unit", "sums[1]:0->1", 1), ("unit", "sums[1]:1->0", 0),
    ("unit", "sums[2]:0->1", 0), ("unit", "sums[2]:1->0", 0), ("unit", "sums[4]:0->1", 0), ("unit", "valid:0->1", 1),
    ("unit", "valid:1->0", 1), ("unit", "__02412[0]:0->1", 0), ("unit", "item___05Fpayload__02ecount[1]:0->1", 0),
    ("unit", "item___05Fpayload[1]:0->1", 1), ("unit", "item___05Fpayload[1]:1->0", 0), ("unit.inner", "__024like[3]:0->1", 0),
    ("tb", "over:0->1", 0), ("x_bench", "over:0->1", 0), ("x_bench.memory_model", "over:0->1", 0))),
    point("unit", "sums[5]:0->1", 0, "line")]


def test_a_bit_is_covered_that_rises_and_falls():
    assert toggles.toggles(points(LINES)) == {
        ("unit", "sums", 0): True, ("unit", "sums", 1): False, ("unit", "sums", 2): False, ("unit", "sums", 4): False,
        ("unit", "valid", 0): True, ("unit", "item__payload", 1): False, ("unit.inner", "$like", 3): False}


def test_runs_of_several_suites_are_merged():
    again = [point("unit", "sums[1]:1->0", 4), point("unit", "sums[2]:0->1", 4)]
    found = toggles.toggles(points([*LINES, *again]))
    assert found["unit", "sums", 1] and not found["unit", "sums", 2]


def test_holes_are_ranges_of_bits():
    assert toggles.holes(toggles.toggles(points(LINES))) == [
        "unit: item__payload[1]", "unit: sums[4, 2:1]", "unit.inner: $like[3]"]


VERILOG = """\
module unit(a, q);
  assign _00_ = a & (* src = "/else/site-packages/amaranth/lib/fifo.py:9" *) b;
  assign _01_ = _00_ ? (* src = "/else/site-packages/amaranth/lib/fifo.py:9|x:1" *) 24'h000001 : beta;
  assign \\held.x [3:0] = go ? one : two;
    casez (s)
      2'b?1:
        _27_ = b;
      default:
module other(a, q);
  assign q = _00_ ? a : b;
"""

CHOSEN = [point(*each) for each in (
    ("unit", "cond_then", 0, "branch", 3), ("unit", "cond_else", 4, "branch", 3), ("unit", "cond_then", 2, "branch", 4),
    ("unit", "cond_else", 0, "branch", 4), ("unit", "cond_else", 5, "branch", 4), ("unit", "case", 3, "line", 6),
    ("unit", "case", 0, "line", 8), ("unit", "block", 0, "line", 5), ("other", "cond_then", 1, "branch", 10),
    ("other", "cond_else", 0, "branch", 10), ("tb", "if", 0, "branch", 3))]


def test_a_way_has_its_condition_and_its_line_of_python():
    """Instances of a module are counted together, and a net without a name is told by what it is made of in its module."""
    assert choices.ways(points([*LINES, *CHOSEN]), VERILOG) == [
        Way("unit", 3, "a & b", "false", "amaranth/lib/fifo.py:9", True),
        Way("unit", 3, "a & b", "true", "amaranth/lib/fifo.py:9", False),
        Way("unit", 4, "go", "false", "", True), Way("unit", 4, "go", "true", "", True),
        Way("unit", 6, "2'b?1", "taken", "", True), Way("unit", 8, "default", "taken", "", False),
        Way("other", 10, "_00_", "false", "", False), Way("other", 10, "_00_", "true", "", True)]


def test_ways_that_were_not_taken_are_told():
    found = choices.ways(points(CHOSEN), VERILOG)
    assert choices.holes(found) == [
        "unit: a & b is never true (amaranth/lib/fifo.py:9)", "unit: default is never taken", "other: _00_ is never false"]
    assert choices.lines_of(found) == {"amaranth/lib/fifo.py:9": False}
    assert choices.lines_of(way for way in found if way.taken) == {"amaranth/lib/fifo.py:9": True}


def test_long_conditions_are_cut_and_lines_of_the_project_are_below_it():
    assert choices.condition(f"  assign x = {'a' * 80} ? b : c;", {}) == f"{'a' * choices.LONGEST}..."
    assert choices.condition("    else if (go)", {}) == "go"
    assert choices.source(f'  assign x = a ? (* src = "{ROOT}/rtl/x.py:7" *) b : c;') == "rtl/x.py:7"


@pytest.mark.slow
@pytest.mark.rtl
def test_a_unit_by_itself(tmp_path: Path):
    """Most bits of the handover change, and its strobes do; choices are taken both ways, and one names its line of Python."""
    counts, verilog = counted(named("handover"), tmp_path)
    found = toggles.toggles(counts)
    assert sum(found.values()) > 0.8 * len(found) > 50
    assert all(found[key] for key in found if key[1] in ("sink__valid", "sink__ready", "source__valid", "source__ready"))
    ways = choices.ways(counts, verilog)
    assert {way.way for way in ways} >= {"true", "false"} and sum(way.taken for way in ways) > 0.8 * len(ways) > 10
    assert any(way.condition == "rst" for way in ways) and any(way.source.startswith(("rtl/", "amaranth/")) for way in ways)


def test_the_page_has_every_unit_and_hole():
    none = {"ways": 4, "taken": 4, "lines": 1, "whole": 1, "not_taken": []}
    rows = [{"unit": "a", "machine": "tiny", "bits": 10, "covered": 9, "holes": ["a: x[3]"], **none},
            {"unit": "b", "machine": "tiny", "bits": 10, "covered": 10, "holes": [], **none, "taken": 3, "whole": 0,
             "not_taken": ["b: y | z is never true"]}]
    assert study.total(rows) == {"bits": 20, "covered": 19, "ways": 8, "taken": 7, "lines": 2, "whole": 1, "share": 0.95,
                                 "share_of_ways": 0.875}
    text = study.pages(rows)
    assert "19 of 20 bits are covered (95.0 %), 7 of 8 ways are taken (87.5 %), and all ways at 1 of 2 lines." in text
    assert "| a | `a: x[3]` |" in text and r"| b | `b: y \| z is never true` |" in text


def test_an_unknown_unit_lists_the_others():
    with pytest.raises(InputError, match="chunk_sorter"):
        study.main(["--unit", "chunk_sorted"])
