"""The hierarchical sorter's tests: groups of any length pass through the unit and a memory, and must come out sorted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from zlib import crc32

import numpy as np

from golden.msv2_ref.sort import sort_chunks
from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES
from spec.records import chunk_item
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned, rate
from tb.common.memory import NO_BAD_BEAT, with_memory
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames, traced_size
from tb.sort_tmu.chunk_stimuli import ORDERS, bit_chunks, items_of, random_chunk, random_chunks, whole_groups

SMALL = TINY.with_(name="small", row_width=64, sort_buffer_bytes=256, merge_ways=2)
"""Chunks of 16 intersections and two ways of merging, which need many rounds of merging in few cycles."""

WIDE = TINY.with_(name="wide", sort_buffer_bytes=512, merge_ways=8)
"""Chunks of 32 intersections, and as many ways of merging as PAPER_SMALL and PAPER have."""

VARIANTS: dict[str, AcceleratorConfig] = {
    "small": SMALL, "wide": WIDE, "tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER}
"""Configurations that can be tested."""

DISTINCT = ("small", "wide", "tiny", "paper_small")
"""Configurations with different units. PAPER's intersections are one bit longer than PAPER_SMALL's."""

PORTS = ("groups", "sorted")

LATENCY, LEAST_RATE = 100, 0.95
"""LATENCY is the memory's in runs that check rates. Spilled groups that need only one merge must be sorted at LEAST_RATE
intersections per cycle."""

_MEMORY_BITS = 17

_WATCHDOG = 200_000
"""Cycles in which neither port need move: with a slow memory, merges that are written back to memory take that long."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The sorter of a configuration, emitted as Verilog, with files at its streams and a memory at its memory ports."""
    record = chunk_item(config)
    return with_memory(Playback(
        name=f"hierarchical-{config.sort_chunk}-{config.merge_ways}", module="hierarchical_sorter",
        verilog=emitted("hierarchical_sorter", config),
        inputs=(Stream("groups", record),), outputs=(Stream("sorted", record),),
        settings=(("spill_base", BEAT_BITS), ("spill_beats", BEAT_BITS), ("clear", 1)),
        observed=(("busy", 1), ("spilled", 32), ("overflow", 1), ("error", 1))), _MEMORY_BITS)


def ring_runs(config: AcceleratorConfig, beats: int) -> int:
    """Runs that fit into half of a spill region."""
    return beats // 2 // (config.sort_chunk // BEAT_ENTRIES)


def written(config: AcceleratorConfig, count: int) -> int:
    """Intersections that the unit writes to memory for a spilled part of `count`: the part itself, and the results of all
    merges but the last."""
    ways, top = config.merge_ways, config.sort_chunk
    runs = [min(top, count - start) for start in range(0, count, top)]
    longer, total = [], count
    while len(runs) + len(longer) > ways:
        size = min(ways, len(runs) + len(longer) - ways + 1, len(runs))
        longer.append(sum(runs[:size]))
        total += longer[-1]
        runs = runs[size:]
        if not runs:
            runs, longer = longer, []
    return total


def expected_of(config: AcceleratorConfig, items: np.ndarray, beats: int) -> tuple[np.ndarray, int, int]:
    """The sorted items, the number of intersections written to memory, and whether a group did not fit. A group that does not
    fit is cut into parts of as many runs as fit, which leave in order."""
    room, top = ring_runs(config, beats), config.sort_chunk
    pieces, spilled, overflow = items.copy(), 0, 0
    bounds = np.concatenate(([0], np.flatnonzero(items["last"]) + 1))
    for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        if end - begin <= top:
            continue
        size = max(room, 1) * top
        for start in range(begin, end, size):
            pieces["last"][min(start + size, end) - 1] = 1
            spilled += written(config, min(size, end - start)) if room else 0
        overflow |= end - begin > room * top
    ordered = sort_chunks(pieces)
    ordered["last"] = items["last"]
    return ordered, spilled, overflow


def plan_of(
    config: AcceleratorConfig, name: str, groups: Iterable[np.ndarray], *, base: int | None = None, beats: int = 1 << 16,
    fresh: bool = True, expect: Mapping[str, int] | None = None, **options: object,
) -> Planned:
    """The run that plays groups.

    `base` is the first beat of the spill region, by default one that the name decides. `fresh` resets the unit before the run.
    `expect` holds further expected plain outputs. Further options set the memory
    (`latency`, by default 20, and the others) or are those of `planned`.
    """
    items = items_of(config, groups)
    ordered, spilled, overflow = expected_of(config, items, beats)
    if base is None:
        base = crc32(name.encode()) % ((1 << BEAT_BITS) - beats)
    settings = {
        "spill_base": base, "spill_beats": beats, "clear": 0, "latency": 20, "read_pauses": 0, "write_pauses": 0, "early": 0,
        "bad_beat": NO_BAD_BEAT, "region": base, "region_beats": beats}
    settings = {key: options.pop(key, value) for key, value in settings.items()}
    observed = {"busy": 0, "error": 0, "astray": 0, **(expect or {})}
    if fresh:
        observed = {"spilled": spilled, "overflow": overflow, **observed}
    return planned(name, {"groups": items}, {"sorted": ordered}, observed=observed, settings=settings, reset=fresh, **options)


