"""Sums over an image's pixels of squared derivatives of the image with respect to each splat, on the CPU, for criteria of
pruning.

The gradient of a loss is a sum over pixels, from which the squares of its terms cannot be recovered. So this is a pass of its
own, over the records of `blend_rows.replay`, back to front as in `blend_cpu`. For channel c of a pixel, a splat's share s = T
alpha, and B_c, what is behind the splat composited from transmittance 1, let

    D_c = alpha dI_c / dalpha = s (c_c - B_c), and 0 where alpha is clipped.

The five numbers p of a splat's place and shape (mean2d, factor) act on all channels through alpha alone: dI_c / dp = D_c h,
with one h for all channels. A colour acts on its own channel: dI_c / dc_c = s. So all products of a pixel's derivatives, summed
over channels, follow from 15 products of h with itself, 15 of h with the colours' derivatives, and s^2. Sums are float64: a sum
of outer products then stays as good as positive semidefinite.
"""

from __future__ import annotations

import numpy as np

from golden.diff.blend_cpu import Blending
from golden.diff.blend_rows import BLOCK, SCALE, kernel, replay_tile, scratch, set_up
from golden.diff.slices import run_slices
from spec.constants import TILE

PLACE = 5
"""Numbers of a splat's place and shape: mean2d 2, factor 3."""

PRODUCTS = PLACE * (PLACE + 1) // 2
"""Products of these numbers' derivatives with each other: the upper triangle, row by row."""

SUMS = 2 + PRODUCTS + 3 * PLACE
"""Sums of an intersection: (dI / dg)^2, s^2, the products of h, and for each channel h D_c s."""

_UNSCALED = 1.0 / float(SCALE)


@kernel
def _derivatives(records, r, behind, y, opacity, alpha_max, red, green, blue, d, value, share):
    """D_c of a row of pixels into `d`, the sum over channels of (dI_c / dg)^2 into `value`, and shares; updates `behind`."""
    for x in range(TILE):
        alpha, s = np.float64(records[r, x]), np.float64(records[r, TILE + x])
        b_red, b_green, b_blue = red - behind[0, y, x], green - behind[1, y, x], blue - behind[2, y, x]
        behind[0, y, x] += alpha * b_red
        behind[1, y, x] += alpha * b_green
        behind[2, y, x] += alpha * b_blue
        smooth = s if alpha < alpha_max else 0.0
        d[0, x], d[1, x], d[2, x] = smooth * b_red, smooth * b_green, smooth * b_blue
        per_value = opacity / alpha if alpha > 0 else 0.0
        value[x] = per_value * per_value * (d[0, x] * d[0, x] + d[1, x] * d[1, x] + d[2, x] * d[2, x])
        share[x] = s


@kernel
def _directions(pairs, j, y, h):
    """h of a row of pixels: -dq / d(mean2d, factor), as alpha = opacity exp(-q) and q = (u^2 + v^2) / 2."""
    f0, f1, f2 = pairs[j, 2] * _UNSCALED, pairs[j, 3] * _UNSCALED, pairs[j, 4] * _UNSCALED
    dy = np.float64(pairs[j, 1]) + y
    v = f2 * dy
    for x in range(TILE):
        dx = np.float64(pairs[j, 0]) + x
        u = f0 * dx + f1 * dy
        h[0, x], h[1, x] = u * f0, u * f1 + v * f2
        h[2, x], h[3, x], h[4, x] = -u * dx, -u * dy, -v * dy


@kernel
def _add_products(h, d, share, sums):
    """Adds a row of pixels to the sums after the first."""
    for x in range(TILE):
        sums[1, x] += share[x] * share[x]
    at = 2
    for i in range(PLACE):
        for k in range(i, PLACE):
            for x in range(TILE):
                sums[at, x] += (d[0, x] * d[0, x] + d[1, x] * d[1, x] + d[2, x] * d[2, x]) * h[i, x] * h[k, x]
            at += 1
    for c in range(3):
        for i in range(PLACE):
            for x in range(TILE):
                sums[at, x] += d[c, x] * share[x] * h[i, x]
            at += 1


@kernel
def _tile(
    splats, numbers, left, top, table, opacities, alpha_max, behind, pairs, records, row_of_record, first_record, sums, result
):
    """Goes through the records of one tile back to front."""
    d, h = np.empty((3, TILE), np.float64), np.empty((PLACE, TILE), np.float64)
    value, share = np.empty(TILE, np.float64), np.empty(TILE, np.float64)
    for begin in range((len(splats) - 1) // BLOCK * BLOCK, -1, -BLOCK):
        block = splats[begin : begin + BLOCK]
        set_up(block, left, top, table, pairs)
        for j in range(len(block) - 1, -1, -1):
            n = begin + j
            sums[:] = 0.0
            for r in range(first_record[n], first_record[n + 1]):
                y = row_of_record[r]
                _derivatives(records, r, behind, y, np.float64(opacities[block[j]]), alpha_max, np.float64(pairs[j, 7]),
                             np.float64(pairs[j, 8]), np.float64(pairs[j, 9]), d, value, share)
                for x in range(TILE):
                    sums[0, x] += value[x]
                if len(sums) > 1:
                    _directions(pairs, j, y, h)
                    _add_products(h, d, share, sums)
            for k in range(len(sums)):
                result[numbers[n], k] = sums[k].sum()


@kernel
def _squares(
    _slice, begin, end, start, splat, number, table, opacities, alpha_max, background, tiles_x, used, width, height, result
):
    light, pairs, live, records, row_of_record, first_record = scratch(used[begin:end])
    sums, behind = np.empty((result.shape[1], TILE), np.float64), np.empty((3, TILE, TILE), np.float64)
    for tile in range(begin, end):
        splats = splat[start[tile] : start[tile] + used[tile]]
        numbers = number[start[tile] : start[tile + 1]]
        left, top, records, row_of_record = replay_tile(
            tile, tiles_x, width, height, splats, table, alpha_max, light, pairs, live, records, row_of_record, first_record)
        for c in range(3):
            behind[c] = background[c]
        _tile(splats, numbers, left, top, table, opacities, alpha_max, behind, pairs, records, row_of_record, first_record,
              sums, result)
        for n in range(used[tile], len(numbers)):
            result[numbers[n]] = 0.0


@kernel
def sum_pairs(_slice, begin, end, order, room, of_pair, result):
    """Sums the intersections of each splat in a fixed order, so that the number of threads changes nothing."""
    for k in range(begin, end):
        i = order[k]
        result[i] = 0.0
        for p in range(room[k], room[k + 1]):
            result[i] += of_pair[p]


def squares(blending: Blending, products: bool = True) -> np.ndarray:
    """(M, SUMS) float64 sums over the pixels of an image, see the module; without `products`, (M, 1): the first sum alone.

    Args:
        blending: the image's forward pass.
        products: whether the products are wanted.
    """
    lists, count = blending.lists, len(blending.table)
    of_pair = np.empty((len(lists.splat), SUMS if products else 1))
    run_slices(_squares, len(blending.used), lists.start, lists.splat, lists.pair, blending.table, blending.opacity,
               blending.alpha_max, blending.background, blending.tiles_x, blending.used, *blending.size, of_pair)
    result = np.empty((count, of_pair.shape[1]))
    run_slices(sum_pairs, count, lists.order, lists.room, of_pair, result)
    return result
