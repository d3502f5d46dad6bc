"""Loads, slews, delays and energies of every element of a flat netlist, from the library's tables, without wires.

Slews are means, over rise and fall and over all inputs of a gate. Inputs and clock arrive with the slews stated below, outputs
drive a given load, and a memory's pin has the capacitance MEMORY_PIN. A load or slew beyond a table uses the table's last row
or column.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.kernels import compiled
from synth.power.cells import Cell, Table
from synth.power.netlist import MOST_INPUTS, Flat

CLOCK_SLEW = 20.0
"""Slew of the clock in ps, as in timing (`synth.timing`)."""

INPUT_SLEW = 40.0
"""Slew of inputs in ps: that of a flip-flop of the library at a load of a few fF."""

MEMORY_PIN = 1.0
"""Capacitance of a memory's pin in fF: that of two inverters of the library."""

_SIDE = 7


@dataclass(frozen=True)
class Electrical:
    """The electrical values of a flat netlist in ps, fF, fJ and pW; each array has one value per element or per net.

    Attributes:
        gate_delay, flop_delay: delay to the output.
        gate_energy, flop_energy, icg_energy: energy dissipated in the cell by a toggle of the output.
        net_load: capacitance of the net.
        net_passive: energy that a toggle of the net costs in the inputs of flip-flops and clock gates, whatever they do then.
        flop_clock, icg_clock: energy in the cell for a cycle of its clock, without that of the clock net.
        flop_clock_load, icg_clock_load: capacitance of the clock pin.
        gate_leakage, flop_leakage, icg_leakage: leakage of the cell; a cell with two outputs counts half at each.
    """

    gate_delay: np.ndarray
    flop_delay: np.ndarray
    gate_energy: np.ndarray
    flop_energy: np.ndarray
    icg_energy: np.ndarray
    net_load: np.ndarray
    net_passive: np.ndarray
    flop_clock: np.ndarray
    icg_clock: np.ndarray
    flop_clock_load: np.ndarray
    icg_clock_load: np.ndarray
    gate_leakage: np.ndarray
    flop_leakage: np.ndarray
    icg_leakage: np.ndarray


def analyse(flat: Flat, cells: dict[str, Cell], output_load: float) -> Electrical:
    """The electrical values of a netlist; `output_load` is in fF."""
    load, passive = _loads(flat, cells, output_load)
    library = _Tables(flat, cells)
    slew = np.full(flat.nets, INPUT_SLEW)
    flops = [cells[name] for name in flat.cells]
    flop_load = load[flat.flop_output]
    flop_delay, flop_slew, flop_energy = (
        _of_cells(flat.flop_cell, flops, what, CLOCK_SLEW, flop_load) for what in ("delay", "slew", "energy"))
    slew[flat.flop_output] = flop_slew
    gate_delay, gate_energy = _walk(
        flat.gate_inputs, library.inputs, flat.gate_output, flat.gate_type, library.values, library.slews, library.loads,
        load, slew)
    edge = np.array([cell.edge.at(CLOCK_SLEW) if cell.kind == "flop" else 0.0 for cell in flops])
    clock = np.array([cell.passive["CLK"].at(CLOCK_SLEW) if cell.kind == "flop" else 0.0 for cell in flops])
    pin = np.array([cell.capacitance["CLK"] if cell.kind == "flop" else 0.0 for cell in flops])
    leakage = np.array([cell.leakage for cell in flops])
    gates = np.full(len(flat.icg_output), -1)
    gate_cells = [cell for cell in cells.values() if cell.kind == "gate"]
    if len(gate_cells) > 1:
        raise ValueError(f"netlists must have one kind of clock gate, not {[cell.name for cell in gate_cells]!r}")
    icg = gate_cells[0] if gate_cells else None
    types = np.array([cells[cell].leakage / len(cells[cell].outputs) for cell, _ in flat.types])
    clocked = np.bincount(flat.flop_clock[flat.flop_clock >= 0], pin[flat.flop_cell[flat.flop_clock >= 0]], len(gates))
    icg_energy = _of_cells(np.zeros(len(gates), np.int64), [icg], "energy", CLOCK_SLEW, clocked) if len(gates) else np.empty(0)
    full = np.ones(len(gates))
    return Electrical(
        gate_delay, flop_delay, gate_energy, np.maximum(flop_energy - edge[flat.flop_cell], 0), icg_energy, load, passive,
        clock[flat.flop_cell], full * (icg.passive["CLK"].at(CLOCK_SLEW) if icg else 0), pin[flat.flop_cell],
        full * (icg.capacitance["CLK"] if icg else 0), types[flat.gate_type], leakage[flat.flop_cell],
        full * (icg.leakage if icg else 0))


