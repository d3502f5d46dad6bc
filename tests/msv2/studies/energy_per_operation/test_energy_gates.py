"""Gate-level simulation and its energies, on a library and netlists made by hand."""

from __future__ import annotations

import gzip
import json
import os
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from synth import timing
from synth.liberty import ASAP7, find_files
from synth.power import cells as liberty
from synth.power.cells import NOTHING, Arc, Cell, Output, Table
from synth.power.electrical import INPUT_SLEW, analyse
from synth.power.energy import VOLTAGE, by_part, total
from synth.power.memories import Contents, Memory
from synth.power.netlist import Flattener
from synth.power.simulate import Delays, Simulation

DELAY, GATE_ENERGY, PIN, CLOCK_CELL, CLOCK_PIN, LEAK = 10.0, 0.25, 0.5, 0.7, 0.4, 30.0
SLEWS, LOADS = np.array([5.0, 10, 20, 40, 80, 160, 320]), np.array([0.72, 1.44, 2.88, 5.76, 11.52, 23.04, 46.08])


def flat_table(value: float) -> Table:
    return Table(SLEWS, LOADS, np.full((7, 7), value))


def line(value: float) -> Table:
    return Table(SLEWS, np.empty(0), np.full(7, value))


def logic(name: str, inputs: str, truth: list[int]) -> Cell:
    arcs = {pin: Arc(flat_table(DELAY), flat_table(20.0)) for pin in inputs}
    output = Output(np.array(truth, np.uint8), arcs, {pin: flat_table(GATE_ENERGY) for pin in inputs})
    return Cell(name, 0.1, "logic", tuple(inputs), dict.fromkeys(inputs, PIN), {"Y": output}, dict.fromkeys(inputs, NOTHING),
                NOTHING, LEAK)


def clocked(name: str, kind: str, inputs: tuple[str, ...], output: str, inverted: bool = False) -> Cell:
    pins = {pin: line(CLOCK_CELL if pin == "CLK" else 0.0) for pin in inputs}
    out = Output(None, {"CLK": Arc(flat_table(DELAY), flat_table(20.0))}, {"CLK": flat_table(GATE_ENERGY)})
    return Cell(name, 0.3, kind, inputs, dict.fromkeys(inputs, PIN) | {"CLK": CLOCK_PIN}, {output: out}, pins, line(0.0), LEAK,
                inverted)


CELLS = {cell.name: cell for cell in (
    logic("INV", "A", [1, 0]), logic("XOR2", "AB", [0, 1, 1, 0]), logic("AND2", "AB", [0, 0, 0, 1]),
    clocked("FLOP", "flop", ("CLK", "D"), "QN", True), clocked("ICG", "gate", ("CLK", "ENA", "SE"), "GCLK"))}


class Netlists:
    """Modules written as synthesis writes them."""

    def __init__(self, folder: Path):
        self.folder, self.paths = folder, {}

    def add(self, name: str, ports: dict[str, tuple[str, list]], cells: list[tuple[str, dict[str, object]]]) -> None:
        module = {
            "ports": {port: {"direction": way, "bits": bits} for port, (way, bits) in ports.items()}, "netnames": {},
            "cells": {f"c{i}": {"type": kind, "connections": {
                pin: bits if isinstance(bits, list) else [bits] for pin, bits in pins.items()}}
                for i, (kind, pins) in enumerate(cells)}}
        path = self.folder / f"{name}.json"
        path.write_text(json.dumps({"modules": {name: module}}))
        self.paths[name] = path.with_suffix(".v")

    def flatten(self, top: str):
        return Flattener(self.paths, CELLS).flatten(top)


@pytest.fixture
def counter(tmp_path):
    """Two bits that count, behind a clock gate, each a module of its own; `carry` goes up the chain."""
    netlists = Netlists(tmp_path)
    netlists.add("bit", {"clk": ("input", [2]), "carry": ("input", [3]), "q": ("output", [4]), "up": ("output", [5])}, [
        ("FLOP", {"CLK": 2, "D": 6, "QN": 7}), ("INV", {"A": 7, "Y": 4}), ("XOR2", {"A": 4, "B": 3, "Y": 6}),
        ("AND2", {"A": 4, "B": 3, "Y": 5})])
    netlists.add("counter", {"clk": ("input", [2]), "en": ("input", [3]), "q": ("output", [4, 5]), "one": ("output", ["1"])}, [
        ("ICG", {"CLK": 2, "ENA": 3, "SE": "0", "GCLK": 8}),
        ("bit", {"clk": 8, "carry": "1", "q": 4, "up": 9}), ("bit", {"clk": 8, "carry": 9, "q": 5, "up": []})])
    netlists.paths = {"bit": netlists.paths["bit"], "counter": netlists.paths["counter"]}
    return netlists.flatten("counter")


