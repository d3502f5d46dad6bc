"""The tests of the tile lists: intersections are written to memory; groups, headers and points are read back and compared."""

from __future__ import annotations

import numpy as np

from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.constants import TILE
from spec.memory import FIRST_PAGE_BEATS
from spec.queues import LIST_TILES
from spec.records import frame_tiles
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.scenes import traced_frames, traced_size
from tb.tile_lists.device import playback
from tb.tile_lists.stimuli import (
    BOUNDARIES,
    LONG_BOUNDARIES,
    Case,
    case,
    mixed_tiles,
    page_rooms,
    random_counts,
    traced_case,
)

VARIANTS: dict[str, AcceleratorConfig] = {"tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper")
"""Configurations with the smallest and the largest frames; PAPER_SMALL's are between."""

PORTS = ("load", "entries", "written", "groups", "headers", "uses", "levels", "points")

_SETTLING = 700
"""Most cycles of a frame in addition to those of its intersections, pages and tiles: several latencies of the memory in
sequence."""


def plan_of(config: AcceleratorConfig, item: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(
        name or item.name, item.inputs(config), item.expected(config), observed=item.observed(), settings=item.settings,
        **options)


def most_cycles(item: Case) -> int:
    """Most cycles of a case with memory clear from the start: one per intersection, page and tile, for writing and again for
    reading."""
    loads = len(item.geometry) + item.tiles // 4 + 2
    return loads + sum(
        len(where.tile) + len(where.page_beat) + max(int(where.written.sum()), item.tiles) + item.tiles + _SETTLING
        for where in item.lists)


def corner_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Cases by hand: ends of pages, one tile, no intersections, no free space, whole rows as groups, tiles outside the frame,
    memory errors."""
    widest, none = -(-config.row_width // TILE), np.empty(0, np.int64)
    ends = mixed_tiles(rng, BOUNDARIES)
    one = np.zeros(5000, np.int64)
    sparse = mixed_tiles(rng, (rng.random(widest * 3) < 0.06) * rng.integers(1, 60, widest * 3))
    cases = [
        case(config, rng, "counts next to pages' ends", len(BOUNDARIES), 1, [ends, ends, ends[::-1]], beta=1),
        case(config, rng, "counts next to pages' ends, one group", len(BOUNDARIES), 1, [ends], beta=1 << 20),
        case(config, rng, "no entries", 5, 3, [none, none], gaussians=0),
        case(config, rng, "no entries, then some, then none", 5, 3, [none, np.arange(15), none]),
        case(config, rng, "one tile of one", 1, 1, [one[:1], one, one[:33]]),
        case(config, rng, "one tile of many", widest, 2, [one[:3000] + widest + 1], beta=10),
        case(config, rng, "two tiles in turn", 2, 1, [np.arange(2000) % 2, np.arange(999) // 2 % 2]),
        case(config, rng, "runs of one tile", 4, 4, [np.repeat(rng.integers(0, 16, 300), rng.choice([1, 2, 3, 40], 300))]),
        case(config, rng, "rows are groups", widest, 3, [sparse, sparse[::-1]], beta=1 << 20),
        case(config, rng, "an entry a tile", widest, 3, [rng.permutation(widest * 3)], beta=7),
        case(config, rng, "outside the frame", 3, 2, [np.arange(600) % 7, np.full(9, 6)]),
    ]
    for beats in (0, 6 * 8 - 1, 6 * 8, 6 * 8 + 15, 6 * 8 + 16, 6 * 8 + 100):
        tile = np.concatenate([rng.integers(0, 6, 500), [6, 7, 0]])
        cases.append(case(config, rng, f"room for {beats} beats", 3, 2, [tile, np.arange(12) % 6], entries_beats=beats))
    cases.append(case(
        config, rng, "counts next to longer pages' ends", len(LONG_BOUNDARIES), 1, [mixed_tiles(rng, LONG_BOUNDARIES)], beta=1))
    for units, count in page_rooms():
        cases.append(case(config, rng, f"{count} in {units} units", 1, 1, [one[:count]],
                          entries_beats=FIRST_PAGE_BEATS * (1 + units)))
    long = case(config, rng, "", 4, 2, [mixed_tiles(rng, [300, 0, 40, 5, 0, 900, 1, 0])])
    for region in ("entries", "directory", "tiles", "geometry"):
        cases.append(case(config, rng, f"an error in {region}", 4, 2, [long.frames[0]["tile"]], bad=region))
    return cases


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, every pattern on every port, slow memories, runs cut off by resets, and runs back to back at
    full rate."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(config, item) for item in corner_cases(config, rng)]
    streams = case(config, rng, "streams", 6, 4, [mixed_tiles(rng, random_counts(rng, 24)) for _ in range(2)])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, streams, name, patterns=patterns, reset=False))
    for latency, hesitates in ((1, 0), (3, 128), (300, 0), (900, 200)):
        frames = [mixed_tiles(rng, random_counts(rng, 35)) for _ in range(2)]
        plan.append(plan_of(
            config, case(config, rng, f"memory {latency} {hesitates}", 7, 5, frames, latency=latency, hesitates=hesitates),
            reset=False))
    clear = frame_tiles(config)
    for cycles in (3, clear + 40, clear + 700, clear + 1500, clear + 2500):
        plan.append(plan_of(config, streams, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, streams, f"frames after a reset at {cycles}"))
    for k in range(4):
        tiles_x, tiles_y = (int(n) for n in rng.integers(1, 12, 2))
        frames = [mixed_tiles(rng, random_counts(rng, tiles_x * tiles_y)) for _ in range(3)]
        item = case(config, rng, f"back to back {k}", tiles_x, tiles_y, frames, beta=int(rng.integers(1, 200)))
        plan.append(plan_of(config, item, reset=False, most_cycles=most_cycles(item)))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Whole frames at full rate: long tiles, tiles of about two pages, and tiles that the look-ahead just covers."""
    rng, plan = np.random.default_rng(seed), []
    for name, counts in (
            ("long tiles", rng.integers(500, 3000, 8)), ("tiles of two pages", rng.integers(33, 97, 80)),
            ("short tiles", rng.choice([1, 2, 3, 33, 34], 400)), ("full beats", np.full(200, 8)),
            (f"a page in {LIST_TILES} tiles", np.where(np.arange(320) % LIST_TILES, 4, 40))):
        frames = [mixed_tiles(rng, counts), np.repeat(np.arange(len(counts)), counts)]
        item = case(config, rng, f"rate, {name}", len(counts) // 4, 4, frames, gaussians=2000)
        clears = 0 if plan else frame_tiles(config)
        plan.append(plan_of(config, item, reset=not plan, quiet=300, most_cycles=most_cycles(item) + clears))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """Real scenes' frames at full rate."""
    plan = []
    for name, frame in traced_frames(config, size).items():
        item = traced_case(config, frame, f"traced {name}", 200)
        plan.append(plan_of(config, item, reset=not plan, most_cycles=most_cycles(item) + (0 if plan else frame_tiles(config))))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "640x360"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per frame at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        entries, written = len(item.expected["groups"]), len(item.expected["written"])
        loads = len(item.run.inputs["load"]) + item.run.reset * frame_tiles(config)
        cycles = recording.cycles - loads
        lines.append(
            f"{item.name}: {entries} entries, {written - entries} pages, {len(item.expected['headers'])} tiles, "
            f"{cycles} cycles from the first entry in to the last out, {recording.observed['gaps']} without an entry "
            f"while lists are read")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
