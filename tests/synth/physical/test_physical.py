"""Placement and wires: on netlists small enough to count by hand, and against scipy's spanning tree."""

from __future__ import annotations

import math
import random
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from spec.errors import InputError
from synth import linked, timing
from synth.netlist import parse
from synth.physical import clock_tree, placement
from synth.physical.clock_tree import Sink, build
from synth.physical.lef import read_lef
from synth.physical.parasitics import NO_WIRES, Edge, WireModel, Wires, escaped, route, spanning_tree, write_spef
from synth.physical.placement import Placement, Terminal, place
from synth.power.cells import Cell, Output, Table

LEF = """VERSION 5.8 ;
SITE core
  SIZE 0.054 BY 0.270 ;
END core
MACRO INV
  SIZE 0.162 BY 0.27 ;
  PIN A
    DIRECTION INPUT ;
    USE SIGNAL ;
    PORT
      LAYER M1 ;
        RECT 0.0 0.1 0.02 0.2 ;
        RECT 0.02 0.1 0.04 0.2 ;
    END
  END A
  PIN Y
    DIRECTION OUTPUT ;
    USE SIGNAL ;
    PORT
        RECT 0.1 0.05 0.12 0.25 ;
    END
  END Y
  PIN VDD
    DIRECTION INOUT ;
    USE POWER ;
    PORT
        RECT 0.0 0.26 0.162 0.28 ;
    END
  END VDD
  OBS
      RECT 0.5 0.5 0.6 0.6 ;
  END
END INV
END LIBRARY
"""

LIBERTY = """library (linear) { delay_model : table_lookup; time_unit : "1ps"; capacitive_load_unit (1,ff);
 input_threshold_pct_fall : 50; input_threshold_pct_rise : 50; output_threshold_pct_fall : 50; output_threshold_pct_rise : 50;
 slew_lower_threshold_pct_fall : 10; slew_lower_threshold_pct_rise : 10; slew_upper_threshold_pct_fall : 90;
 slew_upper_threshold_pct_rise : 90;
 lu_table_template (t) { variable_1 : input_net_transition; variable_2 : total_output_net_capacitance;
  index_1 ("1, 1000"); index_2 ("0, 100"); }
 cell (INV) { pin (A) { direction : input; capacitance : 2; }
  pin (Y) { direction : output; function : "!A"; timing () { related_pin : "A"; timing_sense : negative_unate;
   cell_rise (t) { values ("10, 110", "10, 110"); } cell_fall (t) { values ("10, 110", "10, 110"); }
   rise_transition (t) { values ("5, 5", "5, 5"); } fall_transition (t) { values ("5, 5", "5, 5"); } } } } }
"""
"""An inverter that takes 10 ps, and one more for each fF of its load."""

needs_coloquinte = pytest.mark.skipif(not placement.available(), reason="coloquinte is not installed")
needs_sta = pytest.mark.skipif(not timing.available(), reason=linked.INSTALL)


@pytest.fixture
def lef(tmp_path: Path) -> Path:
    path = tmp_path / "cells.lef"
    path.write_text(LEF)
    return path


def chain(length: int) -> str:
    """Verilog of inverters in a row, from `a` to `z`."""
    nets = ["a", *(f"n{k}" for k in range(1, length)), "z"]
    wires = [f"  wire {net};" for net in nets[1:-1]]
    cells = [f"  INV u{k} (\n    .A({nets[k]}),\n    .Y({nets[k + 1]})\n  );" for k in range(length)]
    return "\n".join(["module chain(a, z);", "  input a;", "  output z;", *wires, *cells, "endmodule"]) + "\n"


def test_shapes_of_cells(lef: Path, tmp_path: Path) -> None:
    cells = read_lef(lef)
    assert list(cells) == ["INV"] and (cells["INV"].width, cells["INV"].height) == (162, 270)
    assert {name: (pin.is_output, pin.x, pin.y) for name, pin in cells["INV"].pins.items()} == {
        "A": (False, 20, 150), "Y": (True, 110, 150)}
    with pytest.raises(InputError, match="is none"):
        read_lef(tmp_path / "absent.lef")
    lef.write_text("VERSION 5.8 ;\n")
    with pytest.raises(InputError, match="no MACRO"):
        read_lef(lef)