def delays_of(flat, electrical) -> Delays:
    return Delays(np.rint(electrical.gate_delay).astype(np.int64), np.rint(electrical.flop_delay).astype(np.int64), 100, 300)


@pytest.mark.parametrize("timed", [False, True])
def test_a_hierarchical_counter_counts(counter, timed):
    electrical = analyse(counter, CELLS, 2.0)
    simulation = Simulation(counter, CELLS, delays_of(counter, electrical) if timed else None)
    begin, seen = simulation.number("q"), []
    for cycle in range(12):
        simulation.set("en", int(cycle % 3 != 0))
        simulation.settle()
        assert simulation.check() == 0
        seen.append(simulation.number("q"))
        simulation.edge()
    wanted = begin + np.cumsum([0, *(cycle % 3 != 0 for cycle in range(11))])
    assert seen == (wanted % 4).tolist()
    counts = simulation.counts()
    assert counts.cycles == 12 and counts.gated.tolist() == [8] and simulation.number("one") == 1


def test_energies_are_those_of_toggles(counter):
    electrical = analyse(counter, CELLS, 2.0)
    simulation = Simulation(counter, CELLS)
    for _ in range(9):
        simulation.set("en", 1)
        simulation.settle()
        simulation.edge()
    simulation.forget()
    for _ in range(8):
        simulation.settle()
        simulation.edge()
    counts = simulation.counts()
    parts = by_part(counter, electrical, counts)
    gates, flops = counts.toggles[counter.gate_output], counts.toggles[counter.flop_output]
    everything = total(parts)
    assert everything.internal == pytest.approx(GATE_ENERGY * gates.sum())
    assert everything.registers == pytest.approx(GATE_ENERGY * flops.sum())
    assert everything.clock == pytest.approx(8 * (CLOCK_CELL + CLOCK_PIN * VOLTAGE**2))  # the clock gate's own pin
    assert everything.gated == pytest.approx(8 * 2 * (CLOCK_CELL + CLOCK_PIN * VOLTAGE**2) + 2 * 8 * GATE_ENERGY)
    assert everything.leakage == pytest.approx(LEAK * (len(gates) + len(flops) + 1))
    low = counter.ports["q"][0]  # toggles in every cycle: drives the output, an XOR2 and an AND2
    assert counts.toggles[low] == 8 and electrical.net_load[low] == pytest.approx(2.0 + 2 * PIN)
    assert parts["counter"].internal == 0 and parts["bit"].internal == everything.internal
    assert everything.dynamic == everything.internal + everything.switching + everything.registers + everything.gated
    simulation.set("en", 0)
    simulation.settle()
    simulation.edge()
    simulation.settle()
    simulation.forget()
    for _ in range(8):
        simulation.settle()
        simulation.edge()
    still = total(by_part(counter, electrical, simulation.counts()))
    assert still.gated == still.internal == 0 and still.clock == pytest.approx(everything.clock)


def test_delays_show_glitches_and_swallow_short_ones(tmp_path):
    netlists = Netlists(tmp_path)  # y = a ^ a, one way through `length` inverters
    chains = {"short": 2, "even": 4}
    for name, length in chains.items():
        nets = [2, *range(10, 10 + length)]
        inverters = [("INV", {"A": x, "Y": y}) for x, y in pairwise(nets)]
        netlists.add(name, {"a": ("input", [2]), "y": ("output", [5])}, [
            *inverters, ("XOR2", {"A": 2, "B": nets[-1], "Y": 5})])
    for name, length in chains.items():
        flat = netlists.flatten(name)
        for gate, glitches in ((5, 2), (10 * length + 5, 0)):  # the last gate is quicker than the chain, or slower
            inertia = np.full(len(flat.gate_output), 10)
            inertia[np.flatnonzero(flat.gate_output == flat.ports["y"][0])] = gate
            timed = Simulation(flat, CELLS, Delays(inertia, np.empty(0, np.int64), 100, 300))
            settled = Simulation(flat, CELLS)
            for simulation, wanted in ((timed, glitches), (settled, 0)):
                simulation.set("a", 1)
                simulation.settle()
                assert simulation.number("y") == 0 and simulation.check() == 0
                assert simulation.counts().toggles[flat.ports["y"][0]] == wanted


def test_delays_may_begin_in_the_middle(counter):
    electrical = analyse(counter, CELLS, 2.0)
    simulation = Simulation(counter, CELLS, delays_of(counter, electrical))
    values = []
    for cycle in range(20):
        simulation.timed = cycle % 5 < 2
        simulation.set("en", 1)
        simulation.settle()
        assert simulation.check() == 0
        values.append(simulation.number("q"))
        simulation.edge()
    assert np.unique(np.diff(values) % 4).tolist() == [1]