def _loads(flat: Flat, cells: dict[str, Cell], output_load: float) -> tuple[np.ndarray, np.ndarray]:
    """Capacitance of every net, and the energy of its toggles in inputs of registers. Clock nets are left at 0."""
    caps = np.zeros((len(flat.types), MOST_INPUTS))
    for i, (name, _) in enumerate(flat.types):
        cell = cells[name]
        outputs = len(cell.outputs)  # an adder is two elements with the same input pins
        caps[i, : len(cell.inputs)] = [cell.capacitance[pin] / outputs for pin in cell.inputs]
    load = np.bincount(flat.gate_inputs.ravel(), caps[flat.gate_type].ravel(), flat.nets)
    flops = [cells[name] for name in flat.cells]
    pin = np.array([cell.capacitance["D"] if cell.kind == "flop" else 0.0 for cell in flops])
    load += np.bincount(flat.flop_data, pin[flat.flop_cell], flat.nets)
    data = np.array([cell.passive["D"].at(INPUT_SLEW) if cell.kind == "flop" else 0.0 for cell in flops])
    passive = np.bincount(flat.flop_data, data[flat.flop_cell], flat.nets)
    for cell in cells.values():
        if cell.kind == "gate":
            for nets, name in ((flat.icg_enable, "ENA"), (flat.icg_test, "SE")):
                load += np.bincount(nets, np.full(len(nets), cell.capacitance[name]), flat.nets)
                passive += np.bincount(nets, np.full(len(nets), cell.passive[name].at(INPUT_SLEW)), flat.nets)
    memory = {f"memory{k}_" for k in range(64)}
    for name, nets in flat.ports.items():
        if name not in flat.inputs and not any(name.startswith(prefix) for prefix in memory):
            np.add.at(load, nets, output_load)
    for m in flat.memories:
        for name, nets in m.pins.items():
            if name != "RD_DATA":
                np.add.at(load, np.unique(nets), MEMORY_PIN)
    load[:2] = passive[:2] = 0
    return load, passive


def _of_cells(kinds: np.ndarray, cells: list[Cell], what: str, slew: float, loads: np.ndarray) -> np.ndarray:
    """For each element a value from the table of the arc from its clock."""
    found = np.zeros(len(kinds))
    for i, cell in enumerate(cells):
        here = kinds == i
        if here.any():
            (output,) = cell.outputs.values()
            table = output.energy["CLK"] if what == "energy" else getattr(output.arcs["CLK"], what)
            found[here] = [lookup(table, slew, load) for load in loads[here]]
    return found


def lookup(table: Table, slew: float, load: float) -> float:
    """The value of a table at an input slew in ps and a load in fF, interpolated."""
    column = [np.interp(load, table.loads, row) for row in table.values]
    return float(np.interp(slew, table.slews, column))


class _Tables:
    """The library's tables for all types of gates as arrays: (type, input, delay | slew | energy, slew, load)."""

    def __init__(self, flat: Flat, cells: dict[str, Cell]):
        shape = len(flat.types), MOST_INPUTS
        self.values = np.zeros((*shape, 3, _SIDE, _SIDE))
        self.slews, self.loads = np.ones((*shape, _SIDE)).cumsum(-1), np.ones((*shape, _SIDE)).cumsum(-1)
        self.inputs = np.zeros(len(flat.types), np.int64)
        for i, (name, pin) in enumerate(flat.types):
            cell = cells[name]
            if cell.kind != "logic":
                continue
            self.inputs[i] = len(cell.inputs)
            for j, source in enumerate(cell.inputs):
                output = cell.outputs[pin]
                arc = output.arcs[source]
                energy = output.energy.get(source)
                self.values[i, j, 0], self.values[i, j, 1] = arc.delay.values, arc.slew.values
                self.values[i, j, 2] = 0 if energy is None else energy.values
                self.slews[i, j], self.loads[i, j] = arc.delay.slews, arc.delay.loads


@compiled
def _walk(inputs, counts, outputs, types, tables, slews, loads, load, slew) -> tuple[np.ndarray, np.ndarray]:
    """Delays and energies of the gates, computed in order of evaluation; fills in the slews of their outputs."""
    delay, energy = np.zeros(len(outputs)), np.zeros(len(outputs))
    sums = np.zeros(3)
    for g in range(len(outputs)):
        kind, net = types[g], outputs[g]
        sums[:] = 0
        for j in range(counts[kind]):
            s, c = _place(slews[kind, j], slew[inputs[g, j]]), _place(loads[kind, j], load[net])
            i, k = int(s), int(c)
            a, b = s - i, c - k
            for t in range(3):
                table = tables[kind, j, t]
                sums[t] += ((1 - a) * ((1 - b) * table[i, k] + b * table[i, k + 1])
                            + a * ((1 - b) * table[i + 1, k] + b * table[i + 1, k + 1]))
        count = max(counts[kind], 1)
        delay[g], slew[net], energy[g] = sums[0] / count, sums[1] / count, sums[2] / count
    return delay, energy


@compiled
def _place(points, x) -> float:
    """The position of x between points, as a row plus a fraction; clamped to the table."""
    if x <= points[0]:
        return 0.0
    for i in range(len(points) - 1):
        if x < points[i + 1]:
            return i + (x - points[i]) / (points[i + 1] - points[i])
    return len(points) - 1 - 1e-9
