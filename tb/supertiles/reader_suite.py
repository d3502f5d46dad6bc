"""The super-tile reader's tests: lists of whole frames and the host's table go in, every super-tile is compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from amaranth.hdl import Module

from rtl.supertiles.reader import SUPERTILE_BEATS, SuperTileReader
from spec.config import TINY_EYES, TINY_V3, V3, V3_EYES, AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint import EYES, SHIFT_MOST
from spec.memory import BEAT_BITS, SHIFT_BITS, TILE_SETTING_BYTES, WORDS, read_data, read_request, tile_setting
from spec.packing import pack
from spec.records import COUNT_BITS, frame_lists, list_group
from spec.supertiles import BUCKETS, supertile
from tb.common import exact
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback
from tb.tile_lists.stimuli import random_rows

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3, "tiny_eyes": TINY_EYES, "v3_eyes": V3_EYES}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units."""

PORTS = ("lists", "data", "reads", "supertiles")

MOST_DELAY = 300
"""Largest `delay`, in cycles from a request to its beat."""

SETTLING = 10
"""Most cycles of a run in addition to those of its super-tiles and the memory's latency."""


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one shape.

    Attributes:
        name: the case's name, for messages.
        width, height: size of the frame in pixels.
        counts: for each frame, for each super-tile, the pairs of each of its lists.
        settings: (super-tiles * eyes * SUPER_TILES,) TileSetting records, the host's table; it is the same for all frames.
        base: the table's first beat.
        bad: beats of the table, by number over all frames, that the memory answers with an error.
        joint, shift: the settings; without `joint`, `shift` means nothing.
    """

    name: str
    width: int
    height: int
    counts: tuple[Sequence[np.ndarray], ...]
    settings: np.ndarray
    base: int
    bad: tuple[int, ...] = ()
    joint: bool = False
    shift: int = 0

    @property
    def eyes(self) -> int:
        """SuperTile items of a super-tile."""
        return EYES if self.joint else 1

    def inputs(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """The lists, and the beats of the table; whatever else a ListGroup says is drawn."""
        rng, lists = np.random.default_rng(len(self.counts)), []
        for frame in self.counts:
            rows = random_rows(list_group(config), rng, sum(len(counts) for counts in frame))
            rows["tile"], rows["count"], rows["ends"] = np.arange(len(rows)), np.concatenate(frame), 0
            rows["ends"][np.cumsum([len(counts) for counts in frame]) - 1] = 1
            lists.append(rows)
        words = pack(tile_setting(config), self.settings, TILE_SETTING_BYTES).view("<u4").reshape(-1, WORDS)
        beats = np.zeros(len(words) * len(self.counts), read_data(config).dtype)
        beats["word"] = np.tile(words, (len(self.counts), 1))
        beats["error"][list(self.bad)] = 1
        return {"lists": np.concatenate(lists), "data": beats}

    def expected(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Requests and super-tiles of all frames."""
        tiles_x, tiles_y = -(-self.width // TILE), -(-self.height // TILE)
        columns = across(self.width, self.shift if self.joint else 0)
        rows = np.zeros(len(self.settings) // SUPER_TILES, supertile(config).dtype)
        shares = self.settings.reshape(-1, SUPER_TILES)
        for number, (row, share) in enumerate(zip(rows, shares, strict=True)):
            s, eye = divmod(number, self.eyes)
            row["x"], row["y"] = SUPER_X * (s % columns), SUPER_Y * (s // columns)
            origin = max(-self.shift if eye else self.shift, 0) * self.joint
            if config.joint:
                row["eye"] = eye
            for place in range(SUPER_TILES):
                x, y = int(row["x"]) + place % SUPER_X - origin, int(row["y"]) + place // SUPER_X
                row["inside"] |= (1 << place) * (0 <= x < tiles_x and y < tiles_y)
                row["blend"] |= int(share["blend"][place]) << place
            row["level"], row["plane"] = share["level"], share["plane"].ravel()
        frames = [rows.copy() for _ in self.counts]
        for frame, counts in zip(frames, self.counts, strict=True):
            frame["pairs"] = np.repeat([part.sum() for part in counts], self.eyes)
        reads = np.zeros(len(rows) * SUPERTILE_BEATS * len(frames), read_request(config).dtype)
        reads["beat"] = (self.base + np.tile(np.arange(len(rows) * SUPERTILE_BEATS), len(frames))) % (1 << BEAT_BITS)
        return {"reads": reads, "supertiles": np.concatenate(frames)}


def across(width: int, shift: int) -> int:
    """Super-tiles in a row of a frame."""
    return -(-(-(-width // TILE) + abs(shift)) // SUPER_X)


def random_case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, width: int, height: int, *, frames: int = 2,
    lists: float = 0.5, joint: bool = False, shift: int = 0, **options: object,
) -> Case:
    """Frames with drawn settings and counts; `lists` is the mean number of lists of a super-tile beyond its first."""
    total = across(width, shift if joint else 0) * -(-height // (SUPER_Y * TILE))

    def counts() -> list[np.ndarray]:
        more = np.minimum(rng.poisson(lists, total), BUCKETS - 1)
        more *= np.cumsum(more) <= frame_lists(config) - total
        parts = [rng.integers(0, 1 << rng.integers(1, COUNT_BITS - 4), 1 + n) for n in more]
        return [part * (rng.random(len(part)) < 0.7) for part in parts]

    drawn = tuple(counts() for _ in range(frames))
    settings = random_rows(tile_setting(config), rng, total * SUPER_TILES * (EYES if joint else 1))
    base = int(rng.integers(1, 1 << BEAT_BITS))
    return Case(name, width, height, drawn, settings, base, joint=joint, shift=shift, **options)


class ReaderBench(Bench):
    """The reader with delayed `data`."""

    def __init__(self, config: AcceleratorConfig) -> None:
        self._unit = SuperTileReader(config)
        super().__init__(
            {"lists": list_group(config), "data": read_data(config)},
            {"reads": read_request(config), "supertiles": supertile(config)},
            {"supertiles_base": BEAT_BITS, "width": 14, "height": 14, "clear": 1, "delay": MOST_DELAY.bit_length(),
             **({"joint": 1, "shift": SHIFT_BITS} if config.joint else {})},
            {"error": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        self.join(m, unit, apart=("data",))
        self.delay_answers(m, unit, MOST_DELAY, opposite=True)
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"supertile-reader-{config.row_width}-{config.list_heads}{'-joint' * config.joint}"
    verilog = emitted(name, config, lambda config: ReaderBench(config).playback(name, "reader_bench").verilog)
    return ReaderBench(config).playback(name, "reader_bench", verilog)


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, *, delay: int = 20, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    settings = {"supertiles_base": case.base, "width": case.width, "height": case.height, "clear": 0, "delay": delay}
    if config.joint:
        settings |= {"joint": int(case.joint), "shift": case.shift % (1 << SHIFT_BITS)}
    return planned(
        name or case.name, case.inputs(config), case.expected(config), observed={"error": bool(case.bad)}, settings=settings,
        **options)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames of all shapes, the largest one, errors of memory, pauses, resets, and runs back to back at full rate."""
    rng, side = np.random.default_rng(seed), config.row_width
    wide, high = SUPER_X * TILE, SUPER_Y * TILE
    plan = []
    for width, height in ((1, 1), (wide, high), (wide + 1, high + 1), (wide - TILE, high - TILE), (2 * wide - TILE + 1, TILE),
                          (2 * wide, 3 * high - TILE), (3 * TILE, 5 * high + 1), (side, side - 3)):
        plan.append(plan_of(config, random_case(config, rng, f"{width} by {height}", width, height)))
    for columns in range(1, SUPER_X + 1):
        width = wide + columns * TILE - columns
        case = random_case(config, rng, f"{columns} tiles across in a row's last super-tile", width, high, frames=1)
        plan.append(plan_of(config, case, reset=False))
    plan.append(plan_of(config, random_case(config, rng, "lists without end", 200, 100, lists=12)))
    plan.append(plan_of(config, random_case(config, rng, "errors of memory", 300, 100, bad=(9,)), delay=3))
    plan.append(plan_of(config, random_case(config, rng, "no errors", 300, 100)))
    case = random_case(config, rng, "streams", 3 * wide - 5, 4 * high - 20, frames=3)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, case, name, patterns=patterns, reset=False))
    for cycles in (3, 17, 40, 77, 120):
        plan.append(plan_of(config, case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, case, f"frames after a reset at {cycles}"))
    for k, delay in enumerate((1, 30, MOST_DELAY - 1)):
        case = random_case(config, rng, f"rate, latency {delay}", side, side // (k + 1), frames=1, lists=0.2)
        most = max((SUPERTILE_BEATS + 1) * len(case.counts[0]), sum(map(len, case.counts[0]))) + delay + SETTLING
        plan.append(plan_of(config, case, delay=delay, reset=False, quiet=0, most_cycles=most))
    return plan


def joint_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Joint frames of all shapes and shifts, also between frames of one eye that have a shift, which means nothing."""
    rng, side = np.random.default_rng(seed), config.row_width
    wide, high = SUPER_X * TILE, SUPER_Y * TILE
    plan = []
    for k, shift in enumerate(range(-SHIFT_MOST, SHIFT_MOST + 1)):
        width = (1, wide, wide + 1, 2 * wide - TILE, 3 * wide - 40)[k % 5]
        case = random_case(config, rng, f"joint, {width} wide, shift {shift}", width, 2 * high - TILE, joint=True, shift=shift)
        plan.append(plan_of(config, case, reset=k % 2 == 0))
        if k % 4 == 0:
            plan.append(plan_of(config, random_case(config, rng, f"one eye with shift {shift}", width, high, shift=shift),
                                reset=False))
    for shift in (0, 5, -8):
        most = frame_lists(config) // across(side, shift) * high
        plan.append(plan_of(config, random_case(
            config, rng, f"joint, the largest frame, shift {shift}", side, min(side, most), frames=1, joint=True, shift=shift)))
    case = random_case(config, rng, "joint streams", 3 * wide - 5, 4 * high - 20, frames=3, joint=True, shift=3)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, case, f"joint, {name}", patterns=patterns, reset=False))
    for cycles in (17, 77):
        plan.append(plan_of(config, case, f"joint, cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, case, f"joint frames after a reset at {cycles}"))
    case = random_case(config, rng, "joint, rate", side, side // 2, frames=1, lists=0.2, joint=True, shift=1)
    most = EYES * (SUPERTILE_BEATS + 1) * len(case.counts[0]) + 30 + SETTLING
    plan.append(plan_of(config, case, delay=30, reset=False, quiet=0, most_cycles=most))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *(joint_plan(config, seed) if config.joint else [])]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [
        f"{item.name}: {len(item.expected['supertiles'])} super-tiles, {recording.cycles} cycles"
        for item, recording in exact.at_full_rate(plan, outcome)]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
