"""Places a flat netlist of library cells in rows, with coloquinte (PyPI): global placement, legalisation, detailed placement.

    placement = place(read(flat_netlist), read_lef(lef), clocks={"clk"}, density=0.8, log=log)

The die is as square as whole rows allow. The unit's ports lie on its border, in the order of the directions in which the cells
that they lead to lie from the die's centre; that order comes from a first global placement.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError
from spec.extras import how_to_get
from synth.netlist import CONSTANTS, Netlist
from synth.physical.lef import CellShape
from synth.quiet import printing_to

try:
    from coloquinte import Circuit, Rectangle
except ImportError:
    Circuit = Rectangle = None

CLOCK_WEIGHT = 0.3
"""Weight of a clock's net in the placement: a tree of buffers will cut it, so its length counts for less."""


@dataclass(frozen=True)
class Terminal:
    """An end of a net.

    Attributes:
        owner: index of the instance in the netlist; for a port, -1.
        name: the pin's name, or the port bit's.
        drives: it is an output of a cell or an input of the unit.
        x, y: its place in nm.
    """

    owner: int
    name: str
    drives: bool
    x: int
    y: int


@dataclass(frozen=True)
class Placement:
    """A placed netlist.

    Attributes:
        netlist: what was placed.
        width, height: of the die, nm.
        density: area of the cells over that of the die.
        nets: the ends of every net that has two or more, by the net's bit.
        clocks: nets that are clocks.
    """

    netlist: Netlist
    width: int
    height: int
    density: float
    nets: Mapping[str, tuple[Terminal, ...]]
    clocks: frozenset[str]


def available() -> bool:
    """Whether coloquinte is installed."""
    return Circuit is not None


def place(
    netlist: Netlist, cells: Mapping[str, CellShape], clocks: Collection[str], density: float, log: Path, effort: int = 3,
) -> Placement:
    """A legal placement.

    Args:
        netlist: all instances are cells of the library.
        cells: sizes and pins of the library's cells.
        clocks: nets that are clocks.
        density: share of the die that cells take, 0.3..0.95.
        log: file to which coloquinte's output is appended.
        effort: of coloquinte, 1..9.

    Raises:
        InputError: coloquinte is missing, a cell has no shape, or density or effort are out of range.
    """
    if Circuit is None:
        raise InputError(f"coloquinte is not installed; {how_to_get('coloquinte')}")
    if not 0.3 <= density <= 0.95:
        raise InputError(f"density must lie in 0.3..0.95, not {density!r}")
    if effort not in range(1, 10):
        raise InputError(f"effort must be 1..9, not {effort!r}")
    unknown = sorted({instance.kind for instance in netlist.instances} - cells.keys())
    if unknown:
        raise InputError(f"the LEF file has no cells {', '.join(unknown)}")
    shapes = [cells[instance.kind] for instance in netlist.instances]
    width, height = _die(shapes, density)
    problem = _Problem(netlist, shapes, clocks, width, height)
    with printing_to(log):
        problem.solve(effort)
    area = sum(shape.width * shape.height for shape in shapes)
    return Placement(netlist, width, height, area / (width * height), problem.terminals(), frozenset(clocks))


def _die(shapes: Sequence[CellShape], density: float) -> tuple[int, int]:
    """Width and height in nm: whole rows, and a width of whole sites of the narrowest cell's kind."""
    area, row = sum(shape.width * shape.height for shape in shapes), shapes[0].height
    rows = max(1, round(math.sqrt(area / density) / row))
    site = math.gcd(*(shape.width for shape in shapes))
    return math.ceil(area / density / (rows * row) / site) * site, rows * row


