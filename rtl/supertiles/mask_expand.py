"""Turns the runs of splats that lie in one super-tile each into masks of its tiles."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.tile_expand import kept_record
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.run_clip import clipped_run
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X, SUPER_Y
from spec.records import surviving_splat

_PLACES, _ROW_PLACES = SUPER_X.bit_length() - 1, SUPER_Y.bit_length() - 1


class MaskExpand(wiring.Component):
    """Collects the tiles in which a splat has intersections, and their levels, until its last run has come.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        runs: `clipped_run` items; those of a splat lie in one super-tile. None has `end`.
        splats: `kept_record` items, one per splat; each is taken with its splat's last run.
        survivors: SurvivingSplat items, one per splat, in order.
        busy: runs of a splat are inside, but not its last.

    Throughput: one run a cycle. Latency: one cycle from a splat's last run.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        super().__init__({
            "runs": In(stream.Signature(clipped_run(config))),
            "splats": In(stream.Signature(layout(kept_record(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.leaving = leaving = Buffer(self.survivors.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.survivors))
        run, kept, survivor = self.runs.payload, self.splats.payload, leaving.sink.payload
        mask, levels, tiles, taken = Signal(SUPER_TILES), Signal(MAX_LEVELS), Signal(SUPER_X), Signal()
        all_tiles, all_levels = Signal.like(mask), Signal.like(levels)
        emits = run.passes & ~run.nothing
        m.d.comb += [
            tiles.eq(Cat(
                emits & (run.begin[:_PLACES] <= i) & (i <= run.stop[:_PLACES]) for i in range(SUPER_X))),
            all_tiles.eq(mask | Cat(
                Mux(run.row[:_ROW_PLACES] == row, tiles, 0) for row in range(SUPER_Y))),
            all_levels.eq(levels | (emits << run.level)),
            self.runs.ready.eq(self.splats.valid & (leaving.sink.ready | ~run.last)),
            taken.eq(self.runs.valid & self.runs.ready),
            self.splats.ready.eq(taken & run.last),
            leaving.sink.valid.eq(taken & run.last),
            survivor.mask.eq(all_tiles), survivor.levels.eq(all_levels),
            *(survivor[name].eq(kept[name]) for name in kept.shape().members if name in survivor.shape().members),
            self.busy.eq(mask.any()),
        ]
        with m.If(taken):
            m.d.sync += [mask.eq(Mux(run.last, 0, all_tiles)), levels.eq(Mux(run.last, 0, all_levels))]
        return m
