"""Which splats each tile blends, front to back: exact tests of ellipses against tiles, then a stable counting sort by tile.

Intersections, the (splat, tile) pairs, are numbered in the order of the splats, nearest first. What the tiles write for each
intersection is then summed for each splat in a fixed order, whichever thread drew which tile. The test is the oracle's
(`golden.oracle.ellipse`), done for whole rows of tiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from golden.diff.slices import run_slices
from golden.kernels import compiled
from golden.threads import SLICES
from spec.constants import TILE

SLACK = 1e-5
"""Added to the exponent's bound: it covers the rounding of the pixels' own float32 tests, so that no tile misses a splat."""

_RADIX_BITS = 11
_kernel = compiled(nogil=True, error_model="numpy")


@dataclass(frozen=True)
class TileLists:
    """M splats in T tiles with E intersections: tile t (row-major) blends splat[start[t] : start[t + 1]] in this order.

    Attributes:
        start: (T + 1,) int64.
        splat: (E,) int32 rows of the projection.
        pair: (E,) int32 number of the intersection in the order of the splats.
        order: (M,) int32 rows of the projection, sorted by depth, then row.
        room: (M + 1,) int64: the intersections of splat order[k] have the numbers room[k] .. room[k + 1] - 1.
    """

    start: np.ndarray
    splat: np.ndarray
    pair: np.ndarray
    order: np.ndarray
    room: np.ndarray


@_kernel
def depth_order(depth: np.ndarray) -> np.ndarray:
    """(M,) int32 rows sorted by depth (M,) float32 > 0, then row.

    This is a radix sort of the bits, because positive floats have the same order as their bits.
    """
    keys, order = depth.view(np.uint32), np.arange(len(depth), dtype=np.int32)
    other = np.empty_like(order)
    for shift in range(0, 32, _RADIX_BITS):
        cursor = np.zeros((1 << _RADIX_BITS) + 1, np.int64)
        for i in order:
            cursor[((keys[i] >> shift) & ((1 << _RADIX_BITS) - 1)) + 1] += 1
        cursor = np.cumsum(cursor)
        for i in order:
            digit = (keys[i] >> shift) & ((1 << _RADIX_BITS) - 1)
            other[cursor[digit]] = i
            cursor[digit] += 1
        order, other = other, order
    return order


@_kernel
def _met(low: float, high: float, tiles: int, size: int) -> tuple[int, int]:
    """First and last tile along an axis of `size` pixels whose pixel centres span a range that meets [low, high]; 1, 0 if
    none."""
    if low > size - 0.5 or high < 0.5:
        return 1, 0
    return math.ceil(max((low - (TILE - 0.5)) / TILE, 0.0)), math.floor(min((high - 0.5) / TILE, tiles - 1.0))


@_kernel
def _columns(x, y, f0, f1, f2, limit, rim, steep, row, tiles_x, width, height):
    """First and last tile that the ellipse u^2 + v^2 <= limit meets in a tile row: its extent in x between the row's outer
    centres."""
    low = max(row * TILE + 0.5 - y, -rim)
    high = min(min((row + 1) * TILE, height) - 0.5 - y, rim)
    if low > high:
        return 1, 0
    left_y, right_y = min(max(steep, low), high), min(max(-steep, low), high)
    left = (-math.sqrt(max(limit - (f2 * left_y) ** 2, 0.0)) - f1 * left_y) / f0
    right = (math.sqrt(max(limit - (f2 * right_y) ** 2, 0.0)) - f1 * right_y) / f0
    return _met(x + left, x + right, tiles_x, width)


@_kernel
def _visit(part, begin, end, order, mean2d, factor, q_max, width, height, mask, room, tile_of, counts):
    """Goes through the intersections of splats order[begin:end]: counts them into `room` or, unless `tile_of` is empty,
    numbers them."""
    tiles_y, tiles_x = mask.shape
    for k in range(begin, end):
        i = order[k]
        x, y = np.float64(mean2d[i, 0]), np.float64(mean2d[i, 1])
        f0, f1, f2 = np.float64(factor[i, 0]), np.float64(factor[i, 1]), np.float64(factor[i, 2])
        limit = 2 * (q_max[i] + SLACK)
        root = math.sqrt(limit)
        rim, steep = root / f2, f1 * root / (f2 * math.sqrt(f1 * f1 + f2 * f2))
        top, bottom = _met(y - rim, y + rim, tiles_y, height)
        at = room[k]
        for row in range(top, bottom + 1):
            first, last = _columns(x, y, f0, f1, f2, limit, rim, steep, row, tiles_x, width, height)
            for column in range(first, last + 1):
                if mask[row, column]:
                    if len(tile_of):
                        tile_of[at] = row * tiles_x + column
                        counts[part, row * tiles_x + column] += 1
                    at += 1
        if not len(tile_of):
            room[k] = at


@_kernel
def _scatter(part, begin, end, order, room, tile_of, cursor, splat, pair):
    for k in range(begin, end):
        for p in range(room[k], room[k + 1]):
            at = cursor[part, tile_of[p]]
            splat[at], pair[at] = order[k], p
            cursor[part, tile_of[p]] = at + 1


def tile_lists(
    mean2d: np.ndarray, factor: np.ndarray, q_max: np.ndarray, depth: np.ndarray, width: int, height: int, mask: np.ndarray
) -> TileLists:
    """Lists every intersection: every (splat, tile) pair whose footprint meets the rectangle of those of the tile's pixel
    centres that lie in the frame.

    Args:
        mean2d, factor, q_max, depth: (M, 2), (M, 3), (M,), (M,) float32 of `projection.Projection`.
        width, height: size of the frame in pixels.
        mask: (tiles_y, tiles_x) bool, the tiles to list.
    """
    order = depth_order(depth)
    scene = (order, mean2d, factor, q_max, width, height, mask)
    room = np.zeros(len(order) + 1, np.int64)
    counts = np.zeros((SLICES, mask.size), np.int64)
    run_slices(_visit, len(order), *scene, room, np.empty(0, np.int32), counts)
    total = int(room[:-1].sum())
    room[1:], room[0] = np.cumsum(room[:-1]), 0
    tile_of, splat, pair = (np.empty(total, np.int32) for _ in range(3))
    if total:
        run_slices(_visit, len(order), *scene, room, tile_of, counts)
    start = np.concatenate(([0], np.cumsum(counts.sum(axis=0))))
    cursor = start[:-1] + np.cumsum(counts, axis=0) - counts
    run_slices(_scatter, len(order), order, room, tile_of, cursor, splat, pair)
    return TileLists(start, splat, pair, order, room)
