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
from golden.msv2_ref.rounding import operation, rnd
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


@operation
def _rim(conic, limit, W):
    """Of the ellipse u^2 + v^2 <= limit: its reach along y, and where its leftmost point lies (its rightmost at minus that)."""
    l2, l3 = conic[1], conic[2]
    root = rnd(np.sqrt(limit), W)
    steep = rnd(rnd(l2 * root, W) / rnd(l3 * rnd(np.sqrt(rnd(rnd(l2 * l2, W) + rnd(l3 * l3, W), W)), W), W), W)
    return rnd(root / l3, W), steep


@operation
def _reach(y, sign, conic, limit, W):
    """The ellipse's reach along x at height y, to the left (sign -1) or to the right (1)."""
    v = rnd(conic[2] * y, W)
    u = rnd(np.sqrt(max(rnd(limit - rnd(v * v, W), W), 0.0)), W)
    return rnd(rnd(sign * u - rnd(conic[1] * y, W), W) / conic[0], W)


@operation
def _columns(mx, my, conic, limit, rim, steep, row, scene, W):
    """First and last tile column whose pixel centres the ellipse meets in tile row `row`; first > last: none."""
    top, bottom = row * TILE + 0.5, min(row * TILE + TILE, scene.height) - 0.5
    low, high = max(top - my - EDGE_MARGIN, -rim), min(bottom - my + EDGE_MARGIN, rim)
    if low > high:
        return 1, 0
    left = _reach(min(max(steep, low), high), -1.0, conic, limit, W)
    right = _reach(min(max(-steep, low), high), 1.0, conic, limit, W)
    first, last = np.ceil(mx + left - EDGE_MARGIN - 0.5), np.floor(mx + right + EDGE_MARGIN - 0.5)
    if left > right or first > scene.width - 1 or last < 0 or first > last:
        return 1, 0
    return int(max(first, 0.0)) // TILE, int(min(last, scene.width - 1.0)) // TILE


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _visit(part, begin, end, splats, room, scene, k, tile_of, splat_of, use_of, counts, passed, filtered):
    """Entries of a slice of the splats, in their order, from `room[begin]` on."""
    W, at = k.to_work, room[begin]
    for n in range(begin, end):
        i = splats[n]
        mx, my = scene.mean2d[i, 0] / k.mean_one, scene.mean2d[i, 1] / k.mean_one
        conic = (scene.conic[i, 0], scene.conic[i, 1], scene.conic[i, 2])
        bound, known = scene.bound[i], -(1 << 30)
        x0, x1, y0, y1 = scene.box[i]
        limit, rim, steep = -1.0, 0.0, 0.0
        for row in range(y0, y1 + 1):
            fresh, first, last = False, 1, 0
            for column in range(x0, x1 + 1):
                tile = row * scene.tiles_x + column
                level = scene.header[tile, 0]
                next_too = scene.header[tile, 1] == 1 and bound >= level + 1
                strongest = scene.opacity[i, level]
                if next_too:
                    strongest = max(strongest, scene.opacity[i, level + 1])
                if strongest != known:
                    known, fresh, limit = strongest, False, falloff_limit(strongest, k)
                    if limit >= 0:
                        limit = rnd(limit + REACH_MARGIN, W)
                        rim, steep = _rim(conic, limit, W)
                if not fresh:
                    fresh, first, last = True, 1, 0
                    if scene.obb:
                        first, last = x0, x1
                    elif limit >= 0:
                        first, last = _columns(mx, my, conic, limit, rim, steep, row, scene, W)
                if first <= column <= last:
                    if bound >= level:
                        tile_of[at], splat_of[at], use_of[at] = tile, i, 3 if next_too else 1
                        counts[part, tile] += 1
                        at += 1
                    else:
                        filtered[part] += 1
    passed[part] = at - room[begin]


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
