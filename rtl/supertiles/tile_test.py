"""The tile test of machines with super-tiles: pairs of splats and super-tiles in the first phase of a frame, masks of tiles in
the second."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Any

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.datapath import Datapath
from rtl.culling.shared_datapath import DatapathSide
from rtl.culling.tile_columns import row_columns
from rtl.culling.tile_expand import kept_record
from rtl.shapes import layout, shape
from rtl.stream import Buffer
from rtl.supertiles.box_steps import BoxSteps, carried_step
from rtl.supertiles.event_count import count
from rtl.supertiles.eyes import columns_apart, origin_of
from rtl.supertiles.group_walk import GroupWalk
from rtl.supertiles.level_table import SuperLevelTable
from rtl.supertiles.mask_expand import MaskExpand
from rtl.supertiles.pair_expand import PairExpand
from rtl.supertiles.pair_union import PairUnion
from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, SUPER_Y, TILE
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS, LEVEL_GROUP, TILE_TEST_BESIDE
from spec.records import INDEX_BITS, TILE_BITS, projected_splat, surviving_splat, tile_level
from spec.supertiles import check_supertiles, supertile_pair

_COUNTS = ("touched", "filtered", "entries", "survivors_count")


class SuperTileTest(wiring.Component):
    """Finds the super-tiles that splats have intersections with, and in the second phase the tiles of each pair. `BoxSteps`
    takes the box of a splat apart into steps of SUPER_Y tile rows, the ellipse test finds the columns that the splat touches in
    each row, and `GroupWalk` reads their levels and applies the foveation filter. Groups of tiles then go to `PairExpand` in
    the first phase and to `MaskExpand` in the second. The fields of a splat that only these two need wait in a queue beside the
    rest.

        splats --> BoxSteps ---> ellipse --> GroupWalk --> PairExpand --> pairs        first phase
                                                 ^     |
        table --------------------> SuperLevelTable    +-> MaskExpand --> survivors    second phase

    In machines with joint frames (`spec.joint`) `PairUnion` stands behind PairExpand, and columns are those of joint
    super-tiles but in the ellipse test, behind which the O of the splat's eye is added.

    Parameters:
        config: the machine, with super-tiles; `point_interval`, `row_width` and formats matter here.
        side: its side of the datapath of the ellipse test, where the unit shares it (`rtl.supertiles.phase_test`).

    Ports:
        splats: ProjectedSplat items. They are taken while the level table is full. The first phase ends with `end`, which does
            not come in the second. In the second phase boxes lie in one super-tile each (`SuperTileClip`).
        table: TileLevel items, one per tile of the frame, row-major. They are taken before a frame's splats.
        rendering: the phase is the second one; changes only while `busy` is low.
        pairs: SuperTilePair items of the first phase, splat by splat in the order of the input, for each splat by the number of
            the super-tile; then `end`.
        survivors: SurvivingSplat items of the second phase, one for every splat, in order; `end` is 0. Those of splats with
            `none` have no tile.
        width, height, obb: settings as in `frame_settings`.
        touched: number of intersections of the first phase before the foveation filter. filtered: how many of them the filter
            rejects. entries: how many it passes. survivors_count: number of splats with a pair. All start from 0 with `clear`,
            do not change in the second phase, and are valid from two cycles after the transfer of the item with `end`.
        filled: the level table is full: from the transfer of its last item until `clear`.
        busy: splats are inside, or items that have not been taken.
        clear: strobe between frames: the level table empties, and counts restart.

    With joint frames:
        joint, shift: settings, as well.
        splats: with the boxes of `EyeCulls`; those of the target come at once behind those of the source, where both come.
        table: the items of the source are followed by those of the target.
        survivors_count: number of Gaussians with a pair; the other counts are sums over both eyes.
        ready: the memory of `PairUnion` is cleared.

    Which tiles a splat touches, and what the foveation filter passes, is as in `rtl.culling.tile_test.TileTest`. A group is
    what lies in a step within 16 columns, the first a multiple of 16. Groups reach from the first to the last column that the
    splat touches in any of the two tile rows.

    Throughput: a step every `point_interval` cycles, a group a cycle, and in the first phase a pair a cycle, each without
    waiting for the others as long as PairExpand's queue has room; so a splat of the second phase, which has one step and one
    group, takes `point_interval` cycles. A step in which nothing is touched takes the time of a group. Latency from a splat to
    its first group: 5 cycles more than the latency of the ellipse test, which has a schedule of 58 cycles for PAPER's rates; 4
    cycles more to a pair, and one to a survivor. Storage: `SuperLevelTable`, a queue of splats, and that of PairExpand.
    """

    def __init__(self, config: AcceleratorConfig, side: DatapathSide | None = None) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        self._ellipse = side or Datapath(
            row_columns(config, SUPER_Y), interval=config.point_interval, carried=carried_step(config))
        super().__init__(self._members(config))

    def _members(self, config: AcceleratorConfig) -> dict[str, wiring.Member]:
        settings = {f.name: shape(f.format) for f in frame_settings(config).fields}
        return {
            "splats": In(stream.Signature(layout(projected_splat(config)))),
            "table": In(stream.Signature(layout(tile_level(config)))),
            "rendering": In(1),
            "pairs": Out(stream.Signature(layout(supertile_pair(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            **{name: In(settings[name]) for name in ("width", "height", "obb", *(("joint", "shift") if config.joint else ()))},
            **({"ready": Out(1)} if config.joint else {}),
            **{name: Out(COUNTER_BITS) for name in _COUNTS},
            "filled": Out(1),
            "busy": Out(1),
            "clear": In(1),
        }

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.levels = levels = SuperLevelTable(self.config)
        m.submodules.steps = steps = BoxSteps(self.config)
        ellipse: Any = self._ellipse
        if isinstance(ellipse, Datapath):
            m.submodules.ellipse = ellipse
        m.submodules.walk = walk = GroupWalk(self.config)
        m.submodules.expand = expand = PairExpand(self.config)
        m.submodules.masks = masks = MaskExpand(self.config)
        self._inside = Signal(name="inside")  # with joint frames: what `busy` means without `PairUnion`
        wiring.connect(m, wiring.flipped(self.table), levels.table)
        if self.config.joint:
            self._join(m, levels, walk, expand)
        else:
            wiring.connect(m, expand.pairs, wiring.flipped(self.pairs))
        wiring.connect(m, masks.survivors, wiring.flipped(self.survivors))
        m.d.comb += [
            levels.enable.eq(walk.enable), levels.row.eq(walk.row), levels.group.eq(walk.group), walk.levels.eq(levels.levels),
            levels.clear.eq(self.clear), self.filled.eq(levels.filled), walk.obb.eq(self.obb),
            ellipse.width.eq(self.width), ellipse.height.eq(self.height)]
        self._sizes(m, levels, expand)
        self._enter(m, steps, walk, self.rendering, (expand, masks), (expand.busy, self.pairs.valid, self.survivors.valid))
        self._test(m, steps, walk)
        self._part(m, walk, expand, masks)
        return m

    def _join(self, m: Module, levels: SuperLevelTable, walk: GroupWalk, expand: PairExpand) -> None:
        """Makes the pairs of both eyes one, and gives the table of levels the eye and the settings of a joint frame."""
        self._unite(m, expand)
        m.d.comb += [levels.joint.eq(self.joint), levels.shift.eq(self.shift), levels.eye.eq(walk.eye)]

    def _unite(self, m: Module, expand: PairExpand) -> None:
        """Makes the pairs of both eyes one."""
        m.submodules.union = union = PairUnion(self.config)
        wiring.connect(m, expand.pairs, union.pairs)
        wiring.connect(m, union.union, wiring.flipped(self.pairs))
        m.d.comb += [
            union.clear.eq(self.clear), self.ready.eq(union.ready), self.busy.eq(union.busy | self._inside)]

    def _sizes(self, m: Module, levels: SuperLevelTable | None, expand: PairExpand) -> None:
        """Registers the frame's size in tiles and super-tiles; it is stable long before it is used."""
        tiles_x, tiles_y, supers_x = Signal(TILE_BITS + 1), Signal(TILE_BITS + 1), Signal.like(expand.supers_x)
        places = TILE.bit_length() - 1
        wide = tiles_x + columns_apart(self.joint, self.shift) if self.config.joint else tiles_x
        m.d.sync += [tiles_x.eq((self.width + (TILE - 1)) >> places), tiles_y.eq((self.height + (TILE - 1)) >> places),
                     supers_x.eq((wide + (SUPER_X - 1)) >> (SUPER_X.bit_length() - 1))]
        if levels is not None:
            m.d.comb += [levels.tiles_x.eq(tiles_x), levels.tiles_y.eq(tiles_y)]
        m.d.comb += expand.supers_x.eq(supers_x)

    def _enter(
        self, m: Module, steps: BoxSteps, walk: GroupWalk, rendering: Value, takers: Sequence[PairExpand | MaskExpand],
        leaving: Sequence[Value],
    ) -> None:
        """Sends splats to `BoxSteps` and into the queue, from which `takers` take them; `leaving` says what is behind these."""
        kept = layout(kept_record(self.config))
        m.submodules.queue = queue = SyncFIFOBuffered(
            width=kept.size, depth=self._ellipse.schedule.depth + TILE_TEST_BESIDE + self.config.joint)
        splat, may, taken, ending = Signal(kept), Signal(), Signal(), Signal()
        m.d.comb += [
            may.eq(self.filled & queue.w_rdy),
            steps.splats.valid.eq(self.splats.valid & may),
            steps.splats.payload.eq(self.splats.payload),
            steps.rendering.eq(rendering),
            self.splats.ready.eq(steps.splats.ready & may),
            taken.eq(self.splats.valid & self.splats.ready),
            queue.w_en.eq(taken & ~self.splats.payload.end),
            queue.w_data.eq(Cat(Value.cast(self.splats.payload[name]) for name in kept.members)),
            Value.cast(splat).eq(queue.r_data),
            *(assign for unit in takers for assign in _given(unit.splats.payload, splat)),
            *(unit.splats.valid.eq(queue.r_rdy) for unit in takers),
            queue.r_en.eq(reduce(or_, (unit.splats.ready for unit in takers))),
            (self._inside if self.config.joint else self.busy).eq(
                reduce(or_, (queue.level.any(), ending, *leaving))),
        ]
        with m.If(taken & self.splats.payload.end):
            m.d.sync += ending.eq(1)
        with m.If(walk.groups.valid & walk.groups.ready & walk.groups.payload.end):
            m.d.sync += ending.eq(0)

    def _test(self, m: Module, steps: BoxSteps, walk: GroupWalk) -> None:
        """Connects steps to the ellipse test, and the ellipse test to `GroupWalk`, with joint frames over a register behind the
        sum with O."""
        item, splat, ellipse, tested = steps.steps.payload, steps.steps.payload.splat, self._ellipse, walk.steps
        operands, found = ellipse.sink.payload, ellipse.source.payload
        if self.config.joint:
            m.submodules.moved = moved = Buffer(walk.steps.payload.shape())
            wiring.connect(m, moved.source, walk.steps)
            tested, origin = moved.sink, origin_of(m, self.joint, self.shift)(found.carried.eye)
        m.d.comb += [
            ellipse.sink.valid.eq(steps.steps.valid),
            steps.steps.ready.eq(ellipse.sink.ready),
            Cat(operands.l1, operands.l2, operands.l3).eq(Value.cast(splat.conic)),
            operands.mean_x.eq(splat.mean2d[0]),
            operands.mean_y.eq(splat.mean2d[1]),
            operands.opacity.eq(splat.log2_opacity),
            operands.carried.eq(item.carried),
            tested.valid.eq(ellipse.source.valid),
            ellipse.source.ready.eq(tested.ready),
            tested.payload.carried.eq(found.carried),
        ]
        for i in range(SUPER_Y):
            columns = [found[f"{name}_{i}"] for name in ("first", "last")]
            if self.config.streams > 1:
                halves = tested.payload.halves[i]
                m.d.comb += [
                    halves.no_left.eq(columns[0][0]), halves.no_right.eq(~columns[1][0]),
                    halves.upper.eq(found[f"upper_{i}"]), halves.lower.eq(found[f"lower_{i}"])]
                columns = [column[1:] for column in columns]
            if self.config.joint:
                columns = [column + origin for column in columns]
            m.d.comb += [
                operands[f"row_{i}"].eq(item.carried.row + i),
                tested.payload.first[i].eq(columns[0]),
                tested.payload.last[i].eq(columns[1]),
                tested.payload.none[i].eq(found[f"none_{i}"]),
            ]

    def _part(self, m: Module, walk: GroupWalk, expand: PairExpand, masks: MaskExpand) -> None:
        """Sends groups to the part of the phase, and counts in the first."""
        item, first = walk.groups.payload, Signal(name="$signal")  # it has no name in netlists
        m.d.comb += [
            expand.groups.payload.eq(item),
            masks.groups.payload.eq(item),
            expand.groups.valid.eq(walk.groups.valid & ~self.rendering),
            masks.groups.valid.eq(walk.groups.valid & self.rendering),
            walk.groups.ready.eq(Mux(self.rendering, masks.groups.ready, expand.groups.ready)),
            first.eq(expand.groups.valid & expand.groups.ready),
        ]
        self._tally(m, item, first, expand)

    def _tally(self, m: Module, item: data.View, first: Value, expand: PairExpand) -> None:
        """Counts the groups of the first phase, each in the cycle in which it moves."""
        most = range(SUPER_Y * LEVEL_GROUP + 1)
        touched, filtered, passed, lives = (Signal(most, name=f"{name}_now") for name in _COUNTS)
        m.d.sync += [
            *(now.eq(Mux(first, _ones(tiles), 0)) for now, tiles in (
                (touched, item.touched), (filtered, item.touched.as_value() & ~item.passed.as_value()), (passed, item.passed))),
            lives.eq(self._lives(m, expand))]
        for name, amount in zip(_COUNTS, (touched, filtered, passed, lives), strict=True):
            count(m, getattr(self, name), amount, self.clear)

    def _lives(self, m: Module, expand: PairExpand) -> Value:
        """Whether a Gaussian with a pair has come that is not counted yet; in joint frames the source may have had one."""
        if not self.config.joint:
            return expand.lives
        splat, known, there = expand.splats.payload, Signal(INDEX_BITS, reset_less=True), Signal()
        with m.If(expand.lives):
            m.d.sync += [known.eq(splat.index), there.eq(1)]
        with m.If(self.clear):
            m.d.sync += there.eq(0)
        return expand.lives & ~(splat.eye & there & (known == splat.index))


def _given(payload: data.View, splat: data.View) -> list[Any]:
    """Gives a unit those fields of a splat that it takes."""
    members = payload.shape().members
    return [payload.eq(splat)] if members == splat.shape().members else [payload[name].eq(splat[name]) for name in members]


def _ones(tiles: Value) -> Value:
    """The number of bits that are set."""
    bits = list(Value.cast(tiles))
    while len(bits) > 1:
        bits = [sum(bits[i + 1 : i + 2], bits[i]) for i in range(0, len(bits), 2)]
    return bits[0]