class _Problem:
    """coloquinte's circuit for a netlist: its cells are the instances, then the bits of the ports, which are fixed."""

    def __init__(
        self, netlist: Netlist, shapes: Sequence[CellShape], clocks: Collection[str], width: int, height: int,
    ) -> None:
        self._netlist, self._shapes, self._width, self._height = netlist, shapes, width, height
        self._ports = [(bit, direction == "input") for name, (direction, _) in netlist.ports.items()
                       for bit in netlist.bits(name)]
        self._nets = self._connect()
        self._circuit = self._build(clocks)

    def _connect(self) -> dict[str, list[tuple[int, str]]]:
        """For each net of two or more ends: index of the circuit's cell, and name of the pin."""
        alias = dict(self._netlist.assigns)
        nets: dict[str, list[tuple[int, str]]] = {}
        for index, instance in enumerate(self._netlist.instances):
            for pin, (bit,) in instance.pins.items():
                nets.setdefault(_source(bit, alias), []).append((index, pin))
        for index, (bit, _) in enumerate(self._ports, len(self._netlist.instances)):
            nets.setdefault(_source(bit, alias), []).append((index, bit))
        return {bit: ends for bit, ends in nets.items() if len(ends) > 1 and bit not in CONSTANTS}

    def _build(self, clocks: Collection[str]) -> Circuit:
        ports, inside = len(self._ports), len(self._shapes)
        circuit = Circuit(inside + ports)
        circuit.cell_width = [shape.width for shape in self._shapes] + [0] * ports
        circuit.cell_height = [shape.height for shape in self._shapes] + [0] * ports
        circuit.cell_is_fixed = [False] * inside + [True] * ports
        circuit.cell_is_obstruction = [True] * inside + [False] * ports
        for bit, ends in self._nets.items():
            pins = [self._shapes[index].pins[pin] if index < inside else None for index, pin in ends]
            circuit.add_net([index for index, _ in ends], [pin.x if pin else 0 for pin in pins],
                            [pin.y if pin else 0 for pin in pins], CLOCK_WEIGHT if bit in clocks else 1.0)
        circuit.setup_rows(Rectangle(0, self._width, 0, self._height), self._shapes[0].height, True, True)
        return circuit

    def solve(self, effort: int) -> None:
        """Places, the ports first in the order of the netlist, then by the cells that they lead to."""
        inside, circuit = len(self._shapes), self._circuit
        centre = [self._width // 2] * inside, [self._height // 2] * inside
        self._set(*centre, list(range(len(self._ports))))
        circuit.place_global(effort)
        placed = list(circuit.cell_x)[:inside], list(circuit.cell_y)[:inside]
        self._set(*placed, self._around(*placed))
        circuit.place_global(effort)
        circuit.legalize(effort)
        circuit.place_detailed(effort)
        circuit.check()

    def _set(self, x: list[int], y: list[int], order: Sequence[int]) -> None:
        border = [_on_border((place + 0.5) / len(order), self._width, self._height) for place in range(len(order))]
        at = {port: border[place] for place, port in enumerate(order)}
        self._circuit.cell_x = x + [at[port][0] for port in range(len(order))]
        self._circuit.cell_y = y + [at[port][1] for port in range(len(order))]

    def _around(self, x: Sequence[int], y: Sequence[int]) -> list[int]:
        """The ports in the order of the angles at which the cells that they lead to are seen from the centre."""
        inside, angles = len(self._shapes), {}
        for ends in self._nets.values():
            cells = [index for index, _ in ends if index < inside]
            for port in (index - inside for index, _ in ends if index >= inside):
                dx = sum(x[index] for index in cells) / max(1, len(cells)) - self._width / 2
                dy = sum(y[index] for index in cells) / max(1, len(cells)) - self._height / 2
                angles[port] = math.atan2(dy, dx) % (2 * math.pi)
        return sorted(range(len(self._ports)), key=lambda port: (angles.get(port, 0.0), port))

    def terminals(self) -> dict[str, tuple[Terminal, ...]]:
        """The placed ends of each net."""
        circuit, inside = self._circuit, len(self._shapes)
        places = list(zip(circuit.cell_x, circuit.cell_y, (item.name for item in circuit.cell_orientation), strict=True))

        def terminal(index: int, pin: str) -> Terminal:
            x, y, turned = places[index]
            if index >= inside:
                return Terminal(-1, pin, self._ports[index - inside][1], x, y)
            shape = self._shapes[index]
            found = shape.pins[pin]
            dx = shape.width - found.x if turned in ("S", "FN") else found.x
            dy = shape.height - found.y if turned in ("S", "FS") else found.y
            return Terminal(index, pin, found.is_output, x + dx, y + dy)

        return {bit: tuple(terminal(index, pin) for index, pin in ends) for bit, ends in self._nets.items()}


def _source(bit: str, alias: Mapping[str, str]) -> str:
    while bit in alias:
        bit = alias[bit]
    return bit


def _on_border(share: float, width: int, height: int) -> tuple[int, int]:
    """The point at a share of the way around a die, from the middle of its right side against the clock."""
    way = (share * 2 * (width + height) + height / 2) % (2 * (width + height))
    for length, point in (
            (height, lambda s: (width, s)), (width, lambda s: (width - s, height)),
            (height, lambda s: (0, height - s)), (width, lambda s: (s, 0))):
        if way <= length:
            x, y = point(way)
            return round(x), round(y)
        way -= length
    return width, 0
