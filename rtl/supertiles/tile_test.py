"""The tile test of machines with super-tiles: pairs of splats and super-tiles in the first phase of a frame, masks of tiles in
the second."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.datapath import Datapath
from rtl.culling.level_table import LevelTable
from rtl.culling.tile_columns import tile_columns
from rtl.culling.tile_expand import kept_record
from rtl.culling.tile_runs import TileRuns
from rtl.shapes import layout, shape
from rtl.supertiles.event_count import count
from rtl.supertiles.mask_expand import MaskExpand
from rtl.supertiles.pair_expand import PairExpand
from rtl.supertiles.run_clip import RunClip, carried_run
from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, TILE
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS, LEVEL_GROUP, TILE_TEST_BESIDE
from spec.records import TILE_BITS, projected_splat, surviving_splat, tile_level
from spec.supertiles import check_supertiles, supertile_pair

_COUNTS = ("touched", "filtered", "entries", "survivors_count")


class SuperTileTest(wiring.Component):
    """Finds the super-tiles that splats have intersections with, and in the second phase the tiles of each pair. Splats pass
    `TileRuns`, the ellipse test and `RunClip`; their runs then go to `PairExpand` in the first phase and to `MaskExpand` in
    the second. The fields of a splat that only these two need wait in a queue beside the ellipse test.

        splats --> TileRuns --> ellipse --> RunClip --> PairExpand --> pairs        first phase
                      ^                        |
        table --> LevelTable                   +------> MaskExpand --> survivors    second phase

    Parameters:
        config: the machine, with super-tiles; `point_interval`, `row_width` and formats matter here.

    Ports:
        splats: ProjectedSplat items. They are taken while the level table is full. The first phase ends with `end`, which does
            not come in the second. In the second phase boxes lie in one super-tile each (`SuperTileClip`).
        table: TileLevel items, one per tile of the frame, row-major. They are taken before a frame's splats.
        rendering: the phase is the second one; changes only while `busy` is low.
        pairs: SuperTilePair items of the first phase, splat by splat in the order of the input, for each splat by the number of
            the super-tile; then `end`.
        survivors: SurvivingSplat items of the second phase, one for every splat, in order; `end` is 0.
        width, height, obb: settings as in `frame_settings`.
        touched: number of intersections of the first phase before the foveation filter. filtered: how many of them the filter
            rejects. entries: how many it passes. survivors_count: number of splats with a pair. All start from 0 with `clear`,
            do not change in the second phase, and are valid from the transfer of the item with `end`.
        filled: the level table is full: from the transfer of its last item until `clear`.
        busy: splats are inside, or items that have not been taken.
        clear: strobe between frames: the level table empties, and counts restart.

    Which tiles a splat touches, and what the foveation filter passes, is as in `rtl.culling.tile_test.TileTest`.

    Throughput: one run every `point_interval` cycles, as in that unit, and in the first phase one pair a cycle. Latency from a
    splat's last run: 3 cycles more than the ellipse test's schedule, plus 4 from the splat to its first run.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        self._ellipse = Datapath(tile_columns(config), interval=config.point_interval, carried=carried_run(config))
        settings = {f.name: shape(f.format) for f in frame_settings(config).fields}
        super().__init__({
            "splats": In(stream.Signature(layout(projected_splat(config)))),
            "table": In(stream.Signature(layout(tile_level(config)))),
            "rendering": In(1),
            "pairs": Out(stream.Signature(layout(supertile_pair(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            **{name: In(settings[name]) for name in ("width", "height", "obb")},
            **{name: Out(COUNTER_BITS) for name in _COUNTS},
            "filled": Out(1),
            "busy": Out(1),
            "clear": In(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.levels = levels = LevelTable(self.config)
        m.submodules.runs = runs = TileRuns(self.config)
        m.submodules.ellipse = ellipse = self._ellipse
        m.submodules.clip = clip = RunClip(self.config)
        m.submodules.expand = expand = PairExpand(self.config)
        m.submodules.masks = masks = MaskExpand(self.config)
        wiring.connect(m, wiring.flipped(self.table), levels.table)
        wiring.connect(m, expand.pairs, wiring.flipped(self.pairs))
        wiring.connect(m, masks.survivors, wiring.flipped(self.survivors))
        m.d.comb += [
            levels.enable.eq(runs.enable), levels.row.eq(runs.row), levels.group.eq(runs.group), runs.codes.eq(levels.codes),
            levels.clear.eq(self.clear), self.filled.eq(levels.filled), clip.obb.eq(self.obb),
            ellipse.width.eq(self.width), ellipse.height.eq(self.height)]
        self._sizes(m, levels, expand)
        self._enter(m, runs, clip, expand, masks)
        self._test(m, runs, clip)
        self._part(m, clip, expand, masks)
        return m

    def _sizes(self, m: Module, levels: LevelTable, expand: PairExpand) -> None:
        """Registers the frame's size in tiles and super-tiles; it is stable long before it is used."""
        tiles_x, tiles_y, supers_x = Signal(TILE_BITS + 1), Signal(TILE_BITS + 1), Signal.like(expand.supers_x)
        places = TILE.bit_length() - 1
        m.d.sync += [tiles_x.eq((self.width + (TILE - 1)) >> places), tiles_y.eq((self.height + (TILE - 1)) >> places),
                     supers_x.eq((tiles_x + (SUPER_X - 1)) >> (SUPER_X.bit_length() - 1))]
        m.d.comb += [levels.tiles_x.eq(tiles_x), levels.tiles_y.eq(tiles_y), expand.supers_x.eq(supers_x)]

    def _enter(self, m: Module, runs: TileRuns, clip: RunClip, expand: PairExpand, masks: MaskExpand) -> None:
        """Sends splats to `TileRuns` and into the queue."""
        kept = layout(kept_record(self.config))
        m.submodules.queue = queue = SyncFIFOBuffered(
            width=kept.size, depth=self._ellipse.schedule.depth + TILE_TEST_BESIDE)
        splat, may, taken, ending = Signal(kept), Signal(), Signal(), Signal()
        m.d.comb += [
            may.eq(self.filled & queue.w_rdy),
            runs.splats.valid.eq(self.splats.valid & may),
            runs.splats.payload.eq(self.splats.payload),
            self.splats.ready.eq(runs.splats.ready & may),
            taken.eq(self.splats.valid & self.splats.ready),
            queue.w_en.eq(taken & ~self.splats.payload.end),
            queue.w_data.eq(Cat(Value.cast(self.splats.payload[name]) for name in kept.members)),
            Value.cast(splat).eq(queue.r_data),
            *(expand.splats.payload[name].eq(splat[name]) for name in expand.splats.payload.shape().members),
            masks.splats.payload.eq(splat),
            *(unit.splats.valid.eq(queue.r_rdy) for unit in (expand, masks)),
            queue.r_en.eq(expand.splats.ready | masks.splats.ready),
            self.busy.eq(queue.level.any() | ending | expand.busy | self.pairs.valid | self.survivors.valid),
        ]
        with m.If(taken & self.splats.payload.end):
            m.d.sync += ending.eq(1)
        with m.If(clip.clipped.valid & clip.clipped.ready & clip.clipped.payload.end):
            m.d.sync += ending.eq(0)

    def _test(self, m: Module, runs: TileRuns, clip: RunClip) -> None:
        """Connects runs to the ellipse test, and the ellipse test to `RunClip`."""
        run, splat, code, ellipse = runs.runs.payload, runs.runs.payload.splat, runs.runs.payload.code, self._ellipse
        operands, plan = ellipse.sink.payload, ellipse.sink.payload.carried
        m.d.comb += [
            ellipse.sink.valid.eq(runs.runs.valid),
            runs.runs.ready.eq(ellipse.sink.ready),
            Cat(operands.l1, operands.l2, operands.l3).eq(Value.cast(splat.conic)),
            operands.mean_x.eq(splat.mean2d[0]),
            operands.mean_y.eq(splat.mean2d[1]),
            operands.row.eq(run.row),
            operands.opacity.eq(splat.log2_opacity),
            operands.other_opacity.eq(splat.log2_opacity),
            plan.passes.eq(code.level <= splat.bound),
            plan.level.eq(code.level),
            *(plan[name].eq(run[name]) for name in ("row", "group", "begin", "stop", "last", "end")),
            clip.runs.valid.eq(ellipse.source.valid),
            ellipse.source.ready.eq(clip.runs.ready),
            *(clip.runs.payload[name].eq(ellipse.source.payload[name]) for name in ("first", "last", "none", "carried")),
        ]

    def _part(self, m: Module, clip: RunClip, expand: PairExpand, masks: MaskExpand) -> None:
        """Sends runs to the part of the phase, and counts in the first."""
        run, counted, size = clip.clipped.payload, Signal(), Signal(range(LEVEL_GROUP + 1))
        m.d.comb += [
            expand.runs.payload.eq(run),
            masks.runs.payload.eq(run),
            expand.runs.valid.eq(clip.clipped.valid & ~self.rendering),
            masks.runs.valid.eq(clip.clipped.valid & self.rendering),
            clip.clipped.ready.eq(Mux(self.rendering, masks.runs.ready, expand.runs.ready)),
            counted.eq(expand.runs.valid & expand.runs.ready & ~run.end & ~run.nothing),
        ]
        passes, lives = Signal(), Signal()
        m.d.sync += [size.eq(Mux(counted, run.stop - run.begin + 1, 0)), passes.eq(run.passes), lives.eq(expand.lives)]
        for name, amount in zip(_COUNTS, (size, Mux(passes, 0, size), Mux(passes, size, 0), lives), strict=True):
            count(m, getattr(self, name), amount, self.clear)