def test_loops_and_unknown_cells_are_refused(tmp_path):
    netlists = Netlists(tmp_path)
    netlists.add("loop", {"a": ("input", [2])}, [("AND2", {"A": 2, "B": 3, "Y": 4}), ("INV", {"A": 4, "Y": 3})])
    with pytest.raises(ValueError, match="no loop, not 2 gates"):
        netlists.flatten("loop")
    netlists.add("other", {"a": ("input", [2])}, [("NAND9", {"A": 2, "Y": 4})])
    with pytest.raises(KeyError, match="NAND9"):
        netlists.flatten("other")


def test_memories_read_write_and_bypass():
    pins = {"RD_ADDR": np.array([2, 3]), "RD_EN": np.array([4]), "RD_DATA": np.array([5, 6]), "WR_ADDR": np.array([7, 8]),
            "WR_EN": np.array([9, 10]), "WR_DATA": np.array([11, 12])}
    for transparent in (False, True):
        memory = Contents(Memory(4, 2, 1, 1, pins, np.array([[transparent]])))
        rng, words, last = np.random.default_rng(1), np.zeros((4, 2), int), np.zeros(2, int)
        counted = np.zeros(2, int)
        for _ in range(200):
            values = rng.integers(0, 2, 13).astype(np.uint8)
            read, write = values[2] + 2 * values[3], values[7] + 2 * values[8]
            data, enable = values[11:13], values[9:11].astype(bool)
            before = words.copy()
            words[write][enable] = data[enable]
            if values[4]:
                last = (words if transparent else before)[read].copy()
            counted += [values[4], enable.any()]
            assert memory.edge(values).tolist() == last.tolist()
        assert memory.accesses == counted.tolist()


def test_liberty_is_read(tmp_path):
    blocks = {"rise": 1.0, "fall": 3.0}
    tables = "".join(
        f"{kind} (t) {{\n index_1 (\"1, 2\");\n index_2 (\"3, 4\");\n"
        f" values ( \\\n \"{v}, {v}\", \\\n \"{v}, {v}\" \\\n );\n}}\n"
        for kind, v in ((f"cell_{way}", value) for way, value in blocks.items()))
    slews = tables.replace("cell_rise", "rise_transition").replace("cell_fall", "fall_transition")
    power = "".join(
        f"internal_power () {{\n related_pin : \"{pin}\";\n related_pg_pin : {rail};\n"
        + tables.replace("cell_rise", "rise_power").replace("cell_fall", "fall_power") + "}\n"
        for pin in "AB" for rail in ("VDD", "VSS"))
    timing = "".join(f"timing () {{\n related_pin : \"{pin}\";\n{tables}{slews}}}\n" for pin in "AB")
    pins = "".join(
        f"pin ({pin}) {{\n direction : input;\n rise_capacitance : 1;\n fall_capacitance : 2;\n}}\n" for pin in "AB")
    text = ("library (l) {\n  cell (NAND2) {\n area : 0.5\n leakage_power () {\n value : 9;\n when : \"A\";\n}\n"
            "leakage_power () {\n value : 7;\n}\npin (Y) {\n direction : output;\n function : \" (!A) + (!B)\";\n"
            f"{timing}{power}}}\n{pins}}}\n}}\n")
    path = tmp_path / "l.lib"
    path.write_text(text)
    cell = liberty.read_cells([path], ["NAND2"])["NAND2"]
    assert (cell.area, cell.leakage, cell.kind, cell.inputs) == (0.5, 7.0, "logic", ("A", "B"))
    assert cell.outputs["Y"].truth.tolist() == [1, 1, 1, 0] and cell.capacitance == {"A": 1.5, "B": 1.5}
    assert cell.outputs["Y"].energy["B"].values.tolist() == [[2, 2], [2, 2]]  # of one rail, rise and fall averaged
    assert cell.outputs["Y"].arcs["A"].delay.values.tolist() == [[2, 2], [2, 2]]
    with pytest.raises(KeyError, match="NOR9"):
        liberty.read_cells([path], ["NOR9"])


