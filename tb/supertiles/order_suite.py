"""Depth buckets and the sorter together: whatever the bounds are, pairs leave the sorter by super-tile, depth key and index.

Pairs get their lists, are written to memory, grouped, read back and sorted, and the sorted pairs make the bounds of the next
frame, as in the machine. Groups that are larger than the sort buffer, as bad bounds and first frames make them, are spilled.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from amaranth.hdl import Const, Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from golden.msv2_ref.buckets import Bounds
from golden.msv2_ref.supertiles import merge_lists
from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.supertiles.depth_buckets import DepthBuckets
from rtl.supertiles.pair_writer import PairWriter
from rtl.tile_lists.list_reader import ListReader
from spec.config import TINY_V3, V3, AcceleratorConfig
from spec.constants import SUPER_TILES
from spec.memory import BEAT_BITS, DIRECTORY_BEATS, read_data, read_request, write_request
from spec.records import COUNT_BITS, chunk_item, frame_lists, tile_group
from spec.supertiles import supertile_pair
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.memory import NO_BAD_BEAT, with_memory
from tb.common.playback import Playback, Stream
from tb.supertiles.buckets_suite import Case, corner_cases, drawn, frame_start, pairs_between, turned
from tb.tile_lists.memory import ADDRESS_BITS, MEMORY, add_memory

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3",)
"""Configurations with different units; the large machine's have been tested one by one."""

PORTS = ("frames", "pairs", "sorted")

_SPILL_BITS, _LATENCY, _WATCHDOG = 14, 40, 100_000


class OrderBench(wiring.Component):
    """The units from the pairs to the sorter. The memory of lists answers after _LATENCY cycles, that of spilled runs
    is outside.

    Parameters:
        config: the machine's configuration.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self.config = config
        super().__init__({
            "frames": In(stream.Signature(layout(frame_start(config)))),
            "pairs": In(stream.Signature(layout(supertile_pair(config)))),
            "sorted": Out(stream.Signature(layout(chunk_item(config)))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))), "writes_idle": In(1),
            "beta": In(COUNT_BITS), "full": Out(1), "overflow": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m, config = Module(), self.config
        m.submodules.buckets = buckets = DepthBuckets(config, every=pairs_between(config))
        m.submodules.writer = writer = PairWriter(config)
        m.submodules.merge = merge = TileMergeUnit(config)
        m.submodules.reader = reader = ListReader(config)
        m.submodules.sorter = sorter = HierarchicalSorter(config)
        entries_base = frame_lists(config) * DIRECTORY_BEATS
        m.d.comb += [
            merge.tiles_x.eq(buckets.list_count), merge.tile_count.eq(buckets.list_count), merge.beta.eq(self.beta),
            writer.list_count.eq(buckets.list_count), writer.entries_base.eq(entries_base),
            writer.entries_beats.eq((1 << ADDRESS_BITS) - entries_base), reader.entries_base.eq(entries_base),
            sorter.spill_beats.eq(1 << _SPILL_BITS), self.full.eq(writer.full), self.overflow.eq(sorter.overflow),
            *(reader.tiles.payload[f.name].eq(buckets.listed.payload[f.name]) for f in tile_group(config).fields),
            reader.tiles.valid.eq(buckets.listed.valid), buckets.listed.ready.eq(reader.tiles.ready),
            buckets.sorted_item.eq(sorter.sorted.payload), buckets.sorted_taken.eq(self.sorted.valid & self.sorted.ready),
            sorter.writes_idle.eq(self.writes_idle),
        ]
        for source, sink in ((buckets.entries, writer.entries), (writer.hits, merge.hits), (merge.groups, buckets.groups),
                             (reader.groups, sorter.groups)):
            wiring.connect(m, source, sink)
        for source, name in ((sorter.sorted, "sorted"), (sorter.reads, "reads"), (sorter.writes, "writes")):
            wiring.connect(m, source, wiring.flipped(getattr(self, name)))
        wiring.connect(m, wiring.flipped(self.data), sorter.data)
        nothing = stream.Signature(layout(write_request(config))).create()
        m.d.comb += writer.writes.ready.eq(1)
        settings = {"latency": Const(_LATENCY, 10), "hesitates": Const(20, 8), "bad": Const((1 << BEAT_BITS) - 1, BEAT_BITS)}
        add_memory(m, settings, nothing, writer.writes, writer.writes_idle, [(reader.reads, reader.data)])
        self._frames(m, buckets, writer, merge)
        return m

    def _frames(self, m: Module, buckets: DepthBuckets, writer: PairWriter, merge: TileMergeUnit) -> None:
        """Frames follow each other; the next one begins when all pairs of the one before have been sorted."""
        start, left, opens = Signal(self.frames.payload.shape()), Signal(COUNT_BITS), Signal()
        pair, entry = self.pairs.payload, writer.hits
        taken, hits = self.pairs.valid & self.pairs.ready, entry.valid & entry.ready
        m.d.comb += [
            buckets.supertile_count.eq(start.supertile_count), buckets.pairs.payload.eq(pair),
            buckets.pairs.valid.eq(self.pairs.valid & opens), self.pairs.ready.eq(buckets.pairs.ready & opens),
        ]
        m.d.sync += left.eq(left + (taken & ~pair.end) - (self.sorted.valid & self.sorted.ready))
        with m.FSM():
            with m.State("START"):
                m.d.comb += self.frames.ready.eq(1)
                m.d.sync += start.eq(self.frames.payload)
                with m.If(self.frames.valid):
                    m.next = "CLEAR"
            with m.State("CLEAR"):
                m.d.comb += [buckets.clear.eq(1), buckets.forget.eq(start.forget)]
                m.next = "SETTLE"
            with m.State("SETTLE"):
                m.next = "PAIRS"
            with m.State("PAIRS"):
                m.d.comb += opens.eq(1)
                with m.If(taken & pair.end):
                    m.next = "HITS"
            with m.State("HITS"):
                with m.If(hits & entry.payload.end):
                    m.next = "SORT"
            with m.State("SORT"):
                with m.If((left == 0) & ~merge.busy & (start.fails | ~buckets.busy)):
                    m.d.comb += buckets.forget.eq(start.fails)
                    m.next = "START"


def _emit(config: AcceleratorConfig) -> str:
    return to_verilog(OrderBench(config), "order_bench") + MEMORY


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration with its memories, emitted as Verilog, with a file at each stream."""
    name = f"bucket-order-{frame_lists(config)}"
    return with_memory(Playback(
        name=name, module="order_bench", verilog=emitted(name, config, _emit),
        inputs=(Stream("frames", frame_start(config)), Stream("pairs", supertile_pair(config))),
        outputs=(Stream("sorted", chunk_item(config)),), settings=(("beta", COUNT_BITS),),
        observed=(("full", 1), ("overflow", 1))), _SPILL_BITS)