@pytest.mark.parametrize("count", [1, 2, 3, 40, 300])
def test_trees_are_as_short_as_scipys(count: int) -> None:
    points = np.random.default_rng(count).integers(0, 10**5, (count, 2))
    tree = spanning_tree([(int(x), int(y)) for x, y in points])
    assert len(tree) == count - 1
    reached = {0}
    for edge in tree:
        assert edge.start in reached and edge.end not in reached
        reached.add(edge.end)
        assert edge.um == np.abs(points[edge.start] - points[edge.end]).sum() / 1000
    shortest = minimum_spanning_tree(cdist(points, points, "cityblock")).sum() / 1000
    assert sum(edge.um for edge in tree) == pytest.approx(shortest)


def placed() -> Placement:
    """Two inverters, 3 um apart, with ports at their sides."""
    netlist = parse(chain(2))
    nets = {"a": (Terminal(0, "A", False, 0, 0), Terminal(-1, "a", True, -1000, 0)),
            "n1": (Terminal(0, "Y", True, 0, 0), Terminal(1, "A", False, 3000, 0)),
            "z": (Terminal(1, "Y", True, 3000, 0), Terminal(-1, "z", False, 3000, 2000))}
    return Placement(netlist, 4000, 2000, 0.5, nets, frozenset())


def pin_ff(end: Terminal) -> float:
    return 2.0 if end.name == "A" else 0.0


def test_the_file_of_wires(tmp_path: Path) -> None:
    path = tmp_path / "wires.spef"
    write_spef(path, placed(), route(placed()), WireModel(10.0, 0.5, 7.0, "test"), pin_ff)
    nets = path.read_text().split("*D_NET ")[1:]
    assert nets[1].splitlines()[:10] == [
        "n1 3.50000", "*CONN", "*I u0:Y O", "*I u1:A I", "*CAP", "1 u0:Y 0.75000", "2 u1:A 2.75000", "*RES",
        "1 u0:Y u1:A 37.000", "*END"]
    assert "*P a I" in nets[0] and "*P z O" in nets[2]
    clocks = Placement(**{**vars(placed()), "clocks": frozenset({"n1"})})
    assert list(route(clocks).trees) == ["a", "z"]


def test_names() -> None:
    assert escaped("net") == "net" and escaped("port[3]") == "port[3]"
    assert escaped("\\core.n1 ") == r"core\.n1" and escaped("\\s[2].q ") == r"s\[2\]\.q"
    assert escaped("\\core.bus [3]") == r"core\.bus [3]".replace(" ", "")


@needs_sta
def test_sta_reads_what_wires_add(tmp_path: Path) -> None:
    verilog, library = tmp_path / "chain.v", tmp_path / "linear.lib"
    verilog.write_text(chain(2))
    library.write_text(LIBERTY)
    arrivals = []
    for name, model in (("pins", NO_WIRES), ("wires", WireModel(0.0, 0.5, 0.0, "no resistance"))):
        path = tmp_path / f"{name}.spef"
        write_spef(path, placed(), route(placed()), model, pin_ff)
        output = timing.run_sta("\n".join([
            f"read_liberty {library}", f"read_verilog {verilog}", "link_design chain", "create_clock -name c -period 1000",
            "set_input_delay 0 -clock c [get_ports a]", "set_output_delay 0 -clock c [get_ports z]",
            f"read_spef -pin_cap_included {path}", "report_worst_slack -digits 3"]) + "\n", tmp_path)
        arrivals.append(1000 - float(re.search(r"worst slack\s+(\S+)", output)[1]))
    # The first inverter drives a pin of 2 fF, the second none; 3 and 2 um of wires add 1.5 and 1 fF.
    assert arrivals == pytest.approx([10 + 2 + 10, 10 + 3.5 + 10 + 1], abs=0.05)


