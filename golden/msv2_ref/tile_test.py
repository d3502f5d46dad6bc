"""Tile test: which tiles a projected splat touches, and which of these the foveation filter rejects.

Within one row of tiles, the ellipse's extent along x is an interval (the projection of a convex set). So the exact
ellipse-rectangle test costs two square roots for each row of tiles and gives a run of columns. Both ends are widened by the
margins of `spec.constants`, so that rounding never loses a tile in which a pixel would change. TILE_REACH_MARGIN on the limit
covers the rounding of the falloff. TILE_EDGE_MARGIN covers the rounding of lengths, which are rounded to the `view` format five
times, for edges up to 4,096 pixels.

Every `rnd` is one operation of the unit. Everything between is exact fixed-point arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden.host.registers import FrameRegisters
from golden.host.rounding import operation, rnd
from golden.kernels import compiled
from golden.msv2_ref.projection import Projected, culling_constants, falloff_limit
from golden.threads import SLICES, for_slices
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, TILE, TILE_EDGE_MARGIN, TILE_REACH_MARGIN
from spec.records import intersection_item, opacities_carried, surviving_splat


class Intersections(NamedTuple):
    """Intersections grouped by tile; within a tile they are in the order of the splat list.

    Attributes:
        start: (tiles + 1,) int64, first intersection of each tile.
        splat: (E,) int32, row of each intersection's Gaussian.
        use: (E,) uint8, bit 0: the tile's level uses the splat (always 1); bit 1: a blend tile's next level does.
        filtered: number of (splat, tile) pairs that touch but that the foveation filter rejects, or whose tile is not rendered.
    """

    start: np.ndarray
    splat: np.ndarray
    use: np.ndarray
    filtered: int


class _Scene(NamedTuple):
    """What the tile test reads of the splats and the frame. `plain` says that all tiles have level 1 and are rendered, and
    none blends."""

    mean2d: np.ndarray
    conic: np.ndarray
    box: np.ndarray
    opacity: np.ndarray
    bound: np.ndarray
    header: np.ndarray
    rendered: np.ndarray
    tiles_x: int
    width: int
    height: int
    obb: bool
    plain: bool

    @classmethod
    def of(cls, *fields: object) -> _Scene:
        """Makes a scene from all other fields and computes `plain`."""
        scene = cls(*fields, False)
        return scene._replace(plain=bool(scene.rendered.all()) and not scene.header[:, :2].any())


# A run is a part of a tile row, within a Gaussian's box, whose tiles all use the Gaussian with the same opacity. Runs are
# handled in blocks, one run in each column: `block` holds the inputs of the ellipse test and the tile columns that it finds,
# and `runs` (4, _BLOCK) says where each run is.
_BLOCK = 64
_BLOCK_ROWS = 9
_MX, _MY, _L1, _L2, _L3, _LIMIT, _ROW, _FIRST, _LAST = range(0, _BLOCK_ROWS * _BLOCK, _BLOCK)
_SPLAT, _TILES, _BEGIN, _END = range(4)  # the Gaussian, the first tile of the tile row, first and last column


@operation
def _shape(l1, l2, l3, k):
    """Three numbers of the ellipse u^2 + v^2 <= limit.

    They are 1 / l1, and, as factors of sqrt(limit), its half extent along y and the y of its leftmost point.
    """
    W = k.to_work
    hypotenuse = rnd(rnd(l2 * l2, W) + rnd(l3 * l3, W), W)
    turn = rnd(l2 * rnd(1.0 / np.sqrt(hypotenuse), W), W)
    rise = rnd(1.0 / l3, k.to_view)
    return rnd(1.0 / l1, k.to_view), rise, rnd(turn * rise, W)


@operation
def _reach(y, narrow, l2, l3, limit, k):
    """How far the ellipse reaches to the left at height y, and by symmetry to the right at -y, in ulps of `mean2d`."""
    W, V = k.to_work, k.to_view
    v = rnd(l3 * y, W)
    u = rnd(np.sqrt(max(rnd(limit - rnd(v * v, W), W), 0.0)), W)
    reach = rnd(rnd(u + rnd(l2 * y, V), V) * narrow, V)
    return min(max(np.floor(reach * k.mean_one + 0.5), 2 * k.mean_min), 2 * k.mean_max + 1)  # one bit more than `mean2d`


@compiled(inline="always", error_model="numpy")
def _span(mx, my, l1, l2, l3, limit, row, width, height, k):
    """The first and last column of pixels (float64) whose centres the ellipse meets in a tile row, whether it meets none, and
    how far it reaches along y in the `view` format. Both lengths and positions are in ulps of `mean2d`; `limit` is without its
    margin."""
    W, V, one, margin, half = k.to_work, k.to_view, k.mean_one, TILE_EDGE_MARGIN * k.mean_one, 0.5 * k.mean_one
    right_edge, raised = width - 1.0, rnd(max(limit, 0.0) + TILE_REACH_MARGIN, W)
    narrow, rise, slant = _shape(l1, l2, l3, k)
    root = rnd(np.sqrt(raised), W)
    rim, steep = rnd(root * rise, V), rnd(root * slant, V)
    top, bottom = row * TILE, min(row * TILE + TILE, height)
    low = max(rnd((top * one + half - my - margin) / one, V), -rim)
    high = min(rnd((bottom * one - half - my + margin) / one, V), rim)
    left = _reach(min(max(steep, low), high), narrow, l2, l3, raised, k)
    right = _reach(min(max(steep, -high), -low), narrow, l2, l3, raised, k)
    first, last = np.ceil((mx - left - margin - half) / one), np.floor((mx + right + margin - half) / one)
    none = (limit < 0) | (low > high) | (first > last) | (first > right_edge) | (last < 0)
    return max(first, 0.0), min(last, right_edge), none, rim


@compiled(error_model="numpy")
def _columns(block, scene, k):
    """For each run of a block, the first and last tile column whose pixel centres the ellipse meets; 1, 0 if there is none.

    One array and no branches, so that LLVM vectorises the loop. Integers (ulps of `mean2d`) are held in float64.
    """
    width, height = float(scene.width), float(scene.height)
    for j in range(_BLOCK):
        first, last, none, _ = _span(
            block[_MX + j], block[_MY + j], block[_L1 + j], block[_L2 + j], block[_L3 + j], block[_LIMIT + j], block[_ROW + j],
            width, height, k)
        block[_FIRST + j] = 1.0 if none else np.floor(first / TILE)
        block[_LAST + j] = 0.0 if none else np.floor(last / TILE)


# The arrays are taken out of `scene` before the loops, because inside a loop numba would count references to them.
@compiled
def _emit(part, count, block, runs, scene, k, at, tile_of, splat_of, use_of, counts, filtered):
    """Writes the intersections of `count` runs from position `at` on and returns the position after them."""
    header, bound, rendered, obb = scene.header, scene.bound, scene.rendered, scene.obb
    if not obb:
        _columns(block, scene, k)
    for n in range(count):
        i, first, last = runs[_SPLAT, n], runs[_BEGIN, n], runs[_END, n]
        if not obb:
            first, last = max(first, int(block[_FIRST + n])), min(last, int(block[_LAST + n]))
        if scene.plain:
            for tile in range(runs[_TILES, n] + first, runs[_TILES, n] + last + 1):
                tile_of[at], splat_of[at], use_of[at] = tile, i, 1
                counts[part, tile] += 1
                at += 1
            continue
        for tile in range(runs[_TILES, n] + first, runs[_TILES, n] + last + 1):
            level = header[tile, 0]
            if rendered[tile] and bound[i] >= level:
                next_too = header[tile, 1] == 1 and bound[i] >= level + 1
                tile_of[at], splat_of[at], use_of[at] = tile, i, 3 if next_too else 1
                counts[part, tile] += 1
                at += 1
            else:
                filtered[part] += 1
    return at


@compiled(nogil=True, error_model="numpy")
def _visit(part, begin, end, splats, room, scene, k, tile_of, splat_of, use_of, counts, passed, filtered):
    """Writes the intersections of a slice of the splats, in the splats' order, from `room[begin]` on."""
    header, opacity, bound, box, mean2d, conic = scene.header, scene.opacity, scene.bound, scene.box, scene.mean2d, scene.conic
    block, runs = np.ones(_BLOCK_ROWS * _BLOCK), np.empty((4, _BLOCK), np.int64)
    at, count = room[begin], 0
    for n in range(begin, end):
        i = splats[n]
        mx, my = float(mean2d[i, 0]), float(mean2d[i, 1])
        for row in range(box[i, 2], box[i, 3] + 1):
            known = -(1 << 30)
            first, last = box[i, 0], box[i, 1]
            for column in range(first, min(first, last) + 1 if scene.plain else last + 1):
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
                runs[_BEGIN, count], runs[_END, count] = column, last if scene.plain else column
                block[_MX + count], block[_MY + count], block[_ROW + count] = mx, my, row
                block[_L1 + count], block[_L2 + count], block[_L3 + count] = conic[i, 0], conic[i, 1], conic[i, 2]
                block[_LIMIT + count] = falloff_limit(strongest, k)
                count += 1
    passed[part] = _emit(part, count, block, runs, scene, k, at, tile_of, splat_of, use_of, counts, filtered) - room[begin]


