"""Compositing: each pixel goes through its tile's splats front to back, once for each level that it shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import prange

from golden.kernels import compiled
from golden.oracle.ellipse import exponent
from golden.oracle.project import Splats
from golden.oracle.tiles import TileLists
from golden.scenes.gaze import FoveationMap
from spec.constants import ALPHA_MIN, T_STOP


def blend_tiles(
    splats: Splats,
    lists: TileLists,
    foveation: FoveationMap,
    weight: np.ndarray,
    *,
    support_sigma: float | None,
    alpha_max: Sequence[float],
    background: Sequence[float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Renders every tile. In blend tiles both levels go through the same list, each with its own transmittance.

    Args:
        splats: the projected splats.
        lists: the splats of each tile, front to back.
        foveation: level and blend flag of each tile.
        weight: (height, width) float64 in 0..1, share of the tile's second level in each pixel.
        support_sigma: Mahalanobis radius that bounds a splat's support, or None for no such bound.
        alpha_max: upper bound of alpha for each level.
        background: red, green, blue; weighted by the final transmittance.

    Returns:
        Image (height, width, 3), sum of T alpha z (height, width) and transmittance (height, width), all float64.
    """
    fields = (
        splats.mean2d, splats.factor, splats.depth, splats.opacity, splats.colour, splats.quality_bound,
        math.inf if support_sigma is None else support_sigma**2 / 2,
    )
    return _blend(
        lists.start, lists.entries, foveation.tile_level, foveation.blend, foveation.tile, weight,
        np.array(alpha_max, float), np.array(background, float), fields,
    )


@compiled(parallel=True)
def _blend(start, entries, tile_level, blend, tile, weight, alpha_max, background, fields):
    height, width = weight.shape
    tiles_x = tile_level.shape[1]
    image, depth_sum, transmittance = np.empty((height, width, 3)), np.empty((height, width)), np.empty((height, width))
    for t in prange(len(start) - 1):
        ty, tx = t // tiles_x, t % tiles_x
        level = int(tile_level[ty, tx])
        here = entries[start[t] : start[t + 1]]
        for row in range(ty * tile, min((ty + 1) * tile, height)):
            for column in range(tx * tile, min((tx + 1) * tile, width)):
                x, y = column + 0.5, row + 0.5
                w = weight[row, column] if blend[ty, tx] else 0.0
                first = last = _composite(x, y, here, level, alpha_max[level], *fields)
                if w > 0.0:
                    last = _composite(x, y, here, level + 1, alpha_max[level + 1], *fields)
                for c in range(3):
                    first_colour = first[c] + first[4] * background[c]
                    last_colour = last[c] + last[4] * background[c]
                    image[row, column, c] = (1 - w) * first_colour + w * last_colour
                depth_sum[row, column] = (1 - w) * first[3] + w * last[3]
                transmittance[row, column] = (1 - w) * first[4] + w * last[4]
    return image, depth_sum, transmittance


@compiled
def _composite(x, y, entries, level, alpha_max, mean2d, factor, depth, opacity, colour, quality_bound, q_support):
    """Composites one level of one pixel with centre (x, y).

    Returns the sums of T alpha times red, green, blue and depth, and the final transmittance T. A splat is composited before
    the pixel stops, so that an alpha of 1 still shows its colour; 3DGS stops before compositing it.
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
