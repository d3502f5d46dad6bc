"""The tests of lists by super-tile: pairs are written to memory a beat at a time, read back in groups, and compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from spec.config import TINY_V3, V3, AcceleratorConfig
from spec.constants import SUPER_TILES
from spec.memory import FIRST_PAGE_BEATS
from spec.records import frame_lists
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.player import Recording
from tb.common.runner import Waves
from tb.supertiles.lists_device import playback
from tb.supertiles.lists_stimuli import Case, case
from tb.tile_lists.stimuli import BOUNDARIES, LONG_BOUNDARIES, mixed_tiles, page_rooms, random_counts

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3", "v3")
"""Configurations with different units."""

PORTS = ("entries", "written", "groups")

_SETTLING = 900
"""Most cycles of a frame in addition to those of its pairs, pages and lists: several latencies of the memory in sequence."""


@dataclass(frozen=True)
class PlannedWrites(Planned):
    """A run in which some words of the writes mean nothing.

    Attributes:
        means: (writes, WORDS) bool: the words that do.
        most_waits: most cycles in which a pair waits for the writer; None for no limit.
    """

    means: np.ndarray | None = None
    most_waits: int | None = None


def plan_of(
    config: AcceleratorConfig, item: Case, name: str | None = None, *, most_waits: int | None = None, **options: object,
) -> PlannedWrites:
    """The run that plays a case; `options` are those of `planned`."""
    expected, means = item.expected(config)
    plan = planned(
        name or item.name, item.inputs(config), expected, observed=item.observed(), settings=item.settings, **options)
    return PlannedWrites(plan.run, plan.expected, plan.observed, plan.least_rate, plan.most_cycles, means, most_waits)


def problems(item: PlannedWrites, recording: Recording) -> list[str]:
    """What is wrong with a recording, but for words that mean nothing."""
    got, wanted = recording.outputs["written"].copy(), item.expected.get("written")
    if wanted is not None and len(got) == len(wanted):
        got["word"][~item.means] = wanted["word"][~item.means]
    found = exact.problems(item, replace(recording, outputs={**recording.outputs, "written": got}))
    if item.most_waits is not None and recording.observed["waits"] > item.most_waits:
        found.append(f"pairs wait in {recording.observed['waits']} cycles, more than {item.most_waits}")
    return found


def most_cycles(item: Case) -> int:
    """Most cycles of a case with places clear from the start: one per pair and page for writing, one per list for the flush,
    and again for reading."""
    return sum(
        2 * (len(where.tile) + len(where.page_beat)) + 3 * item.lists + _SETTLING for where in item.placed)


def _orders(lengths: int = 8) -> np.ndarray:
    """The lists of pairs in every order of three neighbours of three lists, and one list alone: at all positions of a beat."""
    return np.concatenate([*(np.tile(order, lengths) for order in product(range(3), repeat=3))])


def corner_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Cases by hand: ends of beats and pages, one list, all lists, no pairs, no free space, lists outside the frame, an error
    of memory."""
    most, none = frame_lists(config), np.empty(0, np.int64)
    long = mixed_tiles(rng, LONG_BOUNDARIES)
    ends, one = mixed_tiles(rng, BOUNDARIES), np.zeros(3000, np.int64)
    sparse = mixed_tiles(rng, (rng.random(most) < 0.1) * rng.integers(1, 60, most))
    splats = np.concatenate([np.sort(rng.choice(most, n, replace=False)) for n in rng.integers(1, SUPER_TILES, 400)])
    cases = [
        case(config, rng, "counts next to pages' ends", len(BOUNDARIES), [ends, ends, ends[::-1]], beta=1),
        case(config, rng, "counts next to pages' ends, one group", len(BOUNDARIES), [ends], beta=1 << 20),
        case(config, rng, "neighbours in every order", 3, [_orders(), _orders()[::-1]]),
        case(config, rng, "no pairs", 15, [none, none]),
        case(config, rng, "no pairs, then some, then none", 15, [none, np.arange(15), none]),
        case(config, rng, "one list of one", 1, [one[:1], one, one[:33], one[:4]]),
        case(config, rng, "one list of many", most, [one + most - 1], beta=10),
        case(config, rng, "two lists in turn", 2, [np.arange(2000) % 2, np.arange(999) // 2 % 2]),
        case(config, rng, "runs of one list", 16, [np.repeat(rng.integers(0, 16, 300), rng.choice([1, 2, 3, 40], 300))]),
        case(config, rng, "all lists", most, [rng.permutation(most), np.arange(4 * most) % most, rng.permutation(most)]),
        case(config, rng, "sparse", most, [sparse, sparse[::-1]], beta=1 << 20),
        case(config, rng, "splats over neighbours", most, [splats]),
        case(config, rng, "outside the frame", 6, [np.arange(600) % 7, np.full(9, 6)]),
    ]
    first = 6 * FIRST_PAGE_BEATS
    for beats in (0, first - 1, first, first + 15, first + 16, first + 100):
        numbers = np.concatenate([rng.integers(0, 6, 500), [6, 7, 0]])
        cases.append(case(config, rng, f"free space of {beats} beats", 6, [numbers, np.arange(12) % 6], entries_beats=beats))
    for units, count in page_rooms():
        cases.append(case(config, rng, f"{count} in {units} units", 1, [np.zeros(count, np.int64)],
                          entries_beats=FIRST_PAGE_BEATS * (1 + units)))
    cases.append(case(config, rng, "counts next to longer pages' ends", len(LONG_BOUNDARIES), [long], beta=1))
    cases.append(case(config, rng, "an error of memory", 8, [np.arange(30) % 8], bad=True))
    return cases


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, every pattern on every port, slow memories, runs cut off by resets, and runs back to back at
    full rate."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(config, item) for item in corner_cases(config, rng)]
    streams = case(config, rng, "streams", 24, [mixed_tiles(rng, random_counts(rng, 24)) for _ in range(3)])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, streams, name, patterns=patterns, reset=False))
    for latency, hesitates in ((1, 0), (3, 128), (300, 0), (900, 200)):
        frames = [mixed_tiles(rng, random_counts(rng, 35)) for _ in range(2)]
        plan.append(plan_of(
            config, case(config, rng, f"memory {latency} {hesitates}", 35, frames, latency=latency, hesitates=hesitates),
            reset=False))
    clear = frame_lists(config)
    for cycles in (3, clear + 40, clear + 700, clear + 1500, clear + 2500):
        plan.append(plan_of(config, streams, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, streams, f"frames after a reset at {cycles}"))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Whole frames at full rate: a pair waits only for the pointer of a page, and that for a cycle."""
    rng, plan = np.random.default_rng(seed), []
    most = frame_lists(config)
    for name, counts in (
            ("long lists", rng.integers(500, 3000, 8)), ("two pages", rng.integers(33, 97, min(80, most))),
            ("short lists", rng.choice([1, 2, 3, 33, 34], most)), ("full beats", np.full(min(200, most), 8))):
        frames = [mixed_tiles(rng, counts), np.repeat(np.arange(len(counts)), counts)]
        item = case(config, rng, f"rate, {name}", len(counts), frames)
        plan.append(plan_of(config, item, quiet=300, most_cycles=most_cycles(item) + most, most_waits=item.pages))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        pairs, writes = len(item.expected["groups"]), len(item.expected["written"])
        lines.append(f"{item.name}: {pairs} pairs in {writes} writes, {recording.observed['waits']} cycles in which one waits, "
                     f"{recording.cycles} cycles")
    return lines


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares all results. Raises SimulationError when the simulation itself fails."""
    return exact.run_plan(playback(config), plan, folder, waves=waves, progress=progress, judge=problems)