@compiled(nogil=True)
def _scatter(part, begin, _end, room, passed, tile_of, splat_of, use_of, cursor, splat, use):
    """Moves a slice's intersections to their tiles' places; its cursors start where those of the slices before it end."""
    for e in range(room[begin], room[begin] + passed[part]):
        at = cursor[part, tile_of[e]]
        cursor[part, tile_of[e]] += 1
        splat[at], use[at] = splat_of[e], use_of[e]


def _entries(config: AcceleratorConfig, scene: _Scene, splats: np.ndarray) -> Intersections:
    """The intersections of `splats`, int32 rows of the scene in any order, grouped by tile; within a tile they keep that
    order."""
    k, tiles = culling_constants(config), len(scene.header)
    counts = np.zeros((SLICES, tiles), np.int64)
    passed, filtered = np.zeros(SLICES, np.int64), np.zeros(SLICES, np.int64)
    box = scene.box[splats].astype(np.int64)
    room = np.concatenate(([0], np.cumsum((box[:, 1] - box[:, 0] + 1) * (box[:, 3] - box[:, 2] + 1))))
    found = np.empty(room[-1], np.int32), np.empty(room[-1], np.int32), np.empty(room[-1], np.uint8)
    for_slices(_visit, len(splats), splats, room, scene, k, *found, counts, passed, filtered)
    total = counts.sum(axis=0)
    start = np.concatenate(([0], np.cumsum(total)))
    cursor = start[:-1] + np.concatenate((np.zeros((1, tiles), np.int64), np.cumsum(counts, axis=0)[:-1]))
    splat, use = np.empty(start[-1], np.int32), np.empty(start[-1], np.uint8)
    for_slices(_scatter, len(splats), room, passed, *found, cursor, splat, use)
    return Intersections(start, splat, use, int(filtered.sum()))


