"""Warps a frame into the other eye's, in float64: the definition, pixel by pixel.

It is independent of the integer renderer: depth and coverage are real numbers, and nothing is rounded before a pixel's target
column is. It is written to be read; a frame of 640x360 takes some seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spec.constants import COVERAGE_VALID, COVERAGE_VISIBLE, TILE
from spec.stereo import FILL_NEIGHBOURS

HOLE, WARPED, BACKGROUND, FILLED = range(4)
"""The values of `OracleWarp.origin`: where a pixel of the target comes from."""


@dataclass(frozen=True)
class OracleWarp:
    """A frame that was warped into the other eye.

    Attributes:
        image: (H, W, 3) float64, the target eye's image; 0 in holes.
        origin: (H, W) uint8: HOLE, WARPED, BACKGROUND or FILLED.
        source_x: (H, W) int64: column of the source pixel that is seen here; -1 in holes and filled holes.
        disparity: (H, W) float64, signed disparity of each source pixel in pixels; NaN where the pixel is not warped, 0 in the
            background.
        tiles: (tiles_y, tiles_x) bool: whether a hole is left in this tile of the target, so that it must be rendered.
    """

    image: np.ndarray
    origin: np.ndarray
    source_x: np.ndarray
    disparity: np.ndarray
    tiles: np.ndarray


def signed_disparity(
    depth: np.ndarray, coverage: np.ndarray, baseline_px: float, sign: int, veiled: bool = False,
) -> np.ndarray:
    """(H, W) float64: the number of columns by which each pixel moves to the right.

    Args:
        depth: (H, W) z in world units.
        coverage: (H, W) accumulated alpha. A pixel below 1/255 is background and gets 0. A pixel below 1/2 has no depth and
            gets NaN.
        baseline_px: distance between the eyes in world units, times the focal length in pixels.
        sign: -1 where the source is the left eye, +1 where it is the right.
        veiled: pixels with a coverage below 1/2 have a depth too.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = sign * baseline_px / depth
    return np.where(coverage < COVERAGE_VISIBLE, 0.0, np.where(veiled | (coverage >= COVERAGE_VALID), moved, np.nan))


def warp(
    image: np.ndarray, depth: np.ndarray, coverage: np.ndarray, baseline_px: float, sign: int, *, veiled: bool = False,
    majority: bool = True, reach: float = math.inf,
) -> OracleWarp:
    """The target eye's frame, with its holes filled where the rules allow it, and the tiles in which holes are left.

    Args:
        image: (H, W, 3) float64 of the source eye.
        depth, coverage, baseline_px, sign, veiled: see `signed_disparity`.
        majority: a hole is filled if more than half of its neighbours in strip and frame are valid; without it, if five are.
        reach: largest number of columns by which a pixel may move; pixels that would move farther are dropped.
    """
    height, width = coverage.shape
    disparity = signed_disparity(depth, coverage, baseline_px, sign, veiled)
    warped = np.zeros((height, width, 3))
    origin = np.full((height, width), HOLE, np.uint8)
    source_x = np.full((height, width), -1)
    for y in range(height):
        nearest = [-math.inf] * width  # the row depth buffer: background has less disparity than anything
        for x in range(width):
            if math.isnan(disparity[y, x]):
                continue
            background = coverage[y, x] < COVERAGE_VISIBLE
            moved = x + disparity[y, x] + 0.5
            if not 0 <= moved < width or abs(math.floor(moved) - x) > reach:  # also true for infinite disparities
                continue
            to, closeness = math.floor(moved), -1.0 if background else abs(disparity[y, x])
            if closeness > nearest[to]:  # at equal depth the lower x wins, which came first
                nearest[to] = closeness
                warped[y, to], source_x[y, to] = image[y, x], x
                origin[y, to] = BACKGROUND if background else WARPED
    filled = _fill(warped, origin, majority)
    tiles = np.zeros((-(-height // TILE), -(-width // TILE)), bool)
    for y, x in np.argwhere(origin == HOLE):
        tiles[y // TILE, x // TILE] = True
    return OracleWarp(filled, origin, source_x, disparity, tiles)


def _fill(warped: np.ndarray, origin: np.ndarray, majority: bool) -> np.ndarray:
    """Fills each hole that has enough valid neighbours in its strip with their median; marks these pixels in `origin`."""
    height, width = origin.shape
    filled, holes = warped.copy(), origin == HOLE
    for y, x in np.argwhere(holes):
        strip = y // TILE * TILE
        near = [(row, column) for row in range(max(y - 1, strip), min(y + 2, strip + TILE, height))
                for column in range(max(x - 1, 0), min(x + 2, width)) if (row, column) != (y, x)]
        around = [warped[at] for at in near if not holes[at]]
        needed = len(near) // 2 + 1 if majority else FILL_NEIGHBOURS
        if len(around) >= needed:
            filled[y, x] = np.sort(around, axis=0)[(len(around) - 1) // 2]  # the lower middle of an even number
            origin[y, x] = FILLED
    return filled