@needs_coloquinte
def test_a_placement_is_legal(lef: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    cells = read_lef(lef)
    found = place(parse(chain(200)), cells, (), 0.7, tmp_path / "log")
    assert found == place(parse(chain(200)), cells, (), 0.7, tmp_path / "log")
    assert capfd.readouterr().out == "" and "placement" in (tmp_path / "log").read_text()
    assert found.height % 270 == 0 and 0.65 < found.density <= 0.7
    corners = {}
    for ends in found.nets.values():
        for end in ends:
            if end.owner < 0:
                assert end.x in (0, found.width) or end.y in (0, found.height)
            else:
                assert 0 < end.x < found.width and 0 < end.y < found.height
                corners.setdefault(end.owner, {})[end.name] = end
    rows: dict[int, list[int]] = {}
    for pins in corners.values():
        left = min(pins["A"].x - 20, pins["Y"].x - 52)  # whether or not the cell is mirrored
        rows.setdefault(pins["A"].y, []).append(left)
    assert sum(map(len, rows.values())) == 200
    for lefts in rows.values():
        assert min(np.diff(sorted(lefts)), default=162) >= 162
    length = route(found).um
    assert length < 0.5 * _shuffled(found).um


def _shuffled(found: Placement) -> Wires:
    """The wires if the same places were given out at random."""
    places = list(range(200))
    random.Random(0).shuffle(places)
    at = {end.owner: end for ends in found.nets.values() for end in ends if end.name == "A"}
    return Wires({bit: [Edge(0, 1, sum(abs(p - q) for p, q in zip(*(
        (at[places[end.owner]].x, at[places[end.owner]].y) for end in ends), strict=True)) / 1000)]
        for bit, ends in found.nets.items() if all(end.owner >= 0 for end in ends)})


@needs_coloquinte
def test_bad_requests(lef: Path, tmp_path: Path) -> None:
    cells, netlist = read_lef(lef), parse(chain(3))
    for density, effort, words in ((0.2, 3, "density must lie"), (0.96, 3, "density must lie"), (0.7, 0, "effort must be")):
        with pytest.raises(InputError, match=words):
            place(netlist, cells, (), density, tmp_path / "log", effort)
    with pytest.raises(InputError, match="no cells INV"):
        place(netlist, {"BUF": cells["INV"]}, (), 0.7, tmp_path / "log")


def _buffer() -> Cell:
    """A buffer whose input has 1 fF, and which takes 0.5 fJ an edge."""
    energy = Table(np.array([1.0, 100.0]), np.array([0.0, 100.0]), np.full((2, 2), 0.5))
    flat = Table(np.array([1.0, 100.0]), np.empty(0), np.zeros(2))
    return Cell("BUF", 1.0, "logic", ("A",), {"A": 1.0}, {"Y": Output(None, {}, {"A": energy})}, {"A": flat}, flat, 0.0)


def test_a_clock_tree_by_hand() -> None:
    model, square = WireModel(0.0, 0.1, 0.0, "test"), 0.7 ** 2
    one = build([Sink(0, 0, 0.5)], _buffer(), model)
    assert (one.sinks, one.buffers, one.um) == (1, 1, 0.0)
    assert one.tree_fj == pytest.approx(2 * 0.5 + 1.0 * square) and one.sink_fj == pytest.approx(0.5 * square)
    pair = build([Sink(0, 0, 0.5), Sink(10_000, 0, 0.5)], _buffer(), model)
    assert (pair.buffers, pair.um) == (1, 10.0) and pair.wire_fj == pytest.approx(1.0 * square)
    with pytest.raises(ValueError, match="at most 20"):
        build([Sink(0, 0, 21.0)], _buffer(), model)


def test_buffers_of_a_clock_drive_what_they_can() -> None:
    places = np.random.default_rng(1).integers(0, 50_000, (500, 2))
    sinks = [Sink(int(x), int(y), 0.6) for x, y in places]
    model = WireModel(0.0, 0.166, 0.0, "test")
    parts = clock_tree._parts(sinks, model)
    assert sorted(sink for part in parts for sink in [(s.x, s.y) for s in part]) == sorted((s.x, s.y) for s in sinks)
    for part in parts:
        load = sum(s.ff for s in part) + clock_tree._length(part) * model.ff_per_um
        assert load <= clock_tree.MOST_LOAD_FF
    tree = build(sinks, _buffer(), model)
    assert tree.buffers >= math.ceil(500 * 0.6 / 20) and tree.sink_fj == pytest.approx(500 * 0.6 * 0.49)