def tested_opacity(config: AcceleratorConfig, opacity: np.ndarray, strongest: np.ndarray) -> np.ndarray:
    """(N, 4) raw `log2_opacity` by which the tile test judges a splat in tiles of each level.

    Args:
        config: the machine.
        opacity: (N, 4) opacities by level.
        strongest: (N,) the largest among the levels that use the Gaussian, which in some machines is all that is known here.
    """
    if opacities_carried(config) > 1:
        return opacity
    return np.repeat(strongest[:, None], MAX_LEVELS, axis=1).astype(np.int16)


def tile_intersections(
    config: AcceleratorConfig, projected: Projected, opacity: np.ndarray, bound: np.ndarray, registers: FrameRegisters,
    splats: np.ndarray, *, obb: bool = False, rendered: np.ndarray | None = None,
) -> Intersections:
    """The intersections of `splats` (int32 rows in any order), grouped by tile; within a tile they keep that order.

    Args:
        config: the machine.
        projected: the projection's result.
        opacity: (N, 4) raw `log2_opacity`, as `tested_opacity` gives them.
        bound: (N,) quality bound m - 1.
        registers: the frame's registers.
        splats: rows of the visible splats in the wanted order: by index for the unit's stream, by depth key for sorted lists.
        obb: take all tiles of the bounding box instead of testing them exactly.
        rendered: (tiles,) bool: intersections with other tiles are dropped; None: all tiles are rendered.
    """
    rendered = np.ones(len(registers.header), bool) if rendered is None else rendered
    return _entries(config, _Scene.of(
        projected.mean2d, projected.conic, projected.box, np.ascontiguousarray(opacity), np.ascontiguousarray(bound),
        registers.header, rendered, registers.tiles_x, registers.width, registers.height, obb), splats)


