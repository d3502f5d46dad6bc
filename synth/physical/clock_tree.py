"""Buffers and wires of a clock over placed flip-flops, and the energy that they take in a cycle.

A tree is built from its leaves up. The sinks are halved by place, along the longer side of what they cover, until a buffer can
drive each part with its wires; the buffers, each in the middle of its part, are then the sinks of the next level, until one
is left. It is no balanced tree: skew is not looked at, and insertion delay has no effect on a clock that is ideal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from synth.physical.parasitics import WireModel, spanning_tree
from synth.power.cells import Cell
from synth.power.electrical import CLOCK_SLEW, lookup
from synth.power.energy import VOLTAGE

MOST_LOAD_FF = 20.0
"""What a buffer of the tree drives at most: at that load the tree's buffer, BUFx5, has a slew of about the clock's 20 ps."""


@dataclass(frozen=True)
class Sink:
    """A pin on the clock: its place in nm, and its capacitance in fF."""

    x: int
    y: int
    ff: float


@dataclass(frozen=True)
class ClockTree:
    """A tree.

    Attributes:
        sinks: number of pins that it clocks.
        buffers: number of buffers.
        um: length of its wires.
        wire_fj, buffer_fj: energy of a cycle in the wires, and in the buffers with their input pins.
        sink_fj: energy of a cycle in the pins that are clocked: their capacitance alone.
    """

    sinks: int
    buffers: int
    um: float
    wire_fj: float
    buffer_fj: float
    sink_fj: float

    @property
    def tree_fj(self) -> float:
        """Energy of a cycle in front of the clocked pins."""
        return self.wire_fj + self.buffer_fj


def build(sinks: Sequence[Sink], buffer: Cell, model: WireModel) -> ClockTree:
    """The tree of a clock whose source is at the last buffer.

    Args:
        sinks: what is clocked.
        buffer: a cell with one input and one output.
        model: what a wire costs.

    Raises:
        ValueError: a sink alone is more than a buffer drives.
    """
    (pin,), (output,) = buffer.inputs, buffer.outputs.values()
    square, buffers, um, cell_fj = VOLTAGE ** 2, 0, 0.0, 0.0
    level = list(sinks)
    while len(level) > 1 or not buffers:
        parents = []
        for part in _parts(level, model):
            length = _length(part)
            load = sum(sink.ff for sink in part) + length * model.ff_per_um
            cell_fj += 2 * lookup(output.energy[pin], CLOCK_SLEW, load)  # a rise and a fall
            parents.append(Sink(*_middle(part), buffer.capacitance[pin]))
            um += length
        buffers += len(parents)
        level = parents
    pins_fj = buffers * buffer.capacitance[pin] * square
    return ClockTree(
        len(sinks), buffers, um, um * model.ff_per_um * square, cell_fj + pins_fj, sum(sink.ff for sink in sinks) * square)


def _length(part: Sequence[Sink]) -> float:
    """Length in um of the wires from a buffer in the middle of its sinks."""
    return sum(edge.um for edge in spanning_tree([_middle(part), *((sink.x, sink.y) for sink in part)]))


def _middle(part: Sequence[Sink]) -> tuple[int, int]:
    return int(np.mean([sink.x for sink in part])), int(np.mean([sink.y for sink in part]))


def _parts(sinks: Sequence[Sink], model: WireModel) -> list[list[Sink]]:
    """The sinks in parts that a buffer can drive."""
    if sum(sink.ff for sink in sinks) + _length(sinks) * model.ff_per_um <= MOST_LOAD_FF:
        return [list(sinks)]
    if len(sinks) == 1:
        raise ValueError(f"a clocked pin must have at most {MOST_LOAD_FF} fF, not {sinks[0].ff}")
    width, height = (max(getattr(s, axis) for s in sinks) - min(getattr(s, axis) for s in sinks) for axis in "xy")
    ordered = sorted(sinks, key=lambda sink: (sink.x, sink.y) if width > height else (sink.y, sink.x))
    half = len(ordered) // 2
    return _parts(ordered[:half], model) + _parts(ordered[half:], model)
