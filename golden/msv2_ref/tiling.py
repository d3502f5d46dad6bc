"""The culling unit's last step: which tiles a projected Gaussian touches, and the foveation filter.

For one row of tiles the ellipse's reach along x is an interval (the projection of a convex set), so the exact
ellipse-rectangle test costs two square roots a row and yields a run of columns. Both ends are widened by the margins of
`culling`, so that rounding never loses a tile in which a pixel would change.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from golden.msv2_ref.culling import EDGE_MARGIN, REACH_MARGIN, Projected, culling_constants, falloff_limit
from golden.msv2_ref.parallel import SLICES, for_slices
from golden.msv2_ref.registers import FrameRegisters
from golden.msv2_ref.rounding import rnd
from spec.config import AcceleratorConfig
from spec.constants import TILE


class TileEntries(NamedTuple):
    """Tile entries grouped by tile, in the order of the splat list inside each tile.

    Attributes:
        start: (tiles + 1,) int64, first entry of each tile.
        splat: (entries,) int32, row of the entry's Gaussian.
        use: (entries,) uint8, bit 0: the tile's level uses it (always), bit 1: the blend tile's next level does.
        filtered: pairs that touch but that the foveation filter rejects.
    """

    start: np.ndarray
    splat: np.ndarray
    use: np.ndarray
    filtered: int


class _Scene(NamedTuple):
    """What the tile test reads of the splats and of the frame."""

    mean2d: np.ndarray
    conic: np.ndarray
    box: np.ndarray
    opacity: np.ndarray
    bound: np.ndarray
    header: np.ndarray
    tiles_x: int
    width: int
    height: int
    obb: bool


@numba.njit(cache=True)
def _row_reach(l1, l2, l3, limit, low_y, high_y, W):
    """Reach along x, relative to the mean, of the ellipse u^2 + v^2 <= limit within low_y..high_y; left > right: none."""
    root = rnd(np.sqrt(limit), W)
    rim = rnd(root / l3, W)
    low, high = max(low_y, -rim), min(high_y, rim)
    if low > high:
        return 1.0, 0.0
    # The rightmost point of the whole ellipse lies at y = -steep, the leftmost at +steep.
    steep = rnd(rnd(l2 * root, W) / rnd(l3 * rnd(np.sqrt(rnd(rnd(l2 * l2, W) + rnd(l3 * l3, W), W)), W), W), W)
    right_y, left_y = min(max(-steep, low), high), min(max(steep, low), high)
    right_v, left_v = rnd(l3 * right_y, W), rnd(l3 * left_y, W)
    right_u = rnd(np.sqrt(max(rnd(limit - rnd(right_v * right_v, W), W), 0.0)), W)
    left_u = rnd(np.sqrt(max(rnd(limit - rnd(left_v * left_v, W), W), 0.0)), W)
    left = rnd(rnd(-left_u - rnd(l2 * left_y, W), W) / l1, W)
    return left, rnd(rnd(right_u - rnd(l2 * right_y, W), W) / l1, W)


@numba.njit(cache=True)
def _columns(mx, my, conic, limit, row, scene, W):
    """First and last tile column whose pixel centres the ellipse meets in tile row `row`; first > last: none."""
    if limit < 0:
        return 1, 0
    top, bottom = row * TILE + 0.5, min(row * TILE + TILE, scene.height) - 0.5
    left, right = _row_reach(
        conic[0], conic[1], conic[2], rnd(limit + REACH_MARGIN, W), top - my - EDGE_MARGIN, bottom - my + EDGE_MARGIN, W)
    first, last = np.ceil(mx + left - EDGE_MARGIN - 0.5), np.floor(mx + right + EDGE_MARGIN - 0.5)
    if left > right or first > scene.width - 1 or last < 0 or first > last:
        return 1, 0
    return int(max(first, 0.0)) // TILE, int(min(last, scene.width - 1.0)) // TILE


@numba.njit(cache=True)
def _visit(i, scene, k, tile_of, use_of):
    """Tiles of Gaussian `i` into tile_of and use_of; returns (passed, filtered)."""
    passed, filtered = 0, 0
    mx, my = scene.mean2d[i, 0] / k.mean_one, scene.mean2d[i, 1] / k.mean_one
    box, bound = scene.box[i], scene.bound[i]
    for row in range(box[2], box[3] + 1):
        known, first, last = -(1 << 30), 1, 0
        for column in range(box[0], box[1] + 1):
            tile = row * scene.tiles_x + column
            level = scene.header[tile, 0]
            next_too = scene.header[tile, 1] == 1 and bound >= level + 1
            strongest = scene.opacity[i, level]
            if next_too:
                strongest = max(strongest, scene.opacity[i, level + 1])
            if strongest != known:
                known = strongest
                if scene.obb:
                    first, last = box[0], box[1]
                else:
                    first, last = _columns(mx, my, scene.conic[i], falloff_limit(strongest, k), row, scene, k.to_work)
            if first <= column <= last:
                if bound >= level:
                    tile_of[passed], use_of[passed] = tile, 3 if next_too else 1
                    passed += 1
                else:
                    filtered += 1
    return passed, filtered


@numba.njit(cache=True, nogil=True)
def _count(part, begin, end, splats, scene, k, counts, filtered):
    tile_of, use_of = np.empty(len(scene.header), np.int32), np.empty(len(scene.header), np.uint8)
    for n in range(begin, end):
        passed, rejected = _visit(splats[n], scene, k, tile_of, use_of)
        filtered[part] += rejected
        for e in range(passed):
            counts[part, tile_of[e]] += 1


@numba.njit(cache=True, nogil=True)
def _scatter(part, begin, end, splats, scene, k, cursor, splat, use):
    tile_of, use_of = np.empty(len(scene.header), np.int32), np.empty(len(scene.header), np.uint8)
    for n in range(begin, end):
        passed, _ = _visit(splats[n], scene, k, tile_of, use_of)
        for e in range(passed):
            at = cursor[part, tile_of[e]]
            cursor[part, tile_of[e]] += 1
            splat[at], use[at] = splats[n], use_of[e]


def tile_entries(
    config: AcceleratorConfig, projected: Projected, opacity: np.ndarray, bound: np.ndarray, registers: FrameRegisters,
    splats: np.ndarray, *, obb: bool = False,
) -> TileEntries:
    """The entries of `splats` (int32 rows, any order), grouped by tile, keeping that order inside each tile.

    Args:
        config: the machine.
        projected: culling's result.
        opacity: (N, 4) raw `log2_opacity`.
        bound: (N,) quality bound m - 1.
        registers: the frame's.
        splats: visible rows in the order wanted: by index it is the unit's stream, by depth key the sorted lists.
        obb: the bounding box's tiles instead of the exact test.
    """
    k = culling_constants(config)
    tiles = len(registers.header)
    counts, filtered = np.zeros((SLICES, tiles), np.int64), np.zeros(SLICES, np.int64)
    scene = _Scene(projected.mean2d, projected.conic, projected.box, np.ascontiguousarray(opacity), np.ascontiguousarray(bound),
                   registers.header, registers.tiles_x, registers.width, registers.height, obb)
    for_slices(_count, len(splats), splats, scene, k, counts, filtered)
    total = counts.sum(axis=0)
    start = np.concatenate(([0], np.cumsum(total)))
    cursor = start[:-1] + np.concatenate((np.zeros((1, tiles), np.int64), np.cumsum(counts, axis=0)[:-1]))
    splat, use = np.empty(start[-1], np.int32), np.empty(start[-1], np.uint8)
    for_slices(_scatter, len(splats), splats, scene, k, cursor, splat, use)
    return TileEntries(start, splat, use, int(filtered.sum()))
