"""Decides which splats each tile renders, and in which order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from golden.kernels import compiled
from golden.oracle.ellipse import box_meets, ellipse_meets
from golden.oracle.project import Splats
from golden.scenes.gaze import FoveationMap

TILE_TESTS = ("exact", "obb")


@dataclass(frozen=True)
class TileLists:
    """The splats of each tile, front to back: tile t (row-major) renders entries[start[t]:start[t + 1]].

    Attributes:
        start: (tiles + 1,) int64.
        entries: (E,) int64, one for each of E intersections: positions in `Splats`, sorted by (tile, depth, Gaussian index).
    """

    start: np.ndarray
    entries: np.ndarray


def tile_lists(splats: Splats, foveation: FoveationMap, tile_test: str = "exact") -> TileLists:
    """Lists every intersection, that is every (splat, tile) pair in which a pixel might change (paper section 6.2).

    A pair is an intersection if the tile's level is within the splat's quality bound, and the splat's footprint meets the
    closed rectangle of those of the tile's pixel centres that lie in the frame. The footprint is that of the largest opacity
    among the levels that the tile renders and the bound allows.

    Args:
        splats: the projected splats.
        foveation: level and blend flag of each tile.
        tile_test: `exact`, or `obb` for the footprint's oriented bounding box.

    Raises:
        ValueError: the test is neither.
    """
    if tile_test not in TILE_TESTS:
        raise ValueError(f"tile_test must be one of {TILE_TESTS}, not {tile_test!r}")
    order = np.lexsort((splats.index, splats.depth))
    display = foveation.display
    scene = (
        order, splats.mean2d, splats.cov2d, splats.factor, splats.q_max, foveation.tile_level, foveation.blend,
        foveation.tile, display.width_px, display.height_px, tile_test == "exact",
    )
    counts = np.zeros(foveation.tile_level.size, np.int64)
    _visit(*scene, counts, np.empty(0, np.int64))
    start = np.concatenate([[0], np.cumsum(counts)])
    entries = np.empty(start[-1], np.int64)
    _visit(*scene, start[:-1].copy(), entries)
    return TileLists(start, entries)


@compiled
def _visit(
    order, mean2d, cov2d, factor, q_max, tile_level, blend, tile, width, height, exact, slot, entries
) -> None:
    """Advances slot[tile] for every intersection, in depth order; writes the splat there unless `entries` is empty."""
    tiles_y, tiles_x = tile_level.shape
    for i in order:
        x, y = mean2d[i]
        widest = math.sqrt(2 * q_max[i].max())
        first_x, last_x = _tile_range(x, widest * math.sqrt(cov2d[i, 0]), tile, tiles_x)
        first_y, last_y = _tile_range(y, widest * math.sqrt(cov2d[i, 2]), tile, tiles_y)
        for ty in range(first_y, last_y + 1):
            y0, y1 = ty * tile + 0.5 - y, min((ty + 1) * tile, height) - 0.5 - y
            for tx in range(first_x, last_x + 1):
                level = tile_level[ty, tx]
                bound = q_max[i, level]
                if blend[ty, tx]:
                    bound = max(bound, q_max[i, level + 1])
                if bound < 0:  # the splat is beyond its quality bound or transparent at the tile's levels
                    continue
                x0, x1 = tx * tile + 0.5 - x, min((tx + 1) * tile, width) - 0.5 - x
                if exact:
                    meets = ellipse_meets(x0, y0, x1, y1, factor[i], bound)
                else:
                    meets = box_meets(x0, y0, x1, y1, cov2d[i], factor[i], bound)
                if meets:
                    t = ty * tiles_x + tx
                    if len(entries):
                        entries[slot[t]] = i
                    slot[t] += 1


@compiled
def _tile_range(centre: float, reach: float, tile: int, count: int) -> tuple[int, int]:
    """First and last tile along one axis that [centre - reach, centre + reach] overlaps, clipped to the frame."""
    first = math.floor(max((centre - reach) / tile, 0.0))
    last = math.floor(min((centre + reach) / tile, count - 1.0))
    return first, last
