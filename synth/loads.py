"""Capacitance limits of a linked machine: what every cell drives, across all its modules, against its `max_capacitance`.

Debian's OpenSTA has no check of them. Loads are those of pins; there are no wires.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from synth.discover import read_cells
from synth.macro_timing import MOST_FF, MemoryCell
from synth.netlist import CONSTANTS, Netlist

IDEAL = ("clk", "rst")
"""Ports of modules that have no limits."""


@dataclass(frozen=True)
class Pins:
    """The pins of a cell: the input capacitance of inputs, and the largest load of outputs, in fF."""

    inputs: dict[str, float] = field(default_factory=dict)
    outputs: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Overload:
    """A net whose driver has more to drive than its limit: its module and name, the load, and the limit."""

    module: str
    net: str
    load_ff: float
    limit_ff: float


@dataclass
class Edges:
    """A module seen from outside, by bit of its ports: what inputs load, and the limit and own load of outputs' drivers."""

    loads: dict[str, list[float]] = field(default_factory=dict)
    drivers: dict[str, dict[int, tuple[float, float]]] = field(default_factory=dict)


def pins_of(library: Path) -> dict[str, Pins]:
    """The pins of all cells of a liberty file in fF, without clocks; an output without a limit may drive anything."""
    found = {}
    for cell in read_cells(library)[1]:
        pins = found[cell.name] = Pins()
        for name, pin in cell.pins.items():
            if {"true"} & {pin.attributes.get(key) for key in ("clock", "clock_gate_clock_pin")}:
                continue
            if pin.is_input:
                pins.inputs[name] = float(pin.attributes.get("capacitance", 0.0))
            else:
                pins.outputs[name] = float(pin.attributes.get("max_capacitance", "inf"))
    return found


def memory_pins(cells: Iterable[MemoryCell]) -> dict[str, Pins]:
    """The pins of memories, which have no limit but that of their macros' files."""
    return {cell.name: Pins({pin: cell.timing.pin_ff for pin in cell.pins if pin != "rd_data"}, {"rd_data": MOST_FF})
            for cell in cells}


def overloads(netlists: Iterable[Netlist], cells: Mapping[str, Pins]) -> list[Overload]:
    """The nets of a machine that are loaded beyond the limit of their driver, the worst first.

    `netlists`: its modules, lower ones first, and the machine last. A net that leaves its module is judged in the outermost one
    that it reaches, and named there. Clocks and the reset have no limits: trees would distribute them.
    """
    found: list[Overload] = []
    known: dict[str, Edges] = {}
    for netlist in netlists:
        known[netlist.name], own = _seen(netlist, cells, known)
        found += own
    return sorted(found, key=lambda one: (one.limit_ff - one.load_ff, one.module, one.net))


def _seen(netlist: Netlist, cells: Mapping[str, Pins], known: Mapping[str, Edges]) -> tuple[Edges, list[Overload]]:
    """A module from outside, and its overloaded nets that do not leave it."""
    source = dict(netlist.assigns)

    def root(bit: str) -> str:
        while bit in source:
            bit = source[bit]
        return bit

    load: dict[str, float] = defaultdict(float)
    drivers: dict[str, tuple[float, float]] = {}
    for instance in netlist.instances:
        pins, edges = cells.get(instance.kind, Pins()), known.get(instance.kind, Edges())
        for pin, bits in instance.pins.items():
            for i, bit in enumerate(map(root, bits)):
                if pin in IDEAL or bit in CONSTANTS:
                    continue
                load[bit] += pins.inputs.get(pin, 0.0) + (edges.loads[pin][i] if pin in edges.loads else 0.0)
                driver = (pins.outputs[pin], 0.0) if pin in pins.outputs else edges.drivers.get(pin, {}).get(i)
                if driver is not None:
                    drivers[bit] = driver
    seen, leaving = Edges(), set()
    for port, (direction, _) in netlist.ports.items():
        bits = [root(bit) for bit in netlist.bits(port)]
        if direction == "input":
            seen.loads[port.strip()] = [load.get(bit, 0.0) for bit in bits]
        else:
            leaving.update(bits)
            seen.drivers[port.strip()] = {
                i: (drivers[bit][0], drivers[bit][1] + load[bit]) for i, bit in enumerate(bits) if bit in drivers}
    return seen, [
        Overload(netlist.name, bit.strip(), round(below + load[bit], 2), limit) for bit, (limit, below) in drivers.items()
        if below + load[bit] > limit and bit not in leaving]
