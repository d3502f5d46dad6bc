"""Cuts the boxes of splats into steps of as many tile rows as a super-tile has."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.supertiles.level_table import ROW_PLACES, axis_bits
from spec.config import AcceleratorConfig
from spec.constants import SUPER_Y
from spec.records import Record, projected_splat

_TESTED = ("mean2d", "conic", "log2_opacity")
"""The fields of a splat that the ellipse test needs."""


def carried_step(config: AcceleratorConfig) -> data.StructLayout:
    """A step beside the ellipse test: `row`, the first of its SUPER_Y tile rows; `inside`, which of them are in the splat's
    box; the box's columns; the splat's bound. `last` marks the splat's last step. An item with `end` is none; it follows the
    last one of a phase. With joint frames, `eye` is the splat's eye, whose `none` it also has."""
    axis = unsigned(axis_bits(config))
    return data.StructLayout({
        "row": axis, "inside": unsigned(SUPER_Y), "first_x": axis, "last_x": axis, "bound": unsigned(2), "last": 1, "end": 1,
        **({"eye": 1, "none": 1} if config.joint else {})})


def box_step_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A step of a splat's box, and what the ellipse test needs of the splat."""
    tested = tuple(f for f in projected_splat(config).fields if f.name in _TESTED)
    return data.StructLayout({"splat": layout(Record("Tested", "", tested)), "carried": carried_step(config)})


class BoxSteps(wiring.Component):
    """Walks through the boxes of splats, one step at a time.

    In the first phase the first step begins with the box's first row, so that a box of two rows takes one step wherever it
    lies; steps may then reach over the edge between two rows of super-tiles. In the second phase, in which a box lies in one
    super-tile, the step has the rows of this super-tile.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        splats: ProjectedSplat items.
        rendering: the phase is the second one.
        steps: `box_step_layout` items, for each splat those of its box from the top; and one with `end` for each one at the
            input.

    Throughput: one step a cycle, without gaps between splats. Latency: one cycle.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._same = ("first_x", "last_x", "bound", "end", *(("eye", "none") if config.joint else ()))
        super().__init__({
            "splats": In(stream.Signature(layout(projected_splat(config)))), "rendering": In(1),
            "steps": Out(stream.Signature(box_step_layout(config)))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        splat, present = Signal.like(self.splats.payload, name="splat", reset_less=True), Signal()
        carried, comes = self.steps.payload.carried, self.splats.payload
        row = Signal.like(carried.row, name="row", reset_less=True)
        rest = Signal.like(carried.row, name="rest", reset_less=True)  # rows from `row` to the box's last one, less 1
        above = Signal(ROW_PLACES, reset_less=True)  # rows of the step above the box
        start, begins, leaves = Signal.like(row), Signal.like(above), Signal()
        m.d.comb += [
            begins.eq(comes.first_y[:ROW_PLACES] & self.rendering.replicate(ROW_PLACES)), start.eq(comes.first_y - begins),
            leaves.eq(present & self.steps.ready),
            self.splats.ready.eq(~present | leaves & carried.last),
            self.steps.valid.eq(present),
            *(self.steps.payload.splat[name].eq(splat[name]) for name in _TESTED),
            carried.row.eq(row),
            carried.inside.eq(Cat((above <= i) & (rest >= i) for i in range(SUPER_Y))),
            *(carried[name].eq(splat[name]) for name in self._same),
            carried.last.eq(splat.end | (rest < SUPER_Y)),
        ]
        with m.If(leaves):
            m.d.sync += [row.eq(row + SUPER_Y), rest.eq(rest - SUPER_Y), above.eq(0), present.eq(~carried.last)]
        with m.If(self.splats.valid & self.splats.ready):
            m.d.sync += [present.eq(1), splat.eq(comes), row.eq(start), rest.eq(comes.last_y - start), above.eq(begins)]
        return m
