"""Compositing: each pixel goes through its tile's splats front to back, once per level it shows."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from golden.oracle.ellipse import exponent
from spec.constants import ALPHA_MIN, T_STOP


@njit(cache=True)
def composite(
    x, y, level, entries, mean2d, factor, depth, opacity, colour, quality_bound, q_support, alpha_max
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """One level of one pixel, centre (x, y): sums of T alpha times red, green, blue and depth, and the final T.

    A splat is composited before the pixel stops, so that an alpha of 1 still shows its colour; 3DGS stops before.
    """
    red = green = blue = depth_sum = 0.0
    transmittance = 1.0
    for i in entries:
        if level >= quality_bound[i]:
            continue
        q = exponent(x - mean2d[i, 0], y - mean2d[i, 1], factor[i])
        if q > q_support:
            continue
        alpha = min(alpha_max, opacity[i, level] * math.exp(-q))
        if alpha < ALPHA_MIN:
            continue
        share = transmittance * alpha
        red += share * colour[i, level, 0]
        green += share * colour[i, level, 1]
        blue += share * colour[i, level, 2]
        depth_sum += share * depth[i]
        transmittance *= 1.0 - alpha
        if transmittance < T_STOP:
            break
    return red, green, blue, depth_sum, transmittance


@njit(cache=True, parallel=True)
def blend_tiles(
    start, entries, mean2d, factor, depth, opacity, colour, quality_bound, tile_level, blend, weight, tile, q_support,
    alpha_max, background,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Render every tile; in blend tiles both levels go through the same list, each with its own transmittance.

    Args:
        start, entries: the tile lists, see `tiles.TileLists`.
        mean2d .. quality_bound: the splats' fields, see `project.Splats`.
        tile_level, blend: (tiles_y, tiles_x), see `gaze.FoveationMap`.
        weight: (height, width) float64, share of the tile's second level in each pixel.
        tile: tile edge in pixels.
        q_support: largest exponent that any splat covers, may be inf.
        alpha_max: (levels,) float64.
        background: (3,) float64.

    Returns:
        image (height, width, 3), depth sum (height, width) and transmittance (height, width), all float64.
    """
    height, width = weight.shape
    tiles_x = tile_level.shape[1]
    image, depth_sum, transmittance = np.empty((height, width, 3)), np.empty((height, width)), np.empty((height, width))
    for t in prange(len(start) - 1):
        ty, tx = t // tiles_x, t % tiles_x
        here = entries[start[t] : start[t + 1]]
        for row in range(ty * tile, min((ty + 1) * tile, height)):
            for column in range(tx * tile, min((tx + 1) * tile, width)):
                w = weight[row, column] if blend[ty, tx] else 0.0
                level = int(tile_level[ty, tx])
                first = last = composite(
                    column + 0.5, row + 0.5, level, here, mean2d, factor, depth, opacity, colour, quality_bound,
                    q_support, alpha_max[level],
                )  # fmt: skip
                if w > 0.0:
                    last = composite(
                        column + 0.5, row + 0.5, level + 1, here, mean2d, factor, depth, opacity, colour, quality_bound,
                        q_support, alpha_max[level + 1],
                    )  # fmt: skip
                for c in range(3):
                    level_1 = first[c] + first[4] * background[c]
                    level_2 = last[c] + last[4] * background[c]
                    image[row, column, c] = (1 - w) * level_1 + w * level_2
                depth_sum[row, column] = (1 - w) * first[3] + w * last[3]
                transmittance[row, column] = (1 - w) * first[4] + w * last[4]
    return image, depth_sum, transmittance
