"""The tile test: finds the tiles that a splat touches, and applies the foveation filter (paper section 6.1)."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.datapath import Datapath
from rtl.culling.level_table import LevelTable
from rtl.culling.tile_columns import tile_columns
from rtl.culling.tile_expand import TileExpand, carried_run, kept_record
from rtl.culling.tile_runs import TileRuns
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS, TILE_TEST_BESIDE
from spec.records import TILE_BITS, intersection_item, opacities_carried, projected_splat, surviving_splat, tile_level


class TileTest(wiring.Component):
    """Turns splats into intersections. Splats pass `TileRuns`, the ellipse test and `TileExpand`; the fields of a splat that
    only `TileExpand` needs wait in a queue beside the ellipse test.

    Parameters:
        config: the machine; `point_interval`, `row_width` and formats matter here.

    Ports:
        splats: ProjectedSplat items; a frame ends with `end`. They are taken once the frame's level table is full.
        table: TileLevel items, one per tile of the frame, row-major. They are taken before a frame's splats, never while splats
            are inside.
        entries: IntersectionItem items, one per intersection, splat by splat in the order of the input, for each splat by
            tile row, then by column; then `end`.
        survivors: SurvivingSplat items of the splats with an intersection, in the same order; then `end`.
        width, height, obb: settings as in `frame_settings`.
        touched: number of the frame's intersections before the foveation filter. filtered: how many of them the filter rejects;
            the others become `entries`. Both start from 0 at the frame's first item, and are valid from its `end` in both
            streams until the first item of the next frame.
        filled: the frame's level table is full; high until the frame's `end` has left in both streams.
        busy: high from a frame's last table item until its last items are taken, so whenever splats or intersections are
            inside.

    A splat touches a tile if the ellipse on which the splat is just visible, widened by margins, contains a pixel centre of the
    tile. The ellipse is that of the largest opacity among the tile's levels that use the Gaussian, or, in machines where only
    the strongest opacity passes (`opacities_carried`), of that one. With `obb`, the splat touches all tiles of its box. The
    foveation filter passes the intersection if the tile's level is at most the splat's bound and, with stereo, the tile is
    rendered. A run is a part of a tile row of a splat's box. It lies within 16 columns, and all its tiles have the same level
    and blend flag (and, with stereo, are all rendered or all not rendered).

    Throughput: one run every `point_interval` cycles and one intersection per cycle; a run without intersections takes one
    cycle. The unit is empty between frames. Latency: 8 cycles plus the length of the ellipse test's schedule, which is 66 in
    all for PAPER. Storage: `LevelTable`, and a queue of splats, which for PAPER holds 70 of 324 bits.
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
            "entries": Out(stream.Signature(layout(intersection_item(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            **{name: In(settings[name]) for name in ("width", "height", "obb")},
            "touched": Out(COUNTER_BITS),
            "filtered": Out(COUNTER_BITS),
            "filled": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
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
        """Registers the frame's size in tiles; it is stable long before it is used."""
        tiles_x, tiles_y = Signal(TILE_BITS + 1), Signal(TILE_BITS + 1)
        places = TILE.bit_length() - 1
        m.d.sync += [tiles_x.eq((self.width + (TILE - 1)) >> places), tiles_y.eq((self.height + (TILE - 1)) >> places)]
        m.d.comb += [levels.tiles_x.eq(tiles_x), levels.tiles_y.eq(tiles_y), expand.obb.eq(self.obb)]

    def _enter(self, m: Module, levels: LevelTable, runs: TileRuns, expand: TileExpand) -> None:
        """Sends a frame's splats to `TileRuns`, and into the queue to `TileExpand`."""
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
        """Connects runs to the ellipse test, and the ellipse test to `TileExpand`."""
        run, splat, code = runs.runs.payload, runs.runs.payload.splat, runs.runs.payload.code
        operands, plan = ellipse.sink.payload, ellipse.sink.payload.carried
        blends = code.blend & (splat.bound > code.level)
        opacity = other = splat.log2_opacity
        if opacities_carried(self.config) > 1:
            opacity, other = (splat.log2_opacity[level] for level in (code.level, (code.level + Mux(blends, 1, 0))[:2]))
        passes = (code.level <= splat.bound) & code.rendered if self.config.stereo else code.level <= splat.bound
        m.d.comb += [
            ellipse.sink.valid.eq(runs.runs.valid),
            runs.runs.ready.eq(ellipse.sink.ready),
            Cat(operands.l1, operands.l2, operands.l3).eq(Value.cast(splat.conic)),
            operands.mean_x.eq(splat.mean2d[0]),
            operands.mean_y.eq(splat.mean2d[1]),
            operands.row.eq(run.row),
            operands.opacity.eq(opacity),
            operands.other_opacity.eq(other),
            plan.passes.eq(passes),
            plan.level.eq(code.level),
            *(plan[name].eq(run[name]) for name in ("tile", "group", "begin", "stop", "last", "end")),
            expand.runs.valid.eq(ellipse.source.valid),
            ellipse.source.ready.eq(expand.runs.ready),
            *(expand.runs.payload[name].eq(ellipse.source.payload[name]) for name in ("first", "last", "none", "carried")),
        ]
