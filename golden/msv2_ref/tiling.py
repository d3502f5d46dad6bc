"""The culling unit's last step: which tiles a projected Gaussian touches, and the foveation filter.

For one row of tiles the ellipse's reach along x is an interval (the projection of a convex set), so the exact
ellipse-rectangle test costs two square roots a row and yields a run of columns. Both ends are widened by the margins of
`spec.constants`, so that rounding never loses a tile in which a pixel would change.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from golden.msv2_ref.culling import Projected, culling_constants, falloff_limit
from golden.msv2_ref.parallel import SLICES, for_slices
from golden.msv2_ref.registers import FrameRegisters
from golden.msv2_ref.rounding import operation, rnd
from spec.config import AcceleratorConfig
from spec.constants import TILE, TILE_EDGE_MARGIN, TILE_REACH_MARGIN


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


# A run is the stretch of a tile row, within a Gaussian's box, in which the tiles see it with one opacity. Runs go in blocks,
# one a column: `block` holds what the ellipse test reads and the tile columns it finds, `runs` (4, _BLOCK) where the run is.
_BLOCK = 64
_BLOCK_ROWS = 9
_MX, _MY, _L1, _L2, _L3, _LIMIT, _ROW, _FIRST, _LAST = range(0, _BLOCK_ROWS * _BLOCK, _BLOCK)
_SPLAT, _TILES, _BEGIN, _END = range(4)  # the Gaussian, the first tile of the tile row, first and last column


@operation
def _rim(l2, l3, limit, W):
    """Of the ellipse u^2 + v^2 <= limit: its reach along y, and where its leftmost point lies (its rightmost at minus that)."""
    root = rnd(np.sqrt(limit), W)
    steep = rnd(rnd(l2 * root, W) / rnd(l3 * rnd(np.sqrt(rnd(rnd(l2 * l2, W) + rnd(l3 * l3, W), W)), W), W), W)
    return rnd(root / l3, W), steep


@operation
def _reach(y, sign, l1, l2, l3, limit, W):
    """The ellipse's reach along x at height y, to the left (sign -1) or to the right (1)."""
    v = rnd(l3 * y, W)
    u = rnd(np.sqrt(max(rnd(limit - rnd(v * v, W), W), 0.0)), W)
    return rnd(rnd(sign * u - rnd(l2 * y, W), W) / l1, W)


@numba.njit(cache=True, error_model="numpy")
def _columns(block, scene, k):
    """First and last tile column whose pixel centres the ellipse meets in its tile row, for a whole block; 1, 0: none.

    One array and no branches, so that LLVM makes it vectors.
    """
    W, right_edge, height = k.to_work, scene.width - 1.0, float(scene.height)
    for j in range(_BLOCK):
        mx, my, l1, l2, l3 = block[_MX + j], block[_MY + j], block[_L1 + j], block[_L2 + j], block[_L3 + j]
        limit = rnd(max(block[_LIMIT + j], 0.0) + TILE_REACH_MARGIN, W)
        rim, steep = _rim(l2, l3, limit, W)
        top, bottom = block[_ROW + j] * TILE + 0.5, min(block[_ROW + j] * TILE + TILE, height) - 0.5
        low, high = max(top - my - TILE_EDGE_MARGIN, -rim), min(bottom - my + TILE_EDGE_MARGIN, rim)
        left = _reach(min(max(steep, low), high), -1.0, l1, l2, l3, limit, W)
        right = _reach(min(max(-steep, low), high), 1.0, l1, l2, l3, limit, W)
        first, last = np.ceil(mx + left - TILE_EDGE_MARGIN - 0.5), np.floor(mx + right + TILE_EDGE_MARGIN - 0.5)
        none = (block[_LIMIT + j] < 0) | (low > high) | (left > right) | (first > last) | (first > right_edge) | (last < 0)
        block[_FIRST + j] = 1.0 if none else np.floor(max(first, 0.0) / TILE)
        block[_LAST + j] = 0.0 if none else np.floor(min(last, right_edge) / TILE)


