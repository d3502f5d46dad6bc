"""Cuts the boxes of splats into super-rows, rows of super-tiles."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.supertiles.level_table import ROW_PLACES, axis_bits, row_bits
from spec.config import AcceleratorConfig
from spec.constants import SUPER_Y
from spec.records import Record, projected_splat

_TESTED = ("mean2d", "conic", "log2_opacity")
"""The fields of a splat that the ellipse test needs."""


def carried_row(config: AcceleratorConfig) -> data.StructLayout:
    """A super-row of a splat's box beside the ellipse test: its number `row`; `inside`, which of its tile rows are in the box;
    the box's columns; the splat's bound. `last` marks the splat's last super-row. An item with `end` is none; it follows the
    last one of a phase."""
    column = unsigned(axis_bits(config))
    return data.StructLayout({
        "row": unsigned(row_bits(config)), "inside": unsigned(SUPER_Y), "first_x": column, "last_x": column,
        "bound": unsigned(2), "last": 1, "end": 1})


def super_row_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A super-row of a splat's box, and what the ellipse test needs of the splat."""
    tested = tuple(f for f in projected_splat(config).fields if f.name in _TESTED)
    return data.StructLayout({"splat": layout(Record("Tested", "", tested)), "carried": carried_row(config)})


class SuperRows(wiring.Component):
    """Walks through the boxes of splats, one super-row at a time.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        splats: ProjectedSplat items.
        rows: `super_row_layout` items, for each splat those of its box from the top; and one with `end` for each one at the
            input.

    Throughput: one super-row a cycle, without gaps between splats. Latency: one cycle.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        super().__init__({
            "splats": In(stream.Signature(layout(projected_splat(config)))),
            "rows": Out(stream.Signature(super_row_layout(config)))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        splat, present = Signal.like(self.splats.payload, name="splat", reset_less=True), Signal()
        row, carried = Signal.like(self.rows.payload.carried.row, name="row", reset_less=True), self.rows.payload.carried
        begins, stops, leaves = Signal(), Signal(), Signal()
        m.d.comb += [
            begins.eq(row == splat.first_y[ROW_PLACES:]),
            stops.eq(row == splat.last_y[ROW_PLACES:]),
            leaves.eq(present & self.rows.ready),
            self.splats.ready.eq(~present | leaves & carried.last),
            self.rows.valid.eq(present),
            *(self.rows.payload.splat[name].eq(splat[name]) for name in _TESTED),
            carried.row.eq(row),
            carried.inside.eq(Cat(
                ~(begins & (splat.first_y[:ROW_PLACES] > i)) & ~(stops & (splat.last_y[:ROW_PLACES] < i))
                for i in range(SUPER_Y))),
            *(carried[name].eq(splat[name]) for name in ("first_x", "last_x", "bound", "end")),
            carried.last.eq(splat.end | stops),
        ]
        with m.If(leaves):
            m.d.sync += [row.eq(row + 1), present.eq(~carried.last)]
        with m.If(self.splats.valid & self.splats.ready):
            m.d.sync += [present.eq(1), splat.eq(self.splats.payload), row.eq(self.splats.payload.first_y[ROW_PLACES:])]
        return m
