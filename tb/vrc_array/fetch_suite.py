"""Splat fetch's tests: every intersection must get its splat record, and every memory request must be right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.msv2_ref.fetch import find_misses
from rtl.vrc_array.splat_fetch import LATENCY
from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES, WORDS, read_data, read_request, splat_record
from spec.packing import pack
from spec.queues import CACHE_WAYS
from spec.records import COUNT_BITS, tile_use
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.scenes import traced_frames, traced_size
from tb.vrc_array.fetch_device import MOST_DELAY, playback
from tb.vrc_array.fetch_stimuli import DIRECTED, INDICES, Case, Tile, case_of, random_case, traced_case

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "tiny-4-lines": TINY.with_(splat_cache_lines=4), "paper_small": PAPER_SMALL, "paper": PAPER}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "tiny-4-lines", "paper")
"""Configurations with different units: 64, 4 and 2,048 cache lines. PAPER_SMALL's sorted entries are one bit shorter
than PAPER's."""

PORTS = ("sorted", "tiles", "data", "entries", "reads")

DELAY = 100
"""Latency of the memory, in cycles, in the runs that check the rate."""


class Plan:
    """Runs, and a model of what the cache holds from one run to the next.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig, seed: int):
        self.runs: list[Planned] = []
        self._config, self._rng = config, np.random.default_rng(seed)
        self._frame, self._accesses, self._counted, self._wrong = 0, np.empty((2, 0), np.int64), [0, 0], 0

    def add(
        self, case: Case, name: str | None = None, *, clear: bool = True, reset: bool = True, delay: int = 7,
        wrong: tuple[int, ...] = (), **options: object,
    ) -> Planned:
        """Adds the run that plays a case.

        Args:
            case: the case to play.
            name: the run's name; None for the case's name.
            clear: whether to strobe `clear` before the run, so that nothing from the previous run is found in the cache.
            reset: whether to reset the unit before the run.
            delay: the memory's latency in cycles, less one.
            wrong: numbers of the beats that the memory answers with an error.
            options: further arguments of `planned`.
        """
        if clear:
            self._frame = (self._frame + 1) % 256
        if clear or reset:
            self._accesses, self._counted, self._wrong = self._accesses[:, :0], [0, 0], 0
        before = self._accesses.shape[1]
        self._accesses = np.concatenate([self._accesses, [case.index, case.level]], axis=1)
        missed = find_misses(*self._accesses, self._config.splat_cache_lines, CACHE_WAYS, False, False)[before:]
        self._counted[0] += int((~missed).sum())
        self._counted[1] += int(missed.sum())
        self._wrong |= bool(wrong)
        base, shift = int(self._rng.integers(1 << BEAT_BITS)), max(int(case.level.max(initial=0)).bit_length(), 0)
        reads = np.zeros(int(missed.sum()), read_request(self._config).dtype)
        reads["beat"] = (base + (case.index[missed] << shift) + case.level[missed]) % (1 << BEAT_BITS)
        data = beats_of(self._config, case.views[missed], self._rng)
        data["error"][list(wrong)] = 1
        item = planned(
            name or case.name, {"sorted": case.sorted, "tiles": case.tiles, "data": data},
            {"entries": case.entries, "reads": reads}, reset=reset,
            settings={"views_base": base, "view_shift": shift, "frame": self._frame, "delay": delay},
            observed={"busy": 0, "hits": self._counted[0], "misses": self._counted[1], "error": self._wrong}
            if options.get("quiet", 1) else None, **options)
        self.runs.append(item)
        return item

    def add_waiting(self, count: int) -> None:
        """Adds a run that ends while a tile still expects `count` intersections: the unit is busy. The next run must reset
        it."""
        tile = np.zeros(1, tile_use(self._config).dtype)
        tile["count"] = count
        case = replace(case_of(self._config, "", [Tile([])], 0), tiles=tile)
        item = self.add(case, f"a tile waits for {count} intersections", quiet=20)
        self.runs[-1] = replace(item, observed={**item.observed, "busy": 1})


def beats_of(config: AcceleratorConfig, views: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N,) ReadData with the splat records in their lowest bits and random bits above."""
    patterns = pack(splat_record(config), views)
    spare = np.zeros((len(views), BEAT_BYTES - patterns.shape[1]), np.uint8)
    words = np.concatenate([patterns, spare], 1).view("<u4").astype(np.int64).reshape(len(views), WORDS)
    words[:, -1] |= rng.integers(0, 1 << BEAT_BYTES * 8 - splat_record(config).width, len(views)) << (
        32 - (BEAT_BYTES * 8 - splat_record(config).width))
    data = np.zeros(len(views), read_data(config).dtype)
    data["word"] = words
    return data


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, with every pattern of pauses and latency; runs cut off; runs back to back with cleared and
    with kept cache."""
    plan = Plan(config, seed)
    for delay in (0, 1, 30, MOST_DELAY):
        for make in DIRECTED:
            case = make(config)
            plan.add(case, f"{case.name}, {delay} cycles", delay=delay)
        plan.add(random_case(config, f"random, {delay} cycles", seed * 100 + delay), delay=delay)
    case = random_case(config, "streams", seed, tiles=30, mean_count=12)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.add(case, name, patterns=patterns, reset=False, clear=True, delay=len(plan.runs) % 20)
    lines = config.splat_cache_lines
    for cycles in (3, lines // 8, lines // 4 + 40, lines // 4 + 150, lines // 4 + 151):
        plan.add(random_case(config, "", seed), f"cut off after {cycles} cycles", abort=cycles)
        plan.add(random_case(config, "", seed + 1), f"whole frame after a reset at {cycles}")
    for k in range(4):
        plan.add(random_case(config, "", seed + 2 + k % 2), f"back to back, cleared {k}", reset=False, quiet=0)
    long = [Tile(np.arange(count) % lines) for count in (70_000, 2, 40_000)]
    plan.add(case_of(config, "", long, seed), "tiles with counts of 17 bits")
    few = case_of(config, "", [Tile(np.arange(lines // 2).repeat(k)) for k in (1, 2, 3)], seed)
    for k in range(4):
        plan.add(few, f"back to back, kept {k}", reset=False, clear=k == 0, quiet=0)
    case = random_case(config, "", seed + 5)
    plan.add(case, "no error", reset=False)
    plan.add(case_of(config, "", [Tile(INDICES // 2 + np.arange(20))], seed), "error", wrong=(3, 17), clear=False, reset=False)
    plan.add(case, "error stays", clear=False, reset=False)
    plan.add(case, "error cleared", reset=False)
    for bit in range(COUNT_BITS):
        plan.add_waiting(1 << bit)
    return plan.runs


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs that must take one intersection per cycle with a memory latency of DELAY cycles: only misses, only hits, and
    both."""
    plan, rng, lines = Plan(config, seed), np.random.default_rng(seed), config.splat_cache_lines
    fresh = INDICES // 4 + np.arange(3000)
    pool = lines * 4 + np.arange(lines)
    both = np.where(rng.random(3000) < 0.5, INDICES // 2 + np.arange(3000), INDICES // 2)
    plan.add(case_of(config, "", [Tile(pool)], seed), "before the rates", delay=DELAY)
    for name, index in (("hits", np.resize(pool, 3000)), ("misses", fresh), ("hits and misses", both)):
        tiles = [Tile(index[i : i + 16]) for i in range(0, len(index), 16)]
        plan.add(
            case_of(config, "", tiles, seed), f"rate, {name}", clear=False, reset=False, delay=DELAY,
            most_cycles=len(index) + DELAY + LATENCY + 10)
    return plan.runs


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The frames of real scenes."""
    plan = Plan(config, 0)
    for name, frame in traced_frames(config, size).items():
        plan.add(traced_case(f"traced {name}", frame), delay=DELAY)
    return plan.runs


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "256x144", "128x128"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its misses and its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        entries, misses = len(item.expected["entries"]), len(item.expected["reads"])
        lines.append(
            f"{item.name}: {entries} entries, {misses / entries:.3f} of them missed, {recording.cycles} cycles, "
            f"{entries / recording.cycles:.4f} entries a cycle")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
