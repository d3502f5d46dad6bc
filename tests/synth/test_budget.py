"""The budget rule on interfaces worked out by hand, on measured ones of the same small machine, and on stored ones."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from spec.config import TINY
from synth import interfaces, linked, timing, whole
from synth.budget import Late, compare, graph, late, order
from synth.corners import CORNERS
from synth.design import Design
from synth.interfaces import Interface, interface_of, interfaced
from synth.machine import TOP
from synth.netlist import parse
from synth.whole import Budget, WholeTiming, budgets, stale, stored
from tests.helpers.small_machine import CLOCK_PS, netlists, small_machine

needs_sta = pytest.mark.skipif(not timing.available(), reason=linked.INSTALL)

CONTROLLER, COUNTERS, GEOMETRY, READER = (
    f"{TOP}__{name}" for name in ("controller", "counters", "geometry", "geometry__reader"))

MADE_UP = {
    TOP: Interface(
        "a", 0, {"controller": CONTROLLER, "geometry": GEOMETRY, "counters": COUNTERS},
        through={"go": {"controller.go": 0}, "controller.count": {"geometry.start": 10, "counters.count": 10},
                 "geometry.found": {"counters.found": 0}, "counters.done": {"done": 0}}),
    CONTROLLER: Interface("b", 0, arrives={"count": 70}, needed={"go": 20}),
    COUNTERS: Interface("c", 0, arrives={"done": 40}, needed={"count": 40, "found": 20}),
    GEOMETRY: Interface("d", 0, {"reader": READER}, through={"start": {"reader.start": 10}, "reader.found": {"found": 0}}),
    READER: Interface("e", 136, needed={"start": 60}, through={"start": {"found": 10}}),
}
"""What the modules of tests.helpers.small_machine do, worked out by hand."""


def test_times_of_connected_units_are_added_up() -> None:
    """As in the helper: 70 + 10 + 10 + 60; 136 inside the reader; 70 + 10 + 40 and, through it, 70 + 10 + 10 + 10 + 20."""
    found = late(graph(MADE_UP, TOP, CLOCK_PS), CLOCK_PS, 0.1)
    assert found == [
        Late("controller", "geometry.reader", 60, 1, ("controller.count", "geometry.start", "geometry.reader.start")),
        Late("geometry.reader", "geometry.reader", 46, 0, ("geometry.reader",)),
        Late("controller", "counters", 30, 2, ("controller.count", "geometry.start", "geometry.reader.start",
                                               "geometry.reader.found", "geometry.found", "counters.found"))]
    assert late(graph(MADE_UP, TOP, CLOCK_PS), 200.0, 0.1) == []


def test_ports_of_the_machine_have_their_share_of_the_clock() -> None:
    """`go` arrives after 10 % of the clock, and `done` must be there 5 % before its end."""
    slow = {**MADE_UP, CONTROLLER: replace(MADE_UP[CONTROLLER], needed={"go": 181}),
            COUNTERS: replace(MADE_UP[COUNTERS], arrives={"done": 200})}
    found = late(graph(slow, TOP, 200.0), 200.0, 0.0)
    assert [(pair.start, pair.end, pair.excess_ps) for pair in found] == [("counters", "ports", 10), ("ports", "controller", 1)]


def test_a_circle_of_ways_is_an_error() -> None:
    steps = {("a", "x"): {("b", "y"): 1}, ("b", "y"): {("c", "z"): 1}, ("c", "z"): {("b", "y"): 1}}
    with pytest.raises(ValueError, match=r"in a circle: a\.x, b\.y, c\.z"):
        order(steps)
    del steps[("c", "z")]
    assert order(steps) == [("a", "x"), ("b", "y"), ("c", "z")]


def test_the_list_of_known_pairs_may_only_shrink() -> None:
    found = [Late("a", "b", 30, 1, ()), Late("a", "c", 5, 1, ())]
    assert compare(found, {("a", "b"): 30, ("a", "c"): 5}) == []
    assert compare(found, {("a", "b"): 29, ("a", "c"): 5}) == [
        "a to b is 30 ps late, and 29 are known: cut the way, or show why it is so"]
    assert compare(found, {("a", "b"): 30}) == ["a to c is 5 ps late, and 0 are known: cut the way, or show why it is so"]
    assert compare(found, {("a", "b"): 31, ("a", "c"): 5, ("d", "e"): 7}) == [
        "a to b is known as 31 ps late, and is 30: lower or remove the entry",
        "d to e is known as 7 ps late, and is 0: lower or remove the entry"]


def test_units_inside_a_module_become_its_ports() -> None:
    ports = {CONTROLLER: {"go": ("input", 1), "count": ("output", 2)}}
    module = parse(netlists()[TOP].replace(".count(count)", ".count({ count, other })", 1))
    text, below, names = interfaces.without(module, ports)
    assert below == {"controller": CONTROLLER}
    assert names == {"inner0_go": "controller.go", "inner0_count": "controller.count"}
    assert "  input [1:0] inner0_count;\n" in text and "  assign count = inner0_count[1];\n" in text
    assert "  output inner0_go;\n" in text and "  assign inner0_go = go;\n" in text
    assert CONTROLLER not in text and COUNTERS in text


@needs_sta
def test_measured_interfaces_are_those_worked_out_by_hand(tmp_path: Path) -> None:
    design, parts, where = small_machine(tmp_path)
    found = {name: interface_of(name, design, parts, where, tmp_path / "interfaces") for name in interfaced(design)}
    assert {name: replace(one, source="") for name, one in found.items()} == {
        name: replace(one, source="") for name, one in MADE_UP.items()}
    assert all(one.source == interfaces.source_hash(design, name) for name, one in found.items())


def _stored(path: Path, sources: str = "x") -> dict:
    """A file of stored interfaces, in which TINY stands for a machine that was measured."""
    machine = WholeTiming("tiny", {}, MADE_UP, sources, 5, 5, 5)
    path.write_text(json.dumps(stored([machine], CLOCK_PS, 0.1)))
    return json.loads(path.read_text())


def test_stored_interfaces_come_back_and_are_stale_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "budget.json"
    assert set(_stored(path)["interfaces"]) == {f"{name} {one.source}" for name, one in MADE_UP.items()}
    budget = budgets(path)["tiny"]
    assert budget.interfaces == MADE_UP and [pair.excess_ps for pair in budget.late()] == [60, 46, 30]
    monkeypatch.setattr(whole, "_sources", lambda config: "x")
    assert stale(budget) == []
    design, _, _ = small_machine(tmp_path / "machine")
    monkeypatch.setattr(whole, "machine_design", lambda config, folder: design)
    monkeypatch.setattr(whole, "_sources", lambda config: "y")
    assert stale(budget) == sorted(MADE_UP)
    today = {name: replace(one, source=interfaces.source_hash(design, name)) for name, one in MADE_UP.items()}
    assert stale(replace(budget, interfaces=today)) == []
    del today[READER]
    assert stale(replace(budget, interfaces=today)) == [READER]


@needs_sta
def test_only_what_has_changed_is_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader is another one than was stored, and the stored counters, which are not, stay as they are."""
    design, parts, where = small_machine(tmp_path)
    today = {name: replace(one, source=interfaces.source_hash(design, name)) for name, one in MADE_UP.items()}
    kept = {**today, READER: replace(today[READER], source="old", inside=1), COUNTERS: replace(today[COUNTERS], inside=7)}
    asked: list[set[str]] = []

    def mapped(config: object, settings: object, jobs: int, progress: object, only: set[str]) -> tuple:
        asked.append(only)
        return design, parts

    monkeypatch.setattr(whole, "machine_design", lambda config, folder: design)
    monkeypatch.setattr(whole, "mapped", mapped)
    monkeypatch.setattr(whole, "_sources", lambda config: "today")
    monkeypatch.setitem(whole.CORNERS, whole.BUDGET_CORNER, where)
    found = whole.time_ports(TINY, Budget("tiny", CLOCK_PS, 0.1, "then", kept), tmp_path, progress=lambda line: None)
    assert asked == [{READER}] and found.sources == "today" and found.linked == {}
    assert found.interfaces == {**today, COUNTERS: kept[COUNTERS]} and found.measured == 1


