"""The linked machine: memories back in their modules, units by path, late endpoints by pair of units, and a small machine whose
slack is known by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from spec.errors import InputError
from synth import linked, timing
from synth.corners import CORNERS, corner
from synth.hold import MemoryPort, added
from synth.linked import (
    Hierarchy,
    LinkedTiming,
    Written,
    memory_cells,
    pairs,
    read_timing,
    time_machine,
    with_memories,
    zero_slack_ps,
)
from synth.machine import TOP
from synth.macro_timing import liberty
from synth.netlist import parse
from synth.whole import without_early_ports
from tests.helpers.small_machine import CLOCK_PS, STORES, netlists, small_machine

needs_sta = pytest.mark.skipif(not timing.available(), reason=linked.INSTALL)

READER = f"{TOP}__geometry__reader"


def test_a_memory_is_put_back_as_a_cell() -> None:
    text = netlists()[READER]
    cells = memory_cells(STORES, text)
    assert list(cells) == ["memory0"] and cells["memory0"].pins == {"rd_addr": 3, "rd_data": 8}
    found = parse(with_memories(text, cells))
    assert list(found.ports) == ["clk", "rst", "start", "found"]
    memory = next(instance for instance in found.instances if instance.name == "memory0")
    assert memory.kind == cells["memory0"].name and memory.pins["clk"] == ("clk",)
    assert memory.pins["rd_data"] == tuple(f"memory0_rd_data[{i}]" for i in range(8))
    assert with_memories(netlists()[TOP], {}) == netlists()[TOP]


def test_the_unit_of_a_pin_is_the_innermost_one() -> None:
    hierarchy = Hierarchy(TOP, netlists())
    assert hierarchy.unit("geometry/reader/_1_/D") == "geometry.reader"
    assert hierarchy.unit("geometry/_1_/A") == "geometry" and hierarchy.unit("_1_/Y") == TOP
    assert hierarchy.unit("counters/row/_1_/D") == "counters"


def test_late_endpoints_are_grouped_by_pair_of_units() -> None:
    late = "\n".join([
        "-12.5\tcontroller/_1_/Q\tcounters/_1_/D\tcontroller  counters",
        "-30.0\tcontroller/_1_/Q\tgeometry/reader/_1_/D\tcontroller  geometry geometry/reader",
        "-7.5\tcontroller/_1_/Q\tcounters/_2_/D\tcontroller counters",
        "-1.0\tgo\tcontroller/_1_/D\t ",
        "0.0\tgeometry/reader/_1_/Q\tcounters/_2_/D\tgeometry/reader counters"])
    found = pairs(late, Hierarchy(TOP, netlists()))
    assert [(pair.start, pair.end, pair.endpoints, pair.slack_ps) for pair in found] == [
        ("controller", "geometry.reader", 1, -30.0), ("controller", "counters", 2, -12.5), ("ports", "controller", 1, -1.0)]
    assert found[0].through == ("controller", TOP, "geometry", "geometry.reader")
    assert found[1].start_pin == "controller/_1_/Q" and found[1].end_pin == "counters/_1_/D"


def test_what_opensta_writes_is_read() -> None:
    head = ("worst slack -30.25\ntns -43.5\nStartpoint: x\nHOLD\n\n  y/D (DFF)   5.0  3.0  -2.00 (VIOLATED)\n"
            "z/D 5.0 9.0 4.0 (MET)\n")
    early = "-2.0\ta/Q\tgeometry/reader/memory0/rd_addr[1]\t\n-1.0\ta/Q\tcounters/_1_/D\t\n0.0\ta/Q\tb/D\t\n"
    slews = ("a/Y 320.0 350.0 -30.0 (VIOLATED)\nb/A 320.0 350.0 -30.0 (VIOLATED)\n"
             "b/Y 320.0 321.0 -1.0 (VIOLATED)\nc/d/GCLK 320.0 400.0 -80.0 (VIOLATED)\nc/d/CLK 320.0 400.0 -80.0 (VIOLATED)\n")
    output = f"{head}LATE\n-30.25\tcontroller/_1_/Q\tcounters/_1_/D\t\nEARLY\n{early}SLEWS\nmax_transition\n\n{slews}"
    written = Written((), (), Path("memories.lib"), Hierarchy(TOP, netlists()))
    found = read_timing(output, written, CORNERS["typical"], 1000.0, 0.05)
    assert (found.slack_ps, found.late_endpoints, found.total_negative_ps) == (-30.2, 1, -30.2)
    assert (found.hold_slack_ps, found.hold_endpoints, found.hold_at_memories) == (-2.0, 2, 1)
    assert (found.slew_nets, found.slew_slack_ps, found.slew_clocks) == (2, -30.0, 1) and found.path.endswith("Startpoint: x\n")
    with pytest.raises(RuntimeError, match="reported no slack"):
        read_timing("", written, CORNERS["typical"], 1000.0, 0.05)


def test_the_clock_at_zero_slack_keeps_its_share_of_uncertainty() -> None:
    """A path of 1,045 ps is 95 % of 1,100 ps."""
    assert zero_slack_ps(1000.0, 950.0 - 1045.0, 0.05) == pytest.approx(1100.0)


def test_without_opensta_one_is_told_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "available", lambda: False)
    with pytest.raises(InputError, match="apt-get install opensta"):
        linked.check()


def test_an_unknown_corner_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="typical, slow are, and a liberty file"):
        corner("fast")
    path = tmp_path / "cells.lib"
    path.write_text("")
    assert corner(str(path)).liberty(tmp_path) == path
    assert all("asap7_ss/" in name and "_SS_" in name for name in corner("slow").technology.files)


@needs_sta
def test_a_small_machine_is_timed_through_all_its_units(tmp_path: Path) -> None:
    """The clock is 100 ps, 10 of them uncertainty. To the reader's register: controller 40 + 30, the top's inverter 10, the
    frame's 10, buffers 40, setup 20. To the counters: 70 + 10 and 20 + 20, or 10 + 10 + 20 through the reader. In the reader:
    40, and the memory's setup of 15 and three multiplexers of 27."""
    design, parts, where = small_machine(tmp_path)
    found = time_machine(design, parts, where, tmp_path / "machine", CLOCK_PS, 0.1)
    assert [(pair.start, pair.end, pair.slack_ps, pair.endpoints) for pair in found.pairs] == [
        ("controller", "geometry.reader", -60.0, 1), ("geometry.reader", "geometry.reader", -46.0, 3),
        ("controller", "counters", -30.0, 2)]
    assert (found.slack_ps, found.late_endpoints, found.slew_nets) == (-60.0, 6, 0)
    assert found.total_negative_ps == -60 - 3 * 46 - 2 * 30 and "Startpoint: controller/_1_" in found.path
    assert (found.hold_slack_ps, found.hold_endpoints) == (5.0, 0)
    top = (tmp_path / "machine" / f"{TOP}.v").read_text()
    assert ".Y(units_rst)" in top and ".rst(units_rst)" not in top and top.count(".rst(rst)") == 3
    way = next(pair for pair in found.pairs if (pair.start, pair.end) == ("controller", "geometry.reader"))
    assert way.through == ("controller", TOP, "geometry", "geometry.reader")