def _sorted(config: AcceleratorConfig, pairs: np.ndarray, entries: np.ndarray, bounds: Bounds, beta: int) -> np.ndarray:
    """The pairs of a frame as they must leave the sorter: the order is stated without bounds, lists and groups with them."""
    order = np.lexsort((pairs["index"], pairs["depth_key"], pairs["supertile"]))
    rows = np.zeros(len(pairs), chunk_item(config).dtype)
    for name in ("index", "depth_key", "tile"):
        rows[name] = entries[name][order]
    counts = np.bincount(entries["tile"], minlength=bounds.lists)
    group = merge_lists(config, counts, beta)[rows["tile"].astype(np.int64)]
    rows["last"] = np.append(np.diff(group) > 0, [True] * (len(rows) > 0))
    return rows


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, *, beta: int = 100, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    inputs, expected = case.rows(config)
    cuts = np.flatnonzero(inputs["pairs"]["end"])[:-1] + 1
    frames = [_sorted(config, pairs[:-1], entries[:-1], bounds, beta) for pairs, entries, bounds in zip(
        np.split(inputs["pairs"], cuts), np.split(expected["entries"], cuts), case.bounds(config), strict=True)]
    settings = {"beta": beta, "latency": 20, "read_pauses": 0, "write_pauses": 0, "early": 0, "bad_beat": NO_BAD_BEAT,
                "region": 0, "region_beats": 1 << _SPILL_BITS}
    return planned(
        name or case.name, {name: inputs[name] for name in PORTS[:2]}, {"sorted": np.concatenate(frames)},
        observed={"full": 0, "overflow": 0, "astray": 0}, settings=settings, **options)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The cases of the buckets alone, frames of spilled groups, every pattern on every port, and runs cut off by resets."""
    rng, every = np.random.default_rng(seed), pairs_between(config)
    plan = [plan_of(config, case, beta=int(rng.choice([1, 20, 100, 1000]))) for case in corner_cases(config, rng)]
    crowd = drawn(config, rng, [3 * config.sort_chunk, 5, 0, config.sort_chunk + 1, 40 * every])
    spilled = Case("spilled groups", (crowd, turned(config, rng, crowd, 100), drawn(config, rng, [1200] * 3, (5, 30)),
                                      crowd, turned(config, rng, crowd, 1 << 23)))
    plan.append(plan_of(config, spilled))
    few = drawn(config, rng, rng.integers(0, 4 * every, SUPER_TILES))
    streams = Case("streams", (few, turned(config, rng, few, 1 << 20), few))
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, streams, name, patterns=patterns))
    for cycles in (100, 700, 1500, 3000):
        plan.append(plan_of(config, streams, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, streams, f"frames after a reset at {cycles}"))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per case of spilled groups with its speed."""
    return [f"{item.name}: {len(item.expected['sorted'])} pairs, {recording.cycles} cycles"
            for item, recording in exact.recorded(plan, outcome) if item.name.startswith("spilled")]


run_plan = exact.runner(playback, _WATCHDOG)
"""Plays a plan and compares all results."""