class TileTest(NamedTuple):
    """A frame through the tile test unit: its streams, including `end`, and its counts of (splat, tile) pairs.

    Attributes:
        entries: IntersectionItem records, one for each intersection: splat by splat in their order, then by tile row, then by
            column.
        survivors: SurvivingSplat records of the splats with an intersection, in their order.
        touched: number of pairs that touch.
        filtered: number of these that the foveation filter rejects, or whose tile is not rendered; the others are `entries`.
    """

    entries: np.ndarray
    survivors: np.ndarray
    touched: int
    filtered: int


def tile_test(
    config: AcceleratorConfig, splats: np.ndarray, levels: np.ndarray, width: int, height: int, *, obb: bool = False,
    rendered: np.ndarray | None = None,
) -> TileTest:
    """The output of the unit for a frame.

    Args:
        config: the machine.
        splats: (N,) ProjectedSplat records without the `end`.
        levels: (tiles, 2) level and blend flag of each tile, row-major.
        width, height: size of the frame in pixels.
        obb: take all tiles of the bounding box instead of testing them exactly.
        rendered: (tiles,) bool: intersections with other tiles are dropped; None: all tiles are rendered.
    """
    rendered = np.ones(len(levels), bool) if rendered is None else rendered
    box = np.stack([splats[name] for name in ("first_x", "last_x", "first_y", "last_y")], 1)
    mean2d, bound = (np.ascontiguousarray(splats[name]) for name in ("mean2d", "bound"))
    opacity = np.ascontiguousarray(np.broadcast_to(
        splats["log2_opacity"].reshape(len(splats), opacities_carried(config)), (len(splats), MAX_LEVELS)))
    scene = _Scene.of(mean2d, config.formats.conic.to_float(splats["conic"]), box, opacity, bound,
                   np.ascontiguousarray(levels, np.int64), rendered, -(-width // TILE), width, height, obb)
    found = _entries(config, scene, np.arange(len(splats), dtype=np.int32))
    tile = np.repeat(np.arange(len(levels)), np.diff(found.start))
    order = np.lexsort((tile, found.splat))
    row, tile = found.splat[order], tile[order]

    entries = np.zeros(len(row) + 1, intersection_item(config).dtype)
    entries["tile"][:-1], entries["end"][-1] = tile, 1
    for name in ("index", "depth_key"):
        entries[name][:-1] = splats[name][row]
    mask = np.zeros(len(splats), np.int64)
    np.bitwise_or.at(mask, row, 1 << scene.header[tile, 0])
    kept = np.flatnonzero(mask)
    survivors = np.zeros(len(kept) + 1, surviving_splat(config).dtype)
    for name in set(splats.dtype.names) & set(survivors.dtype.names) - {"end"}:
        survivors[name][:-1] = splats[name][kept]
    survivors["levels"][:-1], survivors["end"][-1] = mask[kept], 1
    return TileTest(entries, survivors, len(row) + found.filtered, found.filtered)