def test_the_library_of_memories_has_a_bus_for_each_pin() -> None:
    cells = list(memory_cells(STORES, netlists()[READER]).values())
    text = liberty(cells, 2.0)
    assert text.count("{") == text.count("}") and f"cell ({cells[0].name})" in text
    assert "bus (rd_data) { bus_type : bits8; direction : output" in text
    access = cells[0].timing.access_ps
    assert f'cell_rise (scalar) {{ values ("{2 * access:.1f}")' in text


def test_buffers_stand_before_a_memorys_pin() -> None:
    text = netlists()[READER]
    cells = memory_cells(STORES, text)
    found = parse(with_memories(text, cells, {"memory0_rd_addr": 2}, ("BUF", "A", "Y")))
    chain = [instance for instance in found.instances if instance.name.startswith("hold_")]
    assert len(chain) == 2 * 3 and {instance.kind for instance in chain} == {"BUF"}
    by_output = {instance.pins["Y"][0]: instance.pins["A"][0] for instance in chain}
    memory = next(instance for instance in found.instances if instance.name == "memory0")
    for bit, net in enumerate(memory.pins["rd_addr"]):
        assert by_output[by_output[net]] == f"memory0_rd_addr[{bit}]"
    assert added([found], Counter({READER: 5})) == 5 * 6


@needs_sta
def test_a_pin_that_is_too_early_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The address comes from registers after 40 ps, and a buffer takes 10: a hold of 65 ps needs three of them."""
    real = linked.memory_timing
    monkeypatch.setattr(linked, "memory_timing", lambda memory: replace(real(memory), hold_ps=65.0))
    design, parts, where = small_machine(tmp_path)
    where = replace(where, technology=replace(where.technology, broadcast_buffer=("BUF", "A", "Y")))

    def time(held: Mapping[MemoryPort, int]) -> dict[str, LinkedTiming]:
        return {where.name: time_machine(design, parts, where, tmp_path / "machine", CLOCK_PS, 0.1, held)}

    before = time({})[where.name]
    assert before.hold_slack_ps == -25.0 and before.early == ((READER, "memory0_rd_addr"),) and before.hold_at_memories == 3
    found, held = without_early_ports(time)
    assert held == {(READER, "memory0_rd_addr"): 3}
    assert (found[where.name].hold_endpoints, found[where.name].early) == (0, ())
    assert found[where.name].pairs[0].slack_ps == -46.0 - 30.0  # the same way is the memory's late one
