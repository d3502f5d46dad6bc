"""Stimuli of splat fetch: tiles, the sorted intersections that need splat records, and these records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.frame_memory import splat_records
from golden.msv2_ref.pipeline import Frame
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.formats import Fixed
from spec.memory import splat_record
from spec.records import INDEX_BITS, array_splat, chunk_item, frame_tiles, tile_use

INDICES = 1 << INDEX_BITS


@dataclass(frozen=True)
class Case:
    """The tiles of a frame.

    Attributes:
        name: the case's name, for messages.
        tiles: (tiles,) TileUse records.
        sorted: ChunkItem items, including those that stand for an empty group.
        index, level: (intersections,) int64, the splat and the level of each record that is needed.
        views: (intersections,) SplatRecord, the splat records as memory holds them.
        entries: (intersections,) ArraySplat, the expected output.
    """

    name: str
    tiles: np.ndarray
    sorted: np.ndarray
    index: np.ndarray
    level: np.ndarray
    views: np.ndarray
    entries: np.ndarray


@dataclass(frozen=True)
class Tile:
    """One tile of a hand-made case."""

    index: Sequence[int]
    level: int = 0
    blend: int = 0


def random_views(config: AcceleratorConfig, rng: np.random.Generator, index: np.ndarray, level: np.ndarray) -> np.ndarray:
    """(N,) SplatRecord records with random bits; equal index and level give equal records."""
    _, which = np.unique(index * MAX_LEVELS + level, return_inverse=True)
    views = np.zeros(which.max(initial=-1) + 1, splat_record(config).dtype)
    for f in splat_record(config).fields:
        low, high = f.raw_range if isinstance(f.format, Fixed) else (0, (1 << f.format.width) - 1)
        views[f.name] = rng.integers(low, high + 1, views[f.name].shape)
    return views[which]


def case_of(config: AcceleratorConfig, name: str, tiles: Sequence[Tile], seed: int, *, groups_without: int = 0) -> Case:
    """A case of tiles with random splat records. `groups_without` items that stand for empty groups are inserted at random
    places."""
    rng = np.random.default_rng(seed)
    uses = np.zeros(len(tiles), tile_use(config).dtype)
    uses["level"], uses["blend"] = [t.level for t in tiles], [t.blend for t in tiles]
    uses["count"] = [len(t.index) for t in tiles]
    index = np.concatenate([np.asarray(t.index, np.int64) for t in tiles])
    level, blend = (np.repeat(uses[field].astype(np.int64), uses["count"]) for field in ("level", "blend"))
    views = random_views(config, rng, index, level)

    entries = np.zeros(len(index), array_splat(config).dtype)
    for field in ("mean2d", "conic", "log2_opacity", "colour", "depth"):
        entries[field] = views[field]
    entries["use"] = np.stack([views["bound"] >= level, (blend == 1) & (views["bound"] >= level + 1)], 1)

    items = np.zeros(len(index), chunk_item(config).dtype)
    items["index"], items["depth_key"] = index, rng.integers(0, config.formats.depth_key.raw_max + 1, len(index))
    items["tile"] = np.repeat(np.arange(len(tiles)) % frame_tiles(config), uses["count"])
    items["last"] = rng.integers(0, 2, len(index))
    none = np.zeros(1, items.dtype)
    none["last"] = none["empty"] = 1
    places = rng.integers(0, len(items) + 1, groups_without)
    return Case(name, uses, np.insert(items, places, none), index, level, views, entries)


def traced_case(name: str, frame: Frame) -> Case:
    """The tiles and intersections of a rendered frame."""
    config, e = frame.config, frame.entries
    counts = np.diff(e.start)
    uses = np.zeros(len(counts), tile_use(config).dtype)
    uses["level"], uses["blend"], uses["count"] = frame.registers.header[:, 0], frame.registers.header[:, 1], counts
    index, tile = e.splat.astype(np.int64), np.repeat(np.arange(len(counts)), counts)
    level = frame.registers.header[tile, 0]
    items = np.zeros(len(index), chunk_item(config).dtype)
    items["index"], items["tile"], items["depth_key"] = index, tile, frame.projected.depth_key[index]
    items["last"] = np.diff(frame.groups[tile], append=-1) != 0
    return Case(name, uses, items, index, level, splat_records(frame, MAX_LEVELS)[index, level], frame.array_entries)


def _again(config: AcceleratorConfig) -> Case:
    """One splat record in consecutive intersections, so that hits meet a pending miss, and the same record again at every small
    distance."""
    runs = [Tile([7 + k] * length) for k, length in enumerate((1, 2, 3, 5, 40))]
    apart = [Tile([100 * d + k % d for k in range(2 * d)]) for d in range(1, 20)]
    return case_of(config, "the same splat again", [*runs, *apart], 1)


def _conflicts(config: AcceleratorConfig) -> Case:
    """Splat records that displace each other: 2 to 8 of the same set in turn, with and without hits between them, and at
    random."""
    lines = config.splat_cache_lines
    turns = [Tile([n + k * lines for k in range(n)] * 6) for n in range(2, 9)]
    twice = [Tile(np.repeat([n + k * lines for k in range(n)], 2).tolist() * 3) for n in range(2, 9)]
    mixed = [Tile((9 + lines * np.random.default_rng(2).integers(0, 7, 200)).tolist())]
    ends = [Tile([INDICES - 1, lines - 1, INDICES - 1, 0, lines, INDICES - lines])]
    return case_of(config, "conflicts", [*turns, *twice, *mixed, *ends], 2)


def _levels(config: AcceleratorConfig) -> Case:
    """The same splats at every level, with and without blending: each level has its own cache line."""
    tiles = [Tile([3, 4, 3, 4 + k], level, blend) for k in range(3) for level in (0, 1, 2, 3, 2, 1) for blend in (0, 1)]
    return case_of(config, "every level", tiles, 3)


def _empty(config: AcceleratorConfig) -> Case:
    """Tiles without intersections, alone, in rows and at both ends, and empty groups."""
    some = [Tile([k, k + 1], 1) for k in range(6)]
    tiles = [Tile([])] * 20 + [some[0], Tile([], 3, 1), some[1], *some[2:4]] + [Tile([], 2)] * 30 + some[4:] + [Tile([])] * 3
    return case_of(config, "empty tiles", tiles, 4, groups_without=12)


def _every_line(config: AcceleratorConfig) -> Case:
    """Every line is filled, then hit in another order; then other splats fill the same lines; finally the first ones return."""
    rng, lines = np.random.default_rng(5), config.splat_cache_lines
    first, other = np.arange(lines), lines + rng.permutation(lines)
    ups = (first, rng.permutation(lines), other, np.sort(other)[::-1], first)
    return case_of(config, "every line", [Tile(up) for up in ups], 5)


DIRECTED: tuple[Callable[[AcceleratorConfig], Case], ...] = (_again, _conflicts, _levels, _empty, _every_line)
"""Functions that make the hand-made cases."""


def random_case(config: AcceleratorConfig, name: str, seed: int, tiles: int = 40, mean_count: int = 20) -> Case:
    """Tiles that share splats with the tiles shortly before them. The splats need up to 24 times the cache's lines."""
    rng = np.random.default_rng(seed)
    spread = config.splat_cache_lines * int(rng.choice([1, 2, 8]))
    made = []
    for k in range(tiles):
        count = int(rng.choice([0, 1, rng.geometric(1 / mean_count)], p=[0.15, 0.15, 0.7]))
        index = (k * 5 + rng.integers(0, 50, count)) % spread + spread * rng.integers(0, 3, count)
        made.append(Tile(index, int(rng.integers(MAX_LEVELS)) if k % 3 == 0 else k // 16 % MAX_LEVELS, int(rng.random() < 0.3)))
    return case_of(config, name, made, seed, groups_without=int(rng.integers(0, 4)))