def lengths_around(config: AcceleratorConfig) -> list[int]:
    """Lengths around the capacity and its multiples, around the number of ways and beyond, and with every rest of a beat."""
    top, ways = config.sort_chunk, config.merge_ways
    counts = [1, 2, 3, ways - 1, ways, ways + 1, 2 * ways - 1, 2 * ways]
    counts += [c for c in (2 * ways + 1, ways * ways, ways * ways + 1, ways**3 + 1) if c * top <= 6_000]
    rests = (-1, 0, 1, 2, 3)
    picked = {c * top + d for c in counts for d in (rests if c * top <= 2000 or c < 3 else rests[c % 5 :][:1])}
    return sorted(picked - {0})


def directed_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Lengths, orders and mixes of groups, and heads that differ at each bit, with a memory that is fast and does not pause."""
    rng, top, ways = np.random.default_rng(seed), config.sort_chunk, config.merge_ways
    around = lengths_around(config)
    plan = [plan_of(config, "lengths about the capacity and its multiples", [
        random_chunk(config, rng, length, "random", 1) for length in rng.permutation(around)])]
    for order in ORDERS:
        lengths = [2 * top + 5, ways * top, (ways + 1) * top + 1, top + 1]
        plan.append(plan_of(config, f"several merges, {order}", [random_chunk(config, rng, n, order, 1) for n in lengths]))
    mixes = {
        "small between large": [top + 1, 3, top * 2, 0, 1, top, top + 1, top + 1, 0, 0, 2, 2 * top + 1],
        "small only": [0, 1, 2, top, top, 3, 0], "large only": [top + 1, 2 * top, top + 2, 3 * top - 1, top + 3, top + 1],
        "many groups of one entry behind a large one": [2 * top, *[1] * 60, 2 * top, top, *[1] * 300, 0, top + 1],
        "mixed": rng.choice([0, 1, 2, top // 2, top, top + 1, top + 7, 2 * top, 3 * top - 2], 24),
    }
    for name, lengths in mixes.items():
        groups = [random_chunk(config, rng, int(n), "random", 1) for n in lengths]
        plan.append(plan_of(config, name, groups, early=len(plan) % 2))
    for run in (1 << k for k in range(top.bit_length())):  # the last one merges runs from memory
        plan.append(plan_of(config, f"heads of runs of {run} differ at each bit", bit_chunks(config, run)))
    return plan


def memory_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Slow and irregular memory, pauses of every kind, small spill regions, and resets during every activity."""
    rng, top, ways = np.random.default_rng(seed), config.sort_chunk, config.merge_ways
    unit = top // BEAT_ENTRIES
    sizes = [top + 1, 5, (ways + 2) * top + 3, 2 * top, top, 0, 3 * top - 1, 1, top + 3]
    groups = random_chunks(config, rng, sizes)
    plan = []
    for k, (latency, reads, writes) in enumerate(((0, 0, 0), (1, 128, 128), (300, 0, 200), (40, 250, 0), (500, 200, 200))):
        plan.append(plan_of(
            config, f"latency {latency}, pauses {reads} and {writes}", groups, latency=latency, read_pauses=reads,
            write_pauses=writes, early=k % 2))
    for k, (name, patterns) in enumerate(every_pattern(PORTS, seed).items()):
        plan.append(plan_of(
            config, name, groups, patterns=patterns, latency=60, read_pauses=64 * (k % 3), early=k % 2, fresh=False))
    far = ways * ways + 4  # merged runs of the second round cross the ring's end when they start after the first group
    lengths = [6 * top, far * top, 2 * top + 1, far * top - 5, top + 1, (far - 3) * top]
    plan.append(plan_of(
        config, "merged runs across the ring's end", [random_chunk(config, rng, n, "random") for n in lengths],
        beats=2 * unit * (far + 1), early=1))
    plan += [one_way_plan(config, order) for order in ("sorted", "reversed")]
    full = ways + 3  # the number of runs of the largest group
    for runs in (0, 1, 2, 3, full - 1, full, full + 1, 2 * full):
        for rest in (0, 2 * unit - 1):
            plan.append(plan_of(
                config, f"a region of {runs} runs and {rest} beats", groups, beats=2 * unit * runs + rest,
                base=(1 << _MEMORY_BITS) - 2 * unit * runs if runs else 0))
    for cycles in (5, top + 40, 2 * top, 3 * top + 50, (ways + 6) * top, (2 * ways + 9) * top):
        plan.append(plan_of(config, f"cut off after {cycles} cycles", groups, abort=cycles))
        plan.append(plan_of(config, f"groups after a reset at {cycles}", groups, early=1))
    for k in range(3):
        lengths = rng.choice([0, 1, top - 1, top, top + 1, 2 * top + 2], 8)
        plan.append(plan_of(
            config, f"back to back {k}", random_chunks(config, rng, lengths.tolist()), fresh=False, quiet=0, early=k % 2,
            beats=2 * unit * (3 + 4 * k), base=77 * k))
    plan.append(plan_of(
        config, "a read answered with an error", groups, bad_beat=4096 + unit // 2, base=4096, expect={"error": 1}))
    plan.append(plan_of(
        config, "counters and flags kept clear", groups, bad_beat=4096, base=4096, beats=4 * unit, clear=1,
        expect={"error": 0, "spilled": 0, "overflow": 0}))
    return plan


def one_way_plan(config: AcceleratorConfig, order: str) -> Planned:
    """A group of many runs whose ways are merged one after another: the others wait with all the beats that they hold, and each
    must get its beats fast enough alone. Besides a cycle for each intersection, a merge may cost most of the latency."""
    top, ways, runs = config.sort_chunk, config.merge_ways, 80
    group = random_chunk(config, np.random.default_rng(0), runs * top, order, 1)
    merges = -(-(runs - 1) // (ways - 1))
    most = len(group) + written(config, len(group)) + merges * LATENCY * 4 // 5
    return plan_of(config, f"ways one after another, {order}", [group], latency=LATENCY, most_cycles=most)


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Groups that fit the buffer, and groups that need only one merge, at full rate."""
    rng, top, ways = np.random.default_rng(seed), config.sort_chunk, config.merge_ways
    plan, low = [], min(256, top // 2 + 1)
    fit = [low, top, top - 1, *rng.integers(low, top + 1, 6).tolist()]
    plan.append(plan_of(config, "rate, groups that fit", random_chunks(config, rng, fit), least_rate={"groups": 1.0}))
    for order in ORDERS if top >= 256 else ():  # merges of smaller chunks are shorter than the latency of a write and a read
        counts = [2 * top, ways * top, *rng.integers(2 * top, ways * top + 1, 4).tolist(), *[2 * top + top // 2] * 6]
        groups = [random_chunk(config, rng, n, order) for n in counts]
        plan.append(plan_of(
            config, f"rate, spilled, {order}", groups, latency=LATENCY, beats=6 * max(counts) // BEAT_ENTRIES,
            least_rate={"groups": LEAST_RATE}, most_cycles=_most_cycles(counts, top)))
    return plan


def _most_cycles(counts: Iterable[int], top: int) -> int:
    """Most cycles of spilled groups: a group is merged after it has been written and after the previous one has left."""
    written, out = float(top), 0.0
    for count in counts:
        written += count / LEAST_RATE
        out = max(out, written + 4 * LATENCY) + count / LEAST_RATE
    return int(out)


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The groups of real scenes' frames."""
    plan = []
    for name, frame in traced_frames(config, size).items():
        plan.append(plan_of(config, f"traced {name}", whole_groups(frame), latency=LATENCY, beats=1 << 17, base=0))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    traced = traced_plan(config, traced_size(config, "256x144")) if config.sort_chunk >= 256 else []
    memory = memory_plan(config, seed) if config.sort_chunk <= 256 else []  # larger chunks: millions of cycles, no more tested
    return [*directed_plan(config, seed), *memory, *rate_plan(config, seed), *traced]


def figures(config: AcceleratorConfig, plan: Sequence[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        items = item.run.inputs["groups"]
        entries, groups = int((items["empty"] == 0).sum()), int(items["last"].sum())
        lines.append(
            f"{item.name}: {entries} entries in {groups} groups, {recording.observed['spilled']} written to memory, "
            f"{rate(recording, 'groups'):.4f} entries a cycle taken, {entries / recording.cycles:.4f} from the first entry "
            f"in to the last out, {recording.cycles} cycles")
    return lines


run_plan = exact.runner(playback, _WATCHDOG)
"""Plays a plan and compares all results."""
