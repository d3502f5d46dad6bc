"""The tile test: which tiles a splat touches, and the foveation filter (paper section 6.1)."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.datapath import Datapath
from rtl.culling.level_table import LevelTable
from rtl.culling.tile_columns import tile_columns
from rtl.culling.tile_expand import COUNTER_BITS, TileExpand, carried_run, kept_record
from rtl.culling.tile_runs import TileRuns
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import TILE_TEST_BESIDE
from spec.records import TILE_BITS, entry_item, projected_splat, surviving_splat, tile_level


class TileTest(wiring.Component):
    """Splats to tile entries: `TileRuns`, the ellipse test, `TileExpand`; what only the last of them needs waits in a queue.

    Parameters:
        config: the machine; `point_interval`, `row_width` and formats matter here.

    Ports:
        splats: ProjectedSplat items; a frame ends with `end`. Taken once the frame's table is full.
        table: TileLevel items, one per tile of the frame, row-major. Taken before a frame's splats, never while any are inside.
        entries: EntryItem items, splat by splat in the order they came, each by tile row, then by column; then `end`.
        survivors: SurvivingSplat items of the splats with an entry, in that order; then `end`.
        width, height, obb: as `frame_settings`.
        touched: (splat, tile) pairs of the frame that touch. filtered: those of them that the foveation filter rejects, or
            whose tile is not rendered; the others are entries. From 0 at the frame's first item; they hold from its `end` in
            both streams to the next's first.
        filled: the frame's table is full; until its `end` has left for both streams.
        busy: high from a frame's last table item until its last items are taken: whenever splats or entries are inside.

    A pair touches if the ellipse on which the splat is just visible, widened by margins, meets a pixel centre of the tile, at
    the larger of the opacities of the tile's levels that use it; with `obb`, if the tile is in the splat's box. It passes if
    the tile's level is at most the splat's bound and the tile is rendered, as all are without stereo. A run of a splat lies in
    a tile row, within 16 columns, and ends where the next tile is of another level or blend, or the one of both is rendered.

    Throughput: a run every `point_interval` cycles, an entry a cycle; a run without entries takes the cycle of one. Between
    frames the unit runs empty. Latency: 8 cycles and the schedule's length of the ellipse test, for PAPER 66 in all. Storage:
    `LevelTable`, and a queue of splats, for PAPER 70 of 324 bits.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        self._ellipse = Datapath(tile_columns(config), interval=config.point_interval, carried=carried_run(config))
        settings = {f.name: shape(f.format) for f in frame_settings(config).fields}
        super().__init__({
            "splats": In(stream.Signature(layout(projected_splat(config)))),
            "table": In(stream.Signature(layout(tile_level(config)))),
            "entries": Out(stream.Signature(layout(entry_item(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            **{name: In(settings[name]) for name in ("width", "height", "obb")},
            "touched": Out(COUNTER_BITS),
            "filtered": Out(COUNTER_BITS),
            "filled": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.levels = levels = LevelTable(self.config)
        m.submodules.runs = runs = TileRuns(self.config)
        m.submodules.ellipse = ellipse = self._ellipse
        m.submodules.expand = expand = TileExpand(self.config)
        wiring.connect(m, wiring.flipped(self.table), levels.table)
        wiring.connect(m, expand.entries, wiring.flipped(self.entries))
        wiring.connect(m, expand.survivors, wiring.flipped(self.survivors))
        m.d.comb += [
            levels.enable.eq(runs.enable), levels.row.eq(runs.row), levels.group.eq(runs.group), runs.codes.eq(levels.codes),
            runs.row_start.eq(levels.row_start), ellipse.width.eq(self.width), ellipse.height.eq(self.height)]
        self._settings(m, levels, expand)
        self._enter(m, levels, runs, expand)
        self._test(m, runs, ellipse, expand)
        m.d.comb += [self.touched.eq(expand.touched), self.filtered.eq(expand.filtered),
                     self.filled.eq(levels.filled), self.busy.eq(levels.filled | self.survivors.valid)]
        return m

    def _settings(self, m: Module, levels: LevelTable, expand: TileExpand) -> None:
        """Sizes in tiles, registered: they are stable long before they matter."""
        tiles_x, tiles_y = Signal(TILE_BITS + 1), Signal(TILE_BITS + 1)
        places = TILE.bit_length() - 1
        m.d.sync += [tiles_x.eq((self.width + (TILE - 1)) >> places), tiles_y.eq((self.height + (TILE - 1)) >> places)]
        m.d.comb += [levels.tiles_x.eq(tiles_x), levels.tiles_y.eq(tiles_y), expand.obb.eq(self.obb)]

    def _enter(self, m: Module, levels: LevelTable, runs: TileRuns, expand: TileExpand) -> None:
        """A frame's splats: into the walk, and into the queue for the expansion."""
        kept = layout(kept_record(self.config))
        m.submodules.queue = queue = SyncFIFOBuffered(
            width=kept.size, depth=self._ellipse.schedule.depth + TILE_TEST_BESIDE)
        begun, ended, may, taken = Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            may.eq(levels.filled & ~ended & queue.w_rdy),
            runs.splats.valid.eq(self.splats.valid & may),
            runs.splats.payload.eq(self.splats.payload),
            self.splats.ready.eq(runs.splats.ready & may),
            taken.eq(self.splats.valid & self.splats.ready),
            queue.w_en.eq(taken & ~self.splats.payload.end),
            queue.w_data.eq(Cat(Value.cast(self.splats.payload[name]) for name in kept.members)),
            expand.splats.valid.eq(queue.r_rdy),
            Value.cast(expand.splats.payload).eq(queue.r_data),
            queue.r_en.eq(expand.splats.ready),
            expand.clear.eq(taken & ~begun),
            levels.clear.eq(expand.done),
        ]
        with m.If(taken):
            m.d.sync += [begun.eq(1), ended.eq(self.splats.payload.end)]
        with m.If(expand.done):
            m.d.sync += [begun.eq(0), ended.eq(0)]

    def _test(self, m: Module, runs: TileRuns, ellipse: Datapath, expand: TileExpand) -> None:
        """Runs into the ellipse test, and on to the expansion."""
        run, splat, code = runs.runs.payload, runs.runs.payload.splat, runs.runs.payload.code
        operands, plan = ellipse.sink.payload, ellipse.sink.payload.carried
        blends = code.blend & (splat.bound > code.level)
        passes = (code.level <= splat.bound) & code.rendered if self.config.stereo else code.level <= splat.bound
        m.d.comb += [
            ellipse.sink.valid.eq(runs.runs.valid),
            runs.runs.ready.eq(ellipse.sink.ready),
            Cat(operands.l1, operands.l2, operands.l3).eq(Value.cast(splat.conic)),
            operands.mean_x.eq(splat.mean2d[0]),
            operands.mean_y.eq(splat.mean2d[1]),
            operands.row.eq(run.row),
            operands.opacity.eq(splat.log2_opacity[code.level]),
            operands.other_opacity.eq(splat.log2_opacity[(code.level + Mux(blends, 1, 0))[:2]]),
            plan.passes.eq(passes),
            plan.level.eq(code.level),
            *(plan[name].eq(run[name]) for name in ("tile", "group", "begin", "stop", "last", "end")),
            expand.runs.valid.eq(ellipse.source.valid),
            ellipse.source.ready.eq(expand.runs.ready),
            *(expand.runs.payload[name].eq(ellipse.source.payload[name]) for name in ("first", "last", "none", "carried")),
        ]
