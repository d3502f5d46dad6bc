"""Wires of a placed netlist: a tree over the pins of each net, and the file from which OpenSTA reads what they cost (SPEF).

A net's tree is its shortest spanning tree by rectilinear distance. A router needs more (detours) and less (Steiner points,
which save a few percent); neither is modelled. Each edge of the tree is a resistance, half of its capacitance is at each end,
and each pin has the vias up to the layers of the wires and down again. Clocks have no wires here: `synth.physical.clock_tree`.

The file holds the pins' capacitances as well, and is read with `-pin_cap_included`: Debian's OpenSTA adds the smallest
capacitance of a pin's range to what a file says of its wires, but the pin's own to a net of which no file says anything, so
that short wires would make a unit faster.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from synth.physical.lef import NM
from synth.physical.placement import Placement, Terminal

_HEAD = """\
*SPEF "IEEE 1481-1998"
*DESIGN "{}"
*DATE ""
*VENDOR "msv2"
*PROGRAM "msv2"
*VERSION "1"
*DESIGN_FLOW ""
*DIVIDER /
*DELIMITER :
*BUS_DELIMITER [ ]
*T_UNIT 1 PS
*C_UNIT 1 FF
*R_UNIT 1 OHM
*L_UNIT 1 HENRY

"""

LEAST_OHM = 0.01
"""A resistance of zero is none to a reader of SPEF."""

PinLoad = Callable[[Terminal], float]
"""The capacitance of an end of a net in fF."""


@dataclass(frozen=True)
class WireModel:
    """What a wire costs.

    Attributes:
        ohm_per_um, ff_per_um: resistance and capacitance of a micrometre.
        via_ohm: resistance of the vias at the two ends of an edge.
        source: where the numbers come from.
    """

    ohm_per_um: float
    ff_per_um: float
    via_ohm: float
    source: str


ASAP7_WIRES = WireModel(
    26.57, 0.166, 2 * (17.2 + 11.8), "OpenROAD-flow-scripts, platform asap7: layers M2 and M3 and the vias below them")

NO_WIRES = WireModel(0.0, 0.0, 0.0, "pins alone, for comparison")


@dataclass(frozen=True)
class Edge:
    """A piece of a tree between two of a net's terminals, by index; its length in um."""

    start: int
    end: int
    um: float


def spanning_tree(points: Sequence[tuple[int, int]]) -> list[Edge]:
    """The shortest tree over points in nm, by rectilinear distance (Prim's algorithm)."""
    at = np.asarray(points, np.int64).reshape(-1, 2)
    nearest, near = np.full(len(at), np.iinfo(np.int64).max), np.zeros(len(at), np.int64)
    outside, new, edges = np.ones(len(at), bool), 0, []
    for _ in range(len(at) - 1):
        outside[new] = False
        distance = np.abs(at - at[new]).sum(axis=1)
        closer = outside & (distance < nearest)
        nearest[closer], near[closer] = distance[closer], new
        new = int(np.argmin(np.where(outside, nearest, np.iinfo(np.int64).max)))
        edges.append(Edge(int(near[new]), new, float(nearest[new]) / NM))
    return edges


@dataclass(frozen=True)
class Wires:
    """The trees of all nets but clocks, by the net's bit."""

    trees: Mapping[str, list[Edge]]

    @property
    def um(self) -> float:
        """Length of all wires."""
        return sum(edge.um for tree in self.trees.values() for edge in tree)


def route(placement: Placement) -> Wires:
    """A tree for each net of a placement that is no clock."""
    return Wires({bit: spanning_tree([(end.x, end.y) for end in ends])
                  for bit, ends in placement.nets.items() if bit not in placement.clocks})


def write_spef(path: Path, placement: Placement, wires: Wires, model: WireModel, pin_ff: PinLoad) -> None:
    """Write the wires of a placement as SPEF, with the capacitances of the pins (`pin_ff`, fF) at their ends."""
    with path.open("w") as file:
        file.write(_HEAD.format(placement.netlist.name))
        for bit, tree in wires.trees.items():
            file.writelines(line + "\n" for line in _net(bit, tree, placement, model, pin_ff))


def _net(bit: str, tree: Sequence[Edge], placement: Placement, model: WireModel, pin_ff: PinLoad) -> Iterator[str]:
    ends = placement.nets[bit]
    nodes = [_node(end, placement) for end in ends]
    at = [pin_ff(end) for end in ends]
    for edge in tree:
        for end in (edge.start, edge.end):
            at[end] += edge.um * model.ff_per_um / 2
    yield f"*D_NET {escaped(bit)} {sum(at):.5f}"
    yield "*CONN"
    for end, node in zip(ends, nodes, strict=True):
        # A port that drives the net is an input of the unit, a pin that does is an output of a cell.
        yield f"*{'P' if end.owner < 0 else 'I'} {node} {'I' if end.drives == (end.owner < 0) else 'O'}"
    yield "*CAP"
    yield from (f"{k} {node} {value:.5f}" for k, (node, value) in enumerate(zip(nodes, at, strict=True), 1))
    yield "*RES"
    for k, edge in enumerate(tree, 1):
        ohm = max(edge.um * model.ohm_per_um + model.via_ohm, LEAST_OHM)
        yield f"{k} {nodes[edge.start]} {nodes[edge.end]} {ohm:.3f}"
    yield "*END\n"


def _node(end: Terminal, placement: Placement) -> str:
    return escaped(end.name) if end.owner < 0 else f"{escaped(placement.netlist.instances[end.owner].name)}:{end.name}"


def escaped(name: str) -> str:
    """A name of Verilog as SPEF has it: without the escape of the whole name, and with every special character escaped.

    The index of a bit of a vector stays as it is.
    """
    plain, index = re.fullmatch(r"(.*?)((?:\[\d+\])?)", name, re.DOTALL).groups()
    if not name.startswith("\\"):
        return name
    return re.sub(r"([^\w/])", r"\\\1", plain[1:].strip()) + index
