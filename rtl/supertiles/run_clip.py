"""Cuts tested runs of tiles to the columns of their ellipse, and marks the last run of each super-row."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.level_table import GROUP_PLACES
from rtl.culling.tile_runs import PLACE
from spec.config import AcceleratorConfig
from spec.constants import SUPER_Y, TILE
from spec.records import TILE_BITS

_ROW_PLACES = SUPER_Y.bit_length() - 1


def row_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of a row of tiles."""
    return (-(-config.row_width // TILE) - 1).bit_length()


def carried_run(config: AcceleratorConfig) -> data.StructLayout:
    """A run beside the ellipse test: fields of `run_layout`, and `passes`: whether the foveation filter passes it."""
    return data.StructLayout({
        "row": unsigned(row_bits(config)), "group": unsigned(TILE_BITS - GROUP_PLACES), "begin": PLACE, "stop": PLACE,
        "level": unsigned(2), "passes": 1, "last": 1, "end": 1})


def tested_run(config: AcceleratorConfig) -> data.StructLayout:
    """A run with the result of the ellipse test: first and last tile column, and `none` where the ellipse meets no pixel."""
    return data.StructLayout({
        "first": unsigned(TILE_BITS), "last": unsigned(TILE_BITS), "none": 1, "carried": carried_run(config)})


def clipped_run(config: AcceleratorConfig) -> data.StructLayout:
    """A `carried_run` whose places `begin` to `stop` are those of the tiles that the splat touches, or `nothing`; and `closes`:
    whether it is the splat's last run in its super-row, a row of super-tiles."""
    return data.StructLayout({**carried_run(config).members, "nothing": 1, "closes": 1})


class RunClip(wiring.Component):
    """Finds the tiles of each run that the splat touches. A run waits until the next one of its splat has come, and so knows
    whether that lies in another super-row.

    Parameters:
        config: the machine.

    Ports:
        runs: `tested_run` items.
        clipped: `clipped_run` items, one for each run, in order.
        obb: all tiles of a run touch, whatever the ellipse test found.
        busy: a run is inside.

    Throughput: one run a cycle. Latency: one cycle, or more until the splat's next run comes.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        super().__init__({
            "runs": In(stream.Signature(tested_run(config))), "clipped": Out(stream.Signature(clipped_run(config))),
            "obb": In(1), "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        held, there = Signal(self.clipped.payload.shape(), reset_less=True), Signal()
        run, plan, out = self.runs.payload, self.runs.payload.carried, self.clipped
        group_first, group_last = run.first[GROUP_PLACES:], run.last[GROUP_PLACES:]
        places = slice(0, GROUP_PLACES)
        begin, stop, outside = Signal(PLACE), Signal(PLACE), Signal()
        m.d.comb += [
            begin.eq(Mux(~self.obb & (group_first == plan.group) & (run.first[places] > plan.begin),
                         run.first[places], plan.begin)),
            stop.eq(Mux(~self.obb & (group_last == plan.group) & (run.last[places] < plan.stop), run.last[places], plan.stop)),
            outside.eq((group_first > plan.group) | (group_last < plan.group) | (begin > stop)),
            out.valid.eq(there & (held.last | self.runs.valid)),
            out.payload.eq(held),
            out.payload.closes.eq(held.last | (held.row[_ROW_PLACES] != plan.row[_ROW_PLACES])),  # rows follow each other
            self.runs.ready.eq(~there | (out.valid & out.ready)),
            self.busy.eq(there),
        ]
        with m.If(self.runs.ready):
            m.d.sync += there.eq(self.runs.valid)
            with m.If(self.runs.valid):
                m.d.sync += [*(held[name].eq(plan[name]) for name in ("row", "group", "level", "passes", "last", "end")),
                             held.begin.eq(begin), held.stop.eq(stop), held.nothing.eq(~self.obb & (run.none | outside))]
        return m
