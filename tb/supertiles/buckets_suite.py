"""The tests of depth buckets: frames follow each other, and each makes the bounds by which the next one's pairs get lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from amaranth.hdl import Module, Signal

from golden.msv2_ref.buckets import Bounds, list_numbers, next_bounds, no_bounds
from rtl.supertiles.depth_buckets import DepthBuckets
from spec.config import TINY_V3, V3, AcceleratorConfig
from spec.records import (
    INDEX_BITS,
    Field,
    Record,
    chunk_item,
    frame_lists,
    frame_supertiles,
    intersection_item,
    list_group,
    tile_group,
    uint,
)
from spec.supertiles import BUCKET_PAIRS, BUCKETS, supertile_pair
from tb.common import exact
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback
from tb.tile_lists.stimuli import random_rows

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3", "v3")
"""Configurations with different units."""

PORTS = ("frames", "pairs", "groups", "sorted", "counts", "entries", "listed")

SETTLING = 60
"""Most cycles of a frame in addition to those of its pairs, sorted pairs, and the super-tiles between bounds."""


def pairs_between(config: AcceleratorConfig) -> int:
    """Pairs between two bounds in the tests: the small machine has many bounds in frames of few pairs."""
    return 8 if config.row_width <= TINY_V3.row_width else BUCKET_PAIRS


def frame_start(config: AcceleratorConfig) -> Record:
    """What begins a frame."""
    return Record("FrameStart", frame_start.__doc__, (
        Field("supertile_count", uint(frame_supertiles(config).bit_length()), "super-tiles of the frame"),
        Field("forget", uint(1), "the bounds that have been made are void"),
        Field("fails", uint(1), "the frame fails: its bounds are void"),
    ))


def list_total(config: AcceleratorConfig) -> Record:
    """The number of a frame's lists."""
    return Record("ListTotal", list_total.__doc__, (Field("lists", uint(frame_lists(config).bit_length()), "lists"),))


def sorted_item(config: AcceleratorConfig) -> Record:
    """What leaves the sorter; `over`: it is a frame's last item."""
    return Record("SortedItem", sorted_item.__doc__, (*chunk_item(config).fields, Field("over", uint(1), "a frame ends")))


@dataclass(frozen=True)
class Frame:
    """A frame.

    Attributes:
        supertiles: number of its super-tiles.
        supertile, depth_key: (P,) super-tile and sort key of each pair, in the order of arrival.
        forget: whether the frame begins without bounds.
        fails: whether it leaves none.
    """

    supertiles: int
    supertile: np.ndarray
    depth_key: np.ndarray
    forget: bool = False
    fails: bool = False


