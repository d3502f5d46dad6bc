"""Stimuli of the tile merge unit: frames given by the tile of every intersection, in the order of arrival."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.tile_merge import auto_beta, count_tiles, tile_groups
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, intersection_tile


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one shape.

    Attributes:
        name: the case's name, for messages.
        tiles_x, tiles_y: the numbers of tile columns and rows.
        frames: for each frame (intersections,) the tile of each intersection.
        beta: the merge threshold; None for the automatic one.
    """

    name: str
    tiles_x: int
    tiles_y: int
    frames: tuple[np.ndarray, ...]
    beta: int | None = None

    @property
    def tiles(self) -> int:
        """Number of tiles of a frame."""
        return self.tiles_x * self.tiles_y

    @property
    def settings(self) -> dict[str, int]:
        """Values of the unit's plain inputs."""
        return {"tiles_x": self.tiles_x, "tile_count": self.tiles, "auto": self.beta is None, "beta": self.beta or 0}

    def items(self, config: AcceleratorConfig) -> np.ndarray:
        """The IntersectionTile items of all frames."""
        rows = np.zeros(sum(len(hits) + 1 for hits in self.frames), intersection_tile(config).dtype)
        ends = np.cumsum([len(hits) + 1 for hits in self.frames]) - 1
        rows["end"][ends] = 1
        rows["tile"][rows["end"] == 0] = np.concatenate(self.frames)
        return rows

    def groups(self, config: AcceleratorConfig) -> np.ndarray:
        """The groups that the golden renderer forms."""
        counts = [count_tiles(hits, self.tiles)[0] for hits in self.frames]
        return np.concatenate([tile_groups(config, count, self.tiles_x, self.beta) for count in counts])

    def observed(self, config: AcceleratorConfig) -> dict[str, int]:
        """Plain outputs after the last frame."""
        counts, saturated, outside = count_tiles(self.frames[-1], self.tiles)
        beta = auto_beta(counts, config) if self.beta is None else max(self.beta, 1)
        return {"saturated": saturated, "outside": outside, "beta_used": beta, "busy": 0}


