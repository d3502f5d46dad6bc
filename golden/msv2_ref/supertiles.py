"""Pairs of splats and super-tiles: which there are, their index words, their lists, and the groups of the lists
(`spec.supertiles`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden.host.registers import FrameRegisters
from golden.msv2_ref.buckets import Bounds, list_numbers
from golden.msv2_ref.ranges import range_of
from golden.msv2_ref.tile_merge import auto_beta, merge_tiles
from golden.msv2_ref.tile_test import Intersections
from spec.chunks import PLACE_BITS
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y
from spec.records import intersection, list_group
from spec.supertiles import CHUNK_RUN, CHUNK_STREAMS, supertile_pair


class SuperGrid(NamedTuple):
    """How a frame's tiles lie in super-tiles.

    Attributes:
        columns, rows: number of super-tiles along x and along y.
        supertile: (tiles,) int64, the super-tile of each tile.
        place: (tiles,) int64, the tile's number in its super-tile.
        tile: (super-tiles, SUPER_TILES) int64, the tile at each place of a super-tile; -1 beyond the frame.
    """

    columns: int
    rows: int
    supertile: np.ndarray
    place: np.ndarray
    tile: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """(super-tiles, SUPER_TILES) bool: the places that lie in the frame."""
        return self.tile >= 0


class Pairs(NamedTuple):
    """The pairs of a frame in rendering order: by super-tile, depth key and index.

    Attributes:
        start: (super-tiles + 1,) int64, first pair of each super-tile.
        splat: (P,) int32, row of each pair's Gaussian.
        index: (P,) int64, its index word: chunk and place in the chunk.
        depth_key: (P,) int64, sort key.
        mask: (P,) uint16, tiles of the super-tile with an intersection, one bit each.
        levels: (P,) uint8, levels among these tiles, one bit each.
        intersection: (E,) int64, the pair of each of the frame's intersections, which are in the order of `Intersections`.
    """

    start: np.ndarray
    splat: np.ndarray
    index: np.ndarray
    depth_key: np.ndarray
    mask: np.ndarray
    levels: np.ndarray
    intersection: np.ndarray

    @property
    def supertile(self) -> np.ndarray:
        """(P,) int64, the super-tile of each pair."""
        return range_of(self.start)


def super_grid(registers: FrameRegisters, origin: int = 0, columns: int | None = None) -> SuperGrid:
    """How the tiles of a frame lie in super-tiles.

    Args:
        registers: the frame's registers.
        origin, columns: in joint frames (`spec.joint`), the columns of tiles by which the eye's frame lies right of the first
            super-tile's left edge, and the columns of super-tiles; None: as many as the frame has.
    """
    columns = -(-(registers.tiles_x + origin) // SUPER_X) if columns is None else columns
    rows = -(-registers.tiles_y // SUPER_Y)
    tile_y, tile_x = np.divmod(np.arange(registers.tiles_x * registers.tiles_y), registers.tiles_x)
    tile_x += origin
    supertile = tile_y // SUPER_Y * columns + tile_x // SUPER_X
    place = tile_y % SUPER_Y * SUPER_X + tile_x % SUPER_X
    tile = np.full((columns * rows, SUPER_TILES), -1, np.int64)
    tile[supertile, place] = np.arange(len(supertile))
    return SuperGrid(columns, rows, supertile, place, tile)


def index_words(chunks: np.ndarray) -> np.ndarray:
    """(N,) int64: the `index` that each Gaussian has in machines with super-tiles, chunk << PLACE_BITS | place in the chunk.

    Args:
        chunks: (C,) ChunkHeader records.
    """
    count = chunks["count"].astype(np.int64)
    begin = np.cumsum(count) - count
    place = np.arange(count.sum()) - np.repeat(begin, count)
    return np.repeat(np.arange(len(chunks)) << PLACE_BITS, count) | place


def chunk_order(chunks: int) -> np.ndarray:
    """(chunks,) int64: the numbers of a model's chunks in the order in which the first phase reads them."""
    runs = -(-chunks // (CHUNK_RUN * CHUNK_STREAMS))  # of a part
    run = (np.arange(runs)[:, None] + runs * np.arange(CHUNK_STREAMS)).reshape(-1)
    order = (CHUNK_RUN * run[:, None] + np.arange(CHUNK_RUN)).reshape(-1)
    return order[order < chunks]


class EyePairs(NamedTuple):
    """The pairs of a frame or of an eye, in rendering order.

    Attributes:
        key: (P,) int64, super-tile * number of ranked splats + rank of the splat; increasing.
        mask: (P,) uint16, as in `Pairs`.
        levels: (P,) uint8, as in `Pairs`.
        intersection: (E,) int64, as in `Pairs`.
    """

    key: np.ndarray
    mask: np.ndarray
    levels: np.ndarray
    intersection: np.ndarray


def ranked_splats(depth_key: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The order of the splats that are `seen`, (N,) bool: their rows by depth key and index; and (N,) int64, the place of each
    of them in this order, 0 for others."""
    splats = np.flatnonzero(seen)
    ranked, rank = splats[np.argsort(depth_key[splats], kind="stable")], np.zeros(len(depth_key), np.int64)
    rank[ranked] = np.arange(len(ranked))
    return ranked, rank


def eye_pairs(
    registers: FrameRegisters, grid: SuperGrid, rank: np.ndarray, ranked: int, entries: Intersections,
) -> EyePairs:
    """The pairs of a frame, or of an eye of a joint frame.

    Args:
        registers: the frame's registers.
        grid: how its tiles lie in super-tiles.
        rank: (N,) the place of each splat in the order of depth key and index. ranked: how many have one.
        entries: the frame's intersections, within a tile in this order.
    """
    tile = np.repeat(np.arange(len(grid.supertile)), np.diff(entries.start))
    key = grid.supertile[tile] * max(ranked, 1) + rank[entries.splat]
    order = np.argsort(key, kind="stable")  # tiles' lists are sorted already, so the sort has only to merge them
    new = np.diff(key[order], prepend=-1) > 0
    first = np.flatnonzero(new)
    pair_of = np.empty(len(key), np.int64)
    pair_of[order] = np.cumsum(new) - 1
    mask, levels = np.zeros(len(first), np.uint16), np.zeros(len(first), np.uint8)
    if len(first):
        mask = np.bitwise_or.reduceat((1 << grid.place[tile[order]]).astype(np.uint16), first)
        levels = np.bitwise_or.reduceat((1 << registers.header[tile[order], 0]).astype(np.uint8), first)
    return EyePairs(key[order[first]], mask, levels, pair_of)


def find_pairs(
    registers: FrameRegisters, chunks: np.ndarray, depth_key: np.ndarray, entries: Intersections,
) -> Pairs:
    """The pairs of a frame.

    Args:
        registers: the frame's registers.
        chunks: (C,) ChunkHeader records.
        depth_key: (N,) sort key of every Gaussian.
        entries: the frame's intersections, within a tile by depth key and index.
    """
    grid, seen = super_grid(registers), np.zeros(len(depth_key), bool)
    seen[entries.splat] = True
    ranked, rank = ranked_splats(depth_key, seen)
    found = eye_pairs(registers, grid, rank, len(ranked), entries)
    supertile, place = np.divmod(found.key, max(len(ranked), 1))
    counts, splat = np.bincount(supertile, minlength=len(grid.tile)), ranked[place].astype(np.int32)
    return Pairs(np.concatenate(([0], np.cumsum(counts))), splat, index_words(chunks)[splat], depth_key[splat].astype(np.int64),
                 found.mask, found.levels, found.intersection)


def list_counts(pairs: Pairs, bounds: Bounds) -> np.ndarray:
    """(lists,) int64: the pairs of each list."""
    return np.bincount(list_numbers(bounds, pairs.supertile, pairs.depth_key), minlength=bounds.lists)


def merge_lists(config: AcceleratorConfig, counts: np.ndarray, beta: int | None) -> np.ndarray:
    """Group id of every list, (lists,) int64: lists are merged as tiles of one row; if `beta` is None, `auto_beta` chooses
    it."""
    return merge_tiles(counts, max(len(counts), 1), auto_beta(counts, config) if beta is None else beta)


def list_groups(config: AcceleratorConfig, pairs: Pairs, bounds: Bounds, beta: int | None) -> np.ndarray:
    """(lists,) ListGroup records: the TileGroups that the tile merge unit emits, and `ends`."""
    counts = list_counts(pairs, bounds)
    groups = merge_lists(config, counts, beta)
    rows = np.zeros(len(counts), list_group(config).dtype)
    rows["tile"], rows["count"], rows["group"] = np.arange(len(counts)), counts, groups
    rows["last"] = np.append(np.diff(groups) > 0, True)
    rows["ends"][bounds.first[1:] - 1] = 1
    return rows


def binned_pairs(config: AcceleratorConfig, pairs: Pairs) -> np.ndarray:
    """(P + 1,) SuperTilePair records as the tile test emits them if Gaussians come in their order in memory: splat by splat, by
    super-tile; an item with `end` is the last."""
    order = np.lexsort((pairs.supertile, pairs.splat))
    rows = np.zeros(len(order) + 1, supertile_pair(config).dtype)
    rows["index"][:-1], rows["depth_key"][:-1] = pairs.index[order], pairs.depth_key[order]
    rows["supertile"][:-1], rows["end"][-1] = pairs.supertile[order], 1
    return rows


def sorted_pairs(config: AcceleratorConfig, pairs: Pairs, bounds: Bounds) -> np.ndarray:
    """(P,) Intersection records, whose tile is the list, as they leave the sorter. Empty chunks of the sorter are not among
    them."""
    rows = np.zeros(len(pairs.splat), intersection(config).dtype)
    rows["index"], rows["depth_key"] = pairs.index, pairs.depth_key
    rows["tile"] = list_numbers(bounds, pairs.supertile, pairs.depth_key)
    return rows