def test_an_interface_is_stale_after_a_change_anywhere_inside(tmp_path: Path) -> None:
    """An operator that has no interface belongs to the unit around it; a unit inside counts with its ports alone."""
    port = "\n  wire width 4 input 1 \\a\n"
    design = Design(TOP, {
        "operator": f"module \\operator{port}\n  old\nend\n", READER: f"module \\{READER}{port}\n  cell \\operator \\u\nend\n",
        TOP: f"module \\{TOP}{port}\n  cell \\{READER} \\v\nend\n"}, {
        "operator": Counter(), READER: Counter(operator=1), TOP: Counter({READER: 1})})
    changed = replace(design, texts={**design.texts, "operator": design.texts["operator"].replace("old", "new")})
    before, after = ({name: interfaces.source_hash(one, name) for name in interfaced(one)} for one in (design, changed))
    assert before[READER] != after[READER] and before[TOP] == after[TOP]


def test_ports_in_rtlil_are_those_of_the_module() -> None:
    text = ("module \\inner\n  wire input 1 \\no\nend\n\nmodule \\m\n\n  wire width 1 input 0  \\clk\n"
            "  wire width 2 output 1 \\b\n"
            "  wire width 3 signed input 2 \\a$1\n  wire width 4 \\c\nend\n")
    assert interfaces.rtl_ports(text, "m") == {"clk": ("input", 1), "b": ("output", 2), "a$1": ("input", 3)}


def test_escaped_names_of_ports_are_plain_in_interfaces() -> None:
    text = "module m(\\a$1 , b);\n  input \\a$1 ;\n  output [1:0] b;\nendmodule\n"
    assert interfaces.ports_of(text) == {"a$1": ("input", 1), "b": ("output", 2)}
    outer = parse("module top(x);\n  input x;\n  m \\u$2  (\n    .\\a$1 (x),\n    .b({ y, z })\n  );\nendmodule\n")
    written, below, names = interfaces.without(outer, {"m": interfaces.ports_of(text)})
    assert below == {"u$2": "m"} and names == {"inner0_a_1": "u$2.a$1", "inner0_b": "u$2.b"}
    assert "  output inner0_a_1;\n" in written and "  assign z = inner0_b[0];\n" in written
    assert "foreach p {c {a$1}}" in interfaces.script([], "m", ["c", "a$1"], CORNERS["typical"], [])
