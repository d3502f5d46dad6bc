"""Turns runs of tiles into intersections, applies the foveation filter, and finds the splats that have an intersection."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.level_table import GROUP_PLACES
from rtl.culling.tile_runs import PLACE
from rtl.shapes import layout
from rtl.stream import Buffer
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.queues import COUNTER_BITS
from spec.records import TILE_BITS, Record, intersection_item, projected_splat, surviving_splat, tile_index


def kept_record(config: AcceleratorConfig) -> Record:
    """The fields of a splat that intersections and survivors need."""
    wanted = {f.name for f in surviving_splat(config).fields} - {"end"} | {"depth_key", "wanted"}
    return Record("KeptSplat", kept_record.__doc__, tuple(f for f in projected_splat(config).fields if f.name in wanted))


def carried_run(config: AcceleratorConfig) -> data.StructLayout:
    """A run beside the ellipse test: fields of `run_layout`, and `passes`: whether the foveation filter passes it."""
    return data.StructLayout({
        "tile": unsigned(tile_index(config).width), "group": unsigned(TILE_BITS - GROUP_PLACES), "begin": PLACE, "stop": PLACE,
        "level": unsigned(2), "passes": 1, "last": 1, "end": 1})


def tested_run(config: AcceleratorConfig) -> data.StructLayout:
    """A run with the result of the ellipse test: first and last tile column, and `none` where the ellipse meets no pixel."""
    return data.StructLayout({
        "first": unsigned(TILE_BITS), "last": unsigned(TILE_BITS), "none": 1, "carried": carried_run(config)})


class TileExpand(wiring.Component):
    """Emits the intersections of each run that passes the filter, in the order of the runs, each run by column.

    Parameters:
        config: the machine.

    Ports:
        runs: `tested_run` items.
        splats: `kept_record` items, one per splat; each is taken with its splat's last run.
        entries: IntersectionItem items; survivors: SurvivingSplat items. Both end with a frame's `end`.
        obb: all tiles of a run touch, whatever the ellipse test found.
        touched, filtered: number of tiles that touch since `clear`, and how many of them were rejected; both are delayed by
            two cycles.
        clear: strobe: the counts restart from 0.
        done: strobe: a frame's `end` has left in both streams.

    Throughput: one intersection per cycle; a run that is rejected or touches no tile takes one cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "runs": In(stream.Signature(tested_run(config))),
            "splats": In(stream.Signature(layout(kept_record(config)))),
            "entries": Out(stream.Signature(layout(intersection_item(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
            "obb": In(1),
            "touched": Out(COUNTER_BITS),
            "filtered": Out(COUNTER_BITS),
            "clear": In(1),
            "done": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        clipped = Signal(data.StructLayout({
            "tile": unsigned(tile_index(self.config).width), "begin": PLACE, "rest": PLACE, "nothing": 1, "level": unsigned(2),
            "passes": 1, "last": 1, "end": 1}), reset_less=True)
        clipped_valid, load = Signal(), Signal()
        m.d.comb += self.runs.ready.eq(load | ~clipped_valid)
        with m.If(self.runs.ready):
            m.d.sync += clipped_valid.eq(self.runs.valid)
            with m.If(self.runs.valid):
                self._clip(m, clipped)
        self._expand(m, clipped, clipped_valid, load)
        return m

    def _clip(self, m: Module, clipped: data.View) -> None:
        """The first stage: the tiles of the run that lie between the first and the last column of the ellipse."""
        run, plan = self.runs.payload, self.runs.payload.carried
        group_first, group_last = run.first[GROUP_PLACES:], run.last[GROUP_PLACES:]
        places = slice(0, GROUP_PLACES)
        begin, stop, outside = Signal(PLACE), Signal(PLACE), Signal()
        cut_left = ~self.obb & (group_first == plan.group) & (run.first[places] > plan.begin)
        cut_right = ~self.obb & (group_last == plan.group) & (run.last[places] < plan.stop)
        m.d.comb += [
            begin.eq(Mux(cut_left, run.first[places], plan.begin)),
            stop.eq(Mux(cut_right, run.last[places], plan.stop)),
            outside.eq((group_first > plan.group) | (group_last < plan.group) | (begin > stop)),
        ]
        m.d.sync += [
            clipped.begin.eq(begin),
            clipped.rest.eq(stop - begin),
            clipped.nothing.eq(~self.obb & (run.none | outside)),
            *(clipped[name].eq(plan[name]) for name in ("tile", "level", "passes", "last", "end")),
        ]

    def _expand(self, m: Module, clipped: data.View, clipped_valid: Signal, load: Signal) -> None:
        """The second stage: the run whose intersections leave, and the levels of its splat's intersections so far."""
        run, valid = Signal.like(clipped, name="run", reset_less=True), Signal()
        tile, levels = Signal(tile_index(self.config).width, reset_less=True), Signal(MAX_LEVELS)
        m.submodules.surviving = surviving = Buffer(self.survivors.payload.shape())
        wiring.connect(m, surviving.source, wiring.flipped(self.survivors))
        emits, final, closes, lives, can, go = (
            Signal(name=name) for name in ("emits", "final", "closes", "lives", "can", "go"))
        all_levels = Signal.like(levels)
        m.d.comb += [
            emits.eq(run.end | (run.passes & ~run.nothing)),
            final.eq(run.end | ~emits | (run.rest == 0)),
            closes.eq(final & (run.last | run.end)),
            all_levels.eq(levels | ((emits & ~run.end) << run.level)),
            lives.eq(closes & (run.end | all_levels.any())),
            can.eq(valid & (run.end | self.splats.valid) & (surviving.sink.ready | ~lives)),
            self.entries.valid.eq(can & emits),
            go.eq(can & (self.entries.ready | ~emits)),
            surviving.sink.valid.eq(go & lives),
            self.splats.ready.eq(go & closes & ~run.end),
            self.done.eq(go & run.end),
            load.eq(~valid | (go & final)),
        ]
        kept, entry, survivor = Signal.like(self.splats.payload, name="kept"), self.entries.payload, surviving.sink.payload
        with m.If(~run.end):  # the other fields of an item with `end` are 0
            m.d.comb += [kept.eq(self.splats.payload), entry.tile.eq(tile), survivor.levels.eq(all_levels)]
        m.d.comb += [
            entry.index.eq(kept.index), entry.depth_key.eq(kept.depth_key), entry.end.eq(run.end), survivor.end.eq(run.end),
            *(survivor[name].eq(kept[name]) for name in kept.shape().members if name in survivor.shape().members)]
        with m.If(go):
            m.d.sync += [levels.eq(Mux(closes, 0, all_levels)), tile.eq(tile + 1), run.rest.eq(run.rest - 1)]
        with m.If(load):
            m.d.sync += valid.eq(clipped_valid)
            with m.If(clipped_valid):
                m.d.sync += [run.eq(clipped), tile.eq(clipped.tile + clipped.begin)]
        self._count(m, go & ~run.end & ~run.nothing, emits, run.rest)

    def _count(self, m: Module, touches: Signal, emits: Signal, rest: Signal) -> None:
        """Counts tiles: those of a run that passes one by one, those of a rejected run at once."""
        more, rejected = Signal(GROUP_PLACES + 1), Signal()
        m.d.sync += [more.eq(Mux(touches, Mux(emits, 1, rest + 1), 0)), rejected.eq(~emits)]
        for total, amount in ((self.touched, more), (self.filtered, Mux(rejected, more, 0))):
            half = len(total) // 2  # the upper half is added a cycle later, so that no carry passes through both halves
            carry = Signal(name=f"{total.name}_carry")
            m.d.sync += [Cat(total[:half], carry).eq(total[:half] + amount), total[half:].eq(total[half:] + carry)]
            with m.If(self.clear):
                m.d.sync += [total.eq(0), carry.eq(0)]