@dataclass(frozen=True)
class Case:
    """Consecutive frames. The first one follows a reset, so it has no bounds."""

    name: str
    frames: tuple[Frame, ...]

    def bounds(self, config: AcceleratorConfig) -> list[Bounds]:
        """The bounds of every frame."""
        found, made = [], None
        for frame in self.frames:
            usable = made is not None and made.supertiles == frame.supertiles and not frame.forget
            found.append(made if usable else no_bounds(frame.supertiles))
            order = np.lexsort((frame.depth_key, frame.supertile))
            start = np.searchsorted(frame.supertile[order], np.arange(frame.supertiles + 1))
            made = None if frame.fails else next_bounds(config, start, frame.depth_key[order], pairs_between(config))
        return found

    def rows(self, config: AcceleratorConfig) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Rows of the input streams and of the output streams."""
        parts: dict[str, list[np.ndarray]] = {name: [] for name in PORTS}
        rng = np.random.default_rng(len(self.frames))
        for frame, bounds in zip(self.frames, self.bounds(config), strict=True):
            for name, rows in _frame_rows(config, rng, frame, bounds).items():
                parts[name].append(rows)
        rows = {name: np.concatenate(part) for name, part in parts.items()}
        return ({name: rows[name] for name in PORTS[:4]}, {name: rows[name] for name in PORTS[4:]})


def _frame_rows(
    config: AcceleratorConfig, rng: np.random.Generator, frame: Frame, bounds: Bounds,
) -> dict[str, np.ndarray]:
    """Rows of all streams of a frame."""
    count, start = len(frame.supertile), np.zeros(1, frame_start(config).dtype)
    start["supertile_count"], start["forget"], start["fails"] = frame.supertiles, frame.forget, frame.fails
    pairs, entries = np.zeros(count + 1, supertile_pair(config).dtype), np.zeros(count + 1, intersection_item(config).dtype)
    low = max(INDEX_BITS - 20, 0)  # bits of an index that need not be different
    pairs["index"][:-1] = (rng.permutation(1 << INDEX_BITS - low)[:count] << low) + rng.integers(0, 1 << low, count)
    pairs["supertile"][:-1], pairs["depth_key"][:-1], pairs["end"][-1] = frame.supertile, frame.depth_key, 1
    for name in ("index", "depth_key", "end"):
        entries[name] = pairs[name]
    entries["tile"] = list_numbers(bounds, pairs["supertile"].astype(np.int64), pairs["depth_key"])  # that of `end`, too
    groups, listed = random_rows(tile_group(config), rng, bounds.lists), np.zeros(bounds.lists, list_group(config).dtype)
    groups["tile"] = np.arange(bounds.lists)
    for name in groups.dtype.names:
        listed[name] = groups[name]
    listed["ends"][bounds.first[1:] - 1] = 1
    order = np.lexsort((pairs["index"][:-1], frame.depth_key, frame.supertile))
    items = np.zeros(count + 3, sorted_item(config).dtype)  # with three empty chunks, of which one is the frame's last item
    at = np.setdiff1d(np.arange(count + 3), [*rng.choice(count + 2, 2, replace=False), count + 2])
    items["empty"], items["over"][-1] = 1, 1
    items["empty"][at], items["last"] = 0, rng.integers(0, 2, count + 3)
    for name in ("index", "depth_key", "tile"):
        items[name][at] = entries[name][:-1][order]
    total = np.zeros(1, list_total(config).dtype)
    total["lists"] = bounds.lists
    return {"frames": start, "pairs": pairs, "groups": groups, "sorted": items, "counts": total, "entries": entries,
            "listed": listed}


class BucketBench(Bench):
    """The unit, and the order of a frame: `clear`, all pairs, then lists and sorted pairs, of which none comes before its list
    has left."""

    def __init__(self, config: AcceleratorConfig) -> None:
        self._unit = DepthBuckets(config, every=pairs_between(config))
        super().__init__(
            {"frames": frame_start(config), "pairs": supertile_pair(config), "groups": tile_group(config),
             "sorted": sorted_item(config)},
            {"counts": list_total(config), "entries": intersection_item(config), "listed": list_group(config)}, {}, {"busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        start = Signal(self.frames.payload.shape())
        binning, renders, over = Signal(), Signal(), Signal()
        left = Signal.like(unit.list_count)  # lists that have not come
        item, listed = self.sorted.payload, Signal.like(unit.list_count)
        self.join(m, unit, apart=("pairs", "groups"))
        m.d.comb += [
            unit.supertile_count.eq(start.supertile_count), self.counts.payload.lists.eq(unit.list_count),
            unit.pairs.payload.eq(self.pairs.payload), unit.pairs.valid.eq(self.pairs.valid & binning),
            self.pairs.ready.eq(unit.pairs.ready & binning),
            unit.groups.payload.eq(self.groups.payload), unit.groups.valid.eq(self.groups.valid & left.any()),
            self.groups.ready.eq(unit.groups.ready & left.any()),
            *(unit.sorted_item[name].eq(item[name]) for name in unit.sorted_item.shape().members),
            self.sorted.ready.eq(renders & ~over & (item.empty | (item.tile < listed))),
            unit.sorted_taken.eq(self.sorted.valid & self.sorted.ready),
        ]
        out = self.listed.valid & self.listed.ready
        m.d.sync += [left.eq(left - (unit.groups.valid & unit.groups.ready)), listed.eq(listed + out)]
        m.d.sync += over.eq(over | unit.sorted_taken & item.over)
        self._steps(m, unit, start, binning, renders, over & (listed == unit.list_count), left, listed, over)
        return m

    def _steps(self, m: Module, unit: DepthBuckets, start: Signal, binning: Signal, renders: Signal, done: Signal, left: Signal,
               listed: Signal, over: Signal) -> None:
        with m.FSM():
            with m.State("START"):
                m.d.comb += self.frames.ready.eq(1)
                m.d.sync += start.eq(self.frames.payload)
                with m.If(self.frames.valid):
                    m.next = "CLEAR"
            with m.State("CLEAR"):
                m.d.comb += [unit.clear.eq(1), unit.forget.eq(start.forget)]
                m.next = "SETTLE"
            with m.State("SETTLE"):
                m.next = "COUNT"
            with m.State("COUNT"):
                m.d.comb += self.counts.valid.eq(1)
                with m.If(self.counts.ready):
                    m.next = "BIN"
            with m.State("BIN"):
                m.d.comb += binning.eq(1)
                with m.If(self.pairs.valid & unit.pairs.ready & self.pairs.payload.end):
                    m.next = "PASS"
            with m.State("PASS"):
                with m.If(self.entries.valid & self.entries.ready & self.entries.payload.end):
                    m.d.sync += [left.eq(unit.list_count), listed.eq(0), over.eq(0)]
                    m.next = "RENDER"
            with m.State("RENDER"):
                m.d.comb += renders.eq(1)
                with m.If(done & start.fails):
                    m.d.comb += unit.forget.eq(1)
                    m.next = "START"
                with m.Elif(done & ~unit.busy):
                    m.next = "START"


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"depth-buckets-{frame_lists(config)}"
    verilog = emitted(name, config, lambda config: BucketBench(config).playback(name, "bucket_bench").verilog)
    return BucketBench(config).playback(name, "bucket_bench", verilog)


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(name or case.name, *case.rows(config), observed={"busy": 0}, **options)


def most_cycles(case: Case) -> int:
    """Most cycles of a case at full rate."""
    return sum(2 * len(frame.supertile) + 2 * frame.supertiles + BUCKETS * frame.supertiles + SETTLING for frame in case.frames)


def drawn(
    config: AcceleratorConfig, rng: np.random.Generator, counts: Sequence[int], keys: tuple[int, int] = (0, 1 << 24),
    **options: object,
) -> Frame:
    """A frame of super-tiles with so many pairs each, whose keys are drawn from a range."""
    supertile = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    most = config.formats.depth_key.raw_max
    return Frame(len(counts), supertile, np.minimum(rng.integers(*keys, len(supertile)), most), **options)


def turned(config: AcceleratorConfig, rng: np.random.Generator, frame: Frame, step: int, **options: object) -> Frame:
    """A frame with the same pairs in another order, whose keys differ by up to `step`."""
    order = rng.permutation(len(frame.supertile))
    keys = frame.depth_key[order] + rng.integers(-step, step + 1, len(order))
    return Frame(frame.supertiles, frame.supertile[order], np.clip(keys, 0, config.formats.depth_key.raw_max), **options)


def corner_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Cases by hand: without bounds, with good and bad ones, equal keys, keys on bounds, as many bounds as there may be, other
    numbers of super-tiles, void bounds, failed frames."""
    every, whole = pairs_between(config), frame_supertiles(config)
    few = drawn(config, rng, [0, 5 * every + 1, 3 * every, 0, every, every + 1, 2])
    empty = drawn(config, rng, [0] * 7)
    far = drawn(config, rng, [7 * every + 3, 0, 4 * every, 1, 2 * every, every, 9], (1 << 20, 1 << 21))
    near = drawn(config, rng, [every, 4 * every, 9 * every, 1, 0, 2 * every, 9], (100, 200))
    equal = drawn(config, rng, [3 * every, 20 * every, 1], (77, 78))
    ends = Frame(3, few.supertile[:0], few.depth_key[:0])
    full = drawn(config, rng, [(BUCKETS + 3) * every, (BUCKETS - 1) * every, (BUCKETS - 1) * every + 1, 2])
    sparse = np.zeros(whole, np.int64)
    sparse[[0, whole // 2, whole - 1]] = 2 * every + 1
    gaps = drawn(config, rng, sparse)
    spare = frame_lists(config) - whole
    crowd = np.zeros(whole, np.int64)
    crowd[rng.choice(whole, spare // 5 + 3, replace=False)] = 6 * every + 1
    crowded = drawn(config, rng, crowd)
    small = drawn(config, rng, rng.integers(0, every // 2, whole))
    return [
        Case("none, then good bounds", (few, few, few)),
        Case("turned a little", (few, *(turned(config, rng, few, 1 << k) for k in (2, 10, 16, 20, 24)))),
        Case("bad bounds", (far, near, far, near, few, empty, few)),
        Case("equal keys", (equal, equal, drawn(config, rng, [3 * every, 20 * every, 1], (76, 80)), equal)),
        Case("smallest and largest keys", (
            drawn(config, rng, [9 * every] * 2, (0, 2)), drawn(config, rng, [9 * every] * 2, (0, 2)),
            drawn(config, rng, [9 * every] * 2, ((1 << 24) - 2, 1 << 24)), drawn(config, rng, [9 * every] * 2, (0, 1 << 24)))),
        Case("most bounds of a super-tile", (full, turned(config, rng, full, 1000), full)),
        Case("bounds far apart", (gaps, turned(config, rng, gaps, 1 << 12), small, gaps)),
        Case("most lists of a frame", (crowded, turned(config, rng, crowded, 1 << 12), small)),
        Case("other numbers of super-tiles", (few, equal, ends, few, few, ends, ends)),
        Case("void bounds", (few, turned(config, rng, few, 9, forget=True), few, few)),
        Case("failed frames", (few, turned(config, rng, few, 9, fails=True), few, few, near)),
        Case("one super-tile", (drawn(config, rng, [4 * every]),) * 3),
        Case("no pairs", (empty, empty)),
    ]


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand at full rate, every pattern on every port, and runs cut off by resets."""
    rng, every = np.random.default_rng(seed), pairs_between(config)
    plan = [plan_of(config, case, most_cycles=most_cycles(case)) for case in corner_cases(config, rng)]
    frame = drawn(config, rng, [3 * every, 0, 2, 2 * every + 2, 5 * every])
    streams = Case("streams", (frame, turned(config, rng, frame, 1 << 18), turned(config, rng, frame, 4)))
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, streams, name, patterns=patterns))
    whole = 2 * len(frame.supertile)
    for cycles in (5, whole // 3, whole - 10, whole + 60, 2 * whole):
        plan.append(plan_of(config, streams, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, streams, f"frames after a reset at {cycles}"))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per case by hand with its numbers of lists."""
    return [
        f"{item.name}: {len(item.expected['entries'])} pairs, {item.expected['counts']['lists'].tolist()} lists, "
        f"{recording.cycles} cycles"
        for item, recording in exact.recorded(plan, outcome) if item.most_cycles is not None]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