def random_tiles(rng: np.random.Generator, tiles: int, entries: int) -> np.ndarray:
    """Tiles of about `entries` intersections: counts over several orders of magnitude, empty tiles, and bursts of one tile."""
    weight = np.exp(rng.normal(0, 2, tiles)) * (rng.random(tiles) < 0.7)
    weight[rng.integers(tiles)] += 1
    drawn = rng.choice(tiles, size=max(entries // 2, 1), p=weight / weight.sum())
    return np.repeat(drawn, rng.choice([1, 1, 1, 2, 3, 4], len(drawn)))


def random_case(rng: np.random.Generator, name: str, widest: int, entries: int, frames: int = 3) -> Case:
    """Frames of one random shape and merge threshold."""
    tiles_x, tiles_y = (int(n) for n in rng.integers(1, widest + 1, 2))
    beta = [None, int(rng.integers(0, 2 + 4 * entries // (tiles_x * tiles_y)))][int(rng.integers(2))]
    return Case(name, tiles_x, tiles_y, tuple(random_tiles(rng, tiles_x * tiles_y, entries) for _ in range(frames)), beta)


def corner_cases(widest: int) -> list[Case]:
    """Cases by hand: no intersections, one tile repeatedly, tiles in turn, thresholds at their limits, tiles outside the
    frame."""
    rng, none = np.random.default_rng(0), np.empty(0, np.int64)
    turns = np.tile(np.arange(3), 400)
    mixed = random_tiles(rng, 7 * 5, 800)
    return [
        Case("no entries", 4, 3, (none, none), None),
        Case("no entries, then some, then none", 4, 3, (none, turns, none), None),
        Case("one tile", 1, 1, (np.zeros(700, np.int64),) * 2, None),
        Case("one tile of many", widest, 2, (np.full(5000, widest + 1),), 300),
        Case("counts of 19 bits", 2, 1, (np.full((1 << 19) - 1, 1), counted((3, 1))), None),
        Case("tiles in turn", 3, 1, (turns, turns[:-1], np.sort(turns)), 500),
        Case("two tiles in turn", 2, 1, (turns % 2, np.repeat(turns % 2, 2)), 1),
        *(Case(f"beta {beta}", 7, 5, (mixed,), beta) for beta in (0, 1, 2, 1000, (1 << 24) - 1)),
        Case("one row", widest, 1, (random_tiles(rng, widest, 900),), None),
        Case("one column", 1, widest, (random_tiles(rng, widest, 900),), None),
        Case("tiles outside the frame", 4, 3, (np.concatenate([turns, [12, 15, 12]]), turns), 50),
        Case("tiles outside the last frame", 4, 3, (turns, np.concatenate([[12, 15, 12], turns])), 50),
        Case("largest frame", widest, widest, (random_tiles(rng, widest * widest, 3 * widest * widest),), None),
    ]


def counted(counts: Iterable[int]) -> np.ndarray:
    """The tiles of a frame with these counts, each tile's intersections in a row."""
    return np.repeat(np.arange(len(counts)), counts)


def shape_cases(rng: np.random.Generator, widest: int, count: int = 40) -> list[Case]:
    """Frames of few intersections, of every shape: one row, one column, and numbers of tiles next to powers of two."""
    powers = [size for size in (1 << bit for bit in range((widest * widest).bit_length())) if size + 1 <= widest * widest]
    shapes = {(size + more, 1) for size in powers for more in (-1, 0, 1)} | {(1, size + 1) for size in powers}
    shapes |= {tuple(int(n) for n in rng.integers(1, widest + 1, 2)) for _ in range(count)}
    return [Case(f"shape {tiles_x}x{tiles_y}", tiles_x, tiles_y, (rng.integers(0, tiles_x * tiles_y, 30),) * 2, 9)
            for tiles_x, tiles_y in sorted(shapes) if tiles_x]


def threshold_cases(rng: np.random.Generator) -> list[Case]:
    """Groups whose totals are one below a threshold, equal to it and one above it, for every bit of the threshold. Above the
    tenth bit totals cannot be reached, so the groups begin with an empty tile or a single intersection instead."""
    cases = []
    for bit in range(COUNT_BITS):
        power = 1 << bit
        if bit < 11:
            frames = [(power - 1, 0, 1, power), (power, 1, 0, 0), (1, power - 1, 1, 1), (power + 1, 1, power, 0)]
            cases.append(Case(f"counts about {power}", 4, 1, tuple(map(counted, frames)), power))
        if power > 1:
            frames = [(0, 2, 1, 3), (0, 0, power % 7 + 1, 1), (1, 0, 3, 0)]
            cases.append(Case(f"threshold {power + 1}", 4, 1, tuple(map(counted, frames)), power + 1))
    for number in range(12):
        frames = tuple(counted(rng.integers(0, 9, 24) * (rng.random(24) < 0.7)) for _ in range(4))
        cases.append(Case(f"small thresholds {number}", 8, 3, frames, int(rng.integers(1, 40))))
    return cases


def average_cases(widest: int) -> list[Case]:
    """Frames whose automatic thresholds have every bit set and not set: totals divided by 1 to 15 filled tiles, with every
    remainder, ties to even among them, and quotients about every power of two; and ties of as many tiles as there are."""
    frames: list[tuple[int, ...]] = []
    for filled in (1, 2, 3, 4, 5, 7, 8, 15):
        about = {filled << bit for bit in range(8)}
        totals = {filled + rest for rest in range(filled)} | {total + more for total in about for more in (-1, 0, 1)}
        for total in sorted(total for total in totals if total >= filled):
            counts = [total // filled + (tile < total % filled) for tile in range(filled)]
            frames.append((*counts, *[0] * (15 - filled)))
    ties = []
    for filled in (1 << bit for bit in range(4, (widest * widest).bit_length())):  # twice the total has half of it as its rest
        ties += [np.arange(filled + quarter * filled // 4) % filled for quarter in (1, 3)]
    return [Case("averages", 15, 1, tuple(map(counted, frames))), Case("ties", widest, widest, tuple(ties))]


def case_of(frame: Frame, name: str, beta: int | None = None) -> Case:
    """A traced frame: the Gaussians in the order of their indices, each with its tiles."""
    registers, entries = frame.registers, frame.entries
    tile = np.repeat(np.arange(len(entries.start) - 1), np.diff(entries.start))
    arrival = np.lexsort((tile, entries.splat))
    return Case(name, registers.tiles_x, registers.tiles_y, (tile[arrival],), beta)