@pytest.mark.long
@pytest.mark.skipif("MSV2_PDK" not in os.environ, reason="needs liberty files")
def test_a_mapped_unit_does_what_golden_says(tmp_path):
    pytest.importorskip("pyosys")
    from msv2.studies.energy_per_operation.measure import Unequal, map_work, measure
    from spec.config import PAPER
    from tb.common.scenes import traced_frame
    mapped = map_work("line_buffer", PAPER, 1000.0, tmp_path)
    frame = traced_frame(PAPER, "embedded", "96x64")[1]
    row = measure(mapped, "line_buffer", PAPER, "embedded", frame)
    assert row["operations"] == row["cycles"] and row["items_compared"] > 500
    assert 0 < row["pj_per_operation"] < 1 and row["memories"][0]["reads_per_operation"] == 1
    flat = mapped.flat
    flat.gate_inputs[len(flat.gate_inputs) // 2] = flat.gate_inputs[len(flat.gate_inputs) // 3]
    with pytest.raises((Unequal, ValueError)):
        measure(mapped, "line_buffer", PAPER, "embedded", frame)


CHAIN = """\
module chain(a, b, clk, y, z);
  input a, b, clk; output y, z; wire n1, n2, n3, n4;
  INVx1_ASAP7_75t_R i1(.A(a), .Y(n1));
  INVx1_ASAP7_75t_R i2(.A(n1), .Y(n2));
  NAND2x1_ASAP7_75t_R i3(.A(n2), .B(b), .Y(n3));
  NAND2x1_ASAP7_75t_R i4(.A(n3), .B(n1), .Y(y));
  INVx1_ASAP7_75t_R i5(.A(n3), .Y(z));
endmodule
"""


@pytest.mark.long
@pytest.mark.skipif("MSV2_PDK" not in os.environ, reason="needs liberty files")
def test_cells_cost_what_opensta_says(tmp_path):
    """At one activity of all nets. OpenSTA of 2019 counts half of C V^2 / 2 for a net's toggle; without a clock, a second's."""
    if not timing.available():
        pytest.skip("needs OpenSTA")
    names = ["INVx1_ASAP7_75t_R", "NAND2x1_ASAP7_75t_R"]
    cells = liberty.read_cells(find_files(ASAP7), names)
    merged = tmp_path / "vdd.lib"
    merged.write_text(_one_rail(find_files(ASAP7), names))
    (tmp_path / "chain.v").write_text(CHAIN)
    activity = 0.2
    report = timing.run_sta("\n".join([
        f"read_liberty {merged}", f"read_verilog {tmp_path / 'chain.v'}", "link_design chain",
        "create_clock -name clk -period 1000 [get_ports clk]", "set_load 2.0 [all_outputs]",
        f"set_input_transition {INPUT_SLEW} [all_inputs]", f"set_power_activity -global -activity {activity} -duty 0.5",
        *(f"report_power -instances [get_cells i{i}] -digits 6" for i in range(1, 6)), ""]), tmp_path)
    theirs = {name: (float(internal), float(switching)) for internal, switching, name in re.findall(
        r"(?m)^\s*(\S+)\s+(\S+)\s+\S+\s+\S+\s+(i\d)$", report)}
    numbers = {net: 2 + i for i, net in enumerate(("a", "b", "n1", "n2", "n3", "y", "z"))}
    gates = [(name, kind, {pin: numbers[net] for pin, net in re.findall(r"\.(\w+)\((\w+)\)", pins)})
             for kind, name, pins in re.findall(r"(?m)^  (\w+_R) (\w+)\((.*)\);$", CHAIN)]
    netlists = Netlists(tmp_path)
    netlists.add("chain", {net: ("output" if net in "yz" else "input", [n]) for net, n in numbers.items()},
                 [(kind, pins) for _, kind, pins in gates])  # inner nets are ports that can be looked up, without a load
    flat = Flattener(netlists.paths, cells).flatten("chain")
    electrical, place = analyse(flat, cells, 2.0), {int(net): gate for gate, net in enumerate(flat.gate_output)}
    for name, _, pins in gates:
        net = next(int(flat.ports[net][0]) for net, n in numbers.items() if n == pins["Y"])
        internal = activity * electrical.gate_energy[place[net]] * 1e-18
        switching = activity * electrical.net_load[net] * VOLTAGE**2 / 2 * 1e-18
        assert theirs[name][0] == pytest.approx(internal, rel=0.1), name
        assert theirs[name][1] == pytest.approx(switching / 2, rel=0.03), name


def _one_rail(paths: list[Path], names: list[str]) -> str:
    """Some cells of a library, the energies of VDD alone; its first file's header and templates."""
    parts = []
    for path in paths:
        text = gzip.open(path, "rt").read() if path.suffix == ".gz" else path.read_text()
        starts = [(found[1], found.start()) for found in re.finditer(r"(?m)^  cell \((\w+)\) \{", text)]
        parts += [text[: starts[0][1]]] * (not parts)
        for (name, start), (_, end) in pairwise([*starts, ("", text.rstrip().rfind("}"))]):
            if name in names:
                parts.append(re.sub(
                    r"(?ms)^      internal_power \(\) \{\n(?:(?!^      \}).)*?related_pg_pin : \"?VSS\"?;.*?^      \}\n", "",
                    text[start:end]))
    return "".join(parts) + "}\n"
