"""Warping a frame into the other eye's, in float64: the definition, pixel by pixel.

Independent of the integer renderer: depth and coverage come as real numbers, disparities are never rounded before the
column is. Written to be read; a frame of 640x360 takes some seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spec.constants import COVERAGE_VALID, COVERAGE_VISIBLE, TILE
from spec.stereo import FILL_NEIGHBOURS

HOLE, WARPED, BACKGROUND, FILLED = range(4)
"""Where a pixel of the target comes from."""


@dataclass(frozen=True)
class OracleWarp:
    """A frame warped into the other eye's.

    Attributes:
        image: (H, W, 3) float64 of the target, 0 in holes.
        origin: (H, W) uint8: HOLE, WARPED, BACKGROUND or FILLED.
        source_x: (H, W) int64: column of the source pixel that is seen here; -1 in holes and where filled.
        disparity: (H, W) float64 of the source: signed, in pixels; NaN where a pixel is not warped, 0 in the background.
        tiles: (tiles_y, tiles_x) bool of the target: a hole is left, so the tile must be rendered.
    """

    image: np.ndarray
    origin: np.ndarray
    source_x: np.ndarray
    disparity: np.ndarray
    tiles: np.ndarray


def signed_disparity(
    depth: np.ndarray, coverage: np.ndarray, baseline_px: float, sign: int, veiled: bool = False,
) -> np.ndarray:
    """(H, W) float64: how far each pixel moves to the right.

    Args:
        depth: (H, W) z in world units.
        coverage: (H, W) accumulated alpha. Below 1/255 a pixel is background and stays; below 1/2 it has no depth: NaN.
        baseline_px: distance between the eyes, world units, times the focal length in pixels.
        sign: -1 where the source is the left eye, +1 where it is the right.
        veiled: pixels of a coverage below 1/2 have a depth too.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = sign * baseline_px / depth
    return np.where(coverage < COVERAGE_VISIBLE, 0.0, np.where(veiled | (coverage >= COVERAGE_VALID), moved, np.nan))


def warp(
    image: np.ndarray, depth: np.ndarray, coverage: np.ndarray, baseline_px: float, sign: int, *, veiled: bool = False,
    majority: bool = True, reach: float = math.inf,
) -> OracleWarp:
    """The target eye's frame, its holes filled as far as they may be, and the tiles in which some are left.

    Args:
        image: (H, W, 3) float64 of the source eye.
        depth, coverage, baseline_px, sign, veiled: see `signed_disparity`.
        majority: a hole is filled where more than half of its neighbours in strip and frame are warped; else where five are.
        reach: most columns that a pixel moves by; those that would move further are dropped.
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
            if not 0 <= moved < width or abs(math.floor(moved) - x) > reach:  # infinite disparities too
                continue
            to, closeness = math.floor(moved), -1.0 if background else abs(disparity[y, x])
            if closeness > nearest[to]:  # ties stay with the lower x, which came first
                nearest[to] = closeness
                warped[y, to], source_x[y, to] = image[y, x], x
                origin[y, to] = BACKGROUND if background else WARPED
    filled = _fill(warped, origin, majority)
    tiles = np.zeros((-(-height // TILE), -(-width // TILE)), bool)
    for y, x in np.argwhere(origin == HOLE):
        tiles[y // TILE, x // TILE] = True
    return OracleWarp(filled, origin, source_x, disparity, tiles)


def _fill(warped: np.ndarray, origin: np.ndarray, majority: bool) -> np.ndarray:
    """The image with each hole that has enough warped neighbours in its strip filled by their median; marks `origin`."""
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