# The arrays are taken out of `scene` outside the loops: within, numba would count references to them.
@numba.njit(cache=True)
def _emit(part, count, block, runs, scene, k, at, tile_of, splat_of, use_of, counts, filtered):
    """The entries of `count` runs, from `at` on; gives the place after them."""
    header, bound, obb = scene.header, scene.bound, scene.obb
    if not obb:
        _columns(block, scene, k)
    for n in range(count):
        i, first, last = runs[_SPLAT, n], runs[_BEGIN, n], runs[_END, n]
        if not obb:
            first, last = max(first, int(block[_FIRST + n])), min(last, int(block[_LAST + n]))
        for tile in range(runs[_TILES, n] + first, runs[_TILES, n] + last + 1):
            level = header[tile, 0]
            if bound[i] >= level:
                next_too = header[tile, 1] == 1 and bound[i] >= level + 1
                tile_of[at], splat_of[at], use_of[at] = tile, i, 3 if next_too else 1
                counts[part, tile] += 1
                at += 1
            else:
                filtered[part] += 1
    return at


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _visit(part, begin, end, splats, room, scene, k, tile_of, splat_of, use_of, counts, passed, filtered):
    """Entries of a slice of the splats, in their order, from `room[begin]` on."""
    header, opacity, bound, box, mean2d, conic = scene.header, scene.opacity, scene.bound, scene.box, scene.mean2d, scene.conic
    block, runs = np.ones(_BLOCK_ROWS * _BLOCK), np.empty((4, _BLOCK), np.int64)
    at, count = room[begin], 0
    for n in range(begin, end):
        i = splats[n]
        mx, my = mean2d[i, 0] / k.mean_one, mean2d[i, 1] / k.mean_one
        for row in range(box[i, 2], box[i, 3] + 1):
            known = -(1 << 30)
            for column in range(box[i, 0], box[i, 1] + 1):
                tile = row * scene.tiles_x + column
                level = header[tile, 0]
                strongest = opacity[i, level]
                if header[tile, 1] == 1 and bound[i] >= level + 1:
                    strongest = max(strongest, opacity[i, level + 1])
                if strongest == known:
                    runs[_END, count - 1] = column
                    continue
                if count == _BLOCK:
                    at = _emit(part, count, block, runs, scene, k, at, tile_of, splat_of, use_of, counts, filtered)
                    count = 0
                known = strongest
                runs[_SPLAT, count], runs[_TILES, count] = i, tile - column
                runs[_BEGIN, count] = runs[_END, count] = column
                block[_MX + count], block[_MY + count], block[_ROW + count] = mx, my, row
                block[_L1 + count], block[_L2 + count], block[_L3 + count] = conic[i, 0], conic[i, 1], conic[i, 2]
                block[_LIMIT + count] = falloff_limit(strongest, k)
                count += 1
    passed[part] = _emit(part, count, block, runs, scene, k, at, tile_of, splat_of, use_of, counts, filtered) - room[begin]


@numba.njit(cache=True, nogil=True)
def _scatter(part, begin, _end, room, passed, tile_of, splat_of, use_of, cursor, splat, use):
    """The slice's entries to their tiles' places; a slice's cursors follow those of the slices before it."""
    for e in range(room[begin], room[begin] + passed[part]):
        at = cursor[part, tile_of[e]]
        cursor[part, tile_of[e]] += 1
        splat[at], use[at] = splat_of[e], use_of[e]


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
    counts = np.zeros((SLICES, tiles), np.int64)
    passed, filtered = np.zeros(SLICES, np.int64), np.zeros(SLICES, np.int64)
    scene = _Scene(projected.mean2d, projected.conic, projected.box, np.ascontiguousarray(opacity), np.ascontiguousarray(bound),
                   registers.header, registers.tiles_x, registers.width, registers.height, obb)
    box = projected.box[splats].astype(np.int64)
    room = np.concatenate(([0], np.cumsum((box[:, 1] - box[:, 0] + 1) * (box[:, 3] - box[:, 2] + 1))))
    found = np.empty(room[-1], np.int32), np.empty(room[-1], np.int32), np.empty(room[-1], np.uint8)
    for_slices(_visit, len(splats), splats, room, scene, k, *found, counts, passed, filtered)
    total = counts.sum(axis=0)
    start = np.concatenate(([0], np.cumsum(total)))
    cursor = start[:-1] + np.concatenate((np.zeros((1, tiles), np.int64), np.cumsum(counts, axis=0)[:-1]))
    splat, use = np.empty(start[-1], np.int32), np.empty(start[-1], np.uint8)
    for_slices(_scatter, len(splats), room, passed, *found, cursor, splat, use)
    return TileEntries(start, splat, use, int(filtered.sum()))
