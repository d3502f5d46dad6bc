"""The array's kernels: tiles of int32 pixels, as docs/array.md defines them.

A tile's state is `rows` (16, 6 * 16) int32: for each row of 16 pixels the transmittance, three colour sums, the depth sum and
room for the exponential's mantissas, side by side. All that a row's loop touches then lies at constant distances from one
pointer, which is what lets LLVM turn the loop into vectors without testing for overlap.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from numba.extending import intrinsic

from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import TILE

_T, _RED, _GREEN, _BLUE, _FAR, _MANTISSA = range(0, 6 * TILE, TILE)

_ROW_MARGIN = 0.05  # added to the falloff limit of the row test; rounding of the exponent stays below 0.01


class ArrayConstants(NamedTuple):
    """Integer constants of one configuration, as the kernels take them: `*_frac` are fraction bits, the rest raw values."""

    mean_frac: int
    sig_bits: int
    offset_frac: int
    offset_max: int
    factor_frac: int
    grid: int  # fraction bits of the exponent
    cut_frac: int
    opacity_frac: int
    cut_min: int
    support: int
    alpha_frac: int
    alpha_max_l1: int
    t_max: int
    t_stop: int
    weight_drop: int
    colour_shift: int
    depth_shift: int
    depth: bool
    plane_frac: int


@cache
def array_constants(config: AcceleratorConfig) -> ArrayConstants:
    """The constants of `config`."""
    n = config.formats
    support = tables.support_exponent(config)
    return ArrayConstants(
        mean_frac=n.mean2d.frac_bits, sig_bits=n.conic.sig_bits, offset_frac=n.offset.frac_bits, offset_max=n.offset.raw_max,
        factor_frac=n.factor.frac_bits, grid=n.exponent.frac_bits, cut_frac=n.cut.frac_bits,
        opacity_frac=n.log2_opacity.frac_bits, cut_min=tables.log2_alpha_min(n),
        support=1 << 30 if support is None else support, alpha_frac=n.alpha.frac_bits, alpha_max_l1=tables.alpha_max_l1(n),
        t_max=n.transmittance.raw_max, t_stop=tables.t_stop(n),
        weight_drop=n.transmittance.frac_bits - n.weight.frac_bits,
        colour_shift=n.weight.frac_bits + n.colour.frac_bits - n.accumulator.frac_bits,
        depth_shift=n.weight.frac_bits + n.depth.frac_bits - n.depth_accumulator.frac_bits,
        depth=config.depth, plane_frac=n.plane.frac_bits,
    )


@intrinsic
def _shift(_context, x, n):
    """x >> n in int32; numba's own operators widen to int64, which would halve the pixels in a vector."""
    return numba.int32(numba.int32, numba.int32), lambda _, builder, __, arguments: builder.ashr(*arguments)


@intrinsic
def _product(_context, a, b, n):
    """rs(a * b, n) in int32."""

    def generate(_, builder, __, arguments):
        a, b, n = arguments
        one = n.type(1)
        half = builder.lshr(builder.shl(one, n), one)
        return builder.ashr(builder.add(builder.mul(a, b), half), n)

    return numba.int32(numba.int32, numba.int32, numba.int32), generate


@intrinsic
def _exponent(_context, start, slope, curve, x):
    """Exponent at pixel x of a row, in int32."""

    def generate(_, builder, __, arguments):
        start, slope, curve, x = arguments
        triangle = builder.lshr(builder.mul(x, builder.sub(x, x.type(1))), x.type(1))
        return builder.add(start, builder.add(builder.mul(x, slope), builder.mul(triangle, curve)))

    return numba.int32(numba.int32, numba.int32, numba.int32, numba.int32), generate


@numba.njit(cache=True, inline="always")
def _round_shift(x, n):
    return (x + ((1 << n) >> 1)) >> n


@numba.njit(cache=True, inline="always")
def _offset(significand, exponent, distance, k):
    shift = k.sig_bits - 1 - exponent + k.mean_frac - k.offset_frac
    return _round_shift(significand * distance, shift) if shift < 48 else 0


@numba.njit(cache=True, inline="always")
def _factor(significand, exponent, k):
    return _round_shift(significand, -exponent) if -exponent <= k.sig_bits else 0


@numba.njit(cache=True, inline="always")
def _polynomial(splats, i, tile_x, tile_y, k):
    """Setup steps 1-6: (kept, corner, slope_x, slope_y, curve_xx, curve_xy, curve_yy, v, k3)."""
    half = 1 << (k.mean_frac - 1)
    dx = ((np.int64(TILE) * tile_x + TILE // 2) << k.mean_frac) + half - splats.mean2d[i, 0]
    dy = ((np.int64(TILE) * tile_y + TILE // 2) << k.mean_frac) + half - splats.mean2d[i, 1]
    m1, m2, m3 = np.int64(splats.conic[i, 0]), np.int64(splats.conic[i, 1]), np.int64(splats.conic[i, 2])
    e0, e1, e2 = splats.conic_exp[i, 0], splats.conic_exp[i, 1], splats.conic_exp[i, 2]
    u = _offset(m1, e0, dx, k) + _offset(m2, e1, dy, k)
    v = _offset(m3, e2, dy, k)
    lowest, highest = -k.offset_max - 1, k.offset_max
    square = u * u + v * v
    kept = lowest <= u <= highest and lowest <= v <= highest
    kept = kept and square < np.int64(tables.CENTRE_EXPONENT_MAX) << (2 * k.offset_frac)
    if not kept:
        return False, 0, 0, 0, 0, 0, 0, 0, 0
    k1, k2, k3 = _factor(m1, e0, k), _factor(m2, e1, k), _factor(m3, e2, k)
    second, first = 2 * k.factor_frac - k.grid, k.offset_frac + k.factor_frac - k.grid
    curve_xx = -_round_shift(2 * k1 * k1, second)
    curve_xy = -_round_shift(2 * k1 * k2, second)
    curve_yy = -_round_shift(2 * (k2 * k2 + k3 * k3), second)
    gx = -_round_shift(2 * u * k1, first) + (curve_xx >> 1)
    gy = -_round_shift(2 * (u * k2 + v * k3), first) + (curve_yy >> 1)
    q = _round_shift(square, 2 * k.offset_frac - k.grid)
    corner = -q - 8 * gx - 8 * gy + 36 * curve_xx + 36 * curve_yy + 64 * curve_xy
    return True, corner, gx - 8 * curve_xx - 8 * curve_xy, gy - 8 * curve_yy - 8 * curve_xy, curve_xx, curve_xy, curve_yy, v, k3


@numba.njit(cache=True, inline="always")
def _row_range(falloff, v, k3, k):
    """First and last row (inclusive) where v^2 alone stays within `falloff` (raw, fraction of the cut); v is at row 8.

    An opacity below the cut makes the falloff negative: the row then does not matter, but it has to be one.
    """
    reach = np.sqrt(max(falloff / (1 << k.cut_frac) + _ROW_MARGIN, 0.0))
    centre, step = v / (1 << k.offset_frac), max(k3, 1) / (1 << k.factor_frac)
    low = TILE // 2 + np.ceil((-reach - centre) / step)
    high = TILE // 2 + np.floor((reach - centre) / step)
    return int(max(low, 0)), int(min(high, TILE - 1))


@numba.njit(cache=True, inline="always")
def _row_may_be_active(start, slope, curve, cut):
    """Whether a row's largest exponent can reach `cut`: second differences are <= 0, so it is at an end or inside."""
    if slope <= 0:
        return start >= cut
    return slope + (TILE - 2) * curve < 0 or start + (TILE - 1) * slope + (TILE - 1) * (TILE - 2) // 2 * curve >= cut


@numba.njit(cache=True, inline="always")
def _composite(rows, y, start, slope, curve, cut, least, colour, depth, mantissas, k):
    """One splat over row `y`; start, slope and curve are the exponent there and its differences along x.

    `mantissas` are negated, so that shifting them right rounds alpha up; `least` is the least of 1 - alpha, which is `through`.
    """
    to_cut, fraction = k.grid - k.cut_frac, (1 << k.cut_frac) - 1
    e, step = start, slope
    for x in range(TILE):
        rows[y, _MANTISSA + x] = mantissas[(e >> to_cut) & fraction]
        e, step = e + step, step + curve
    start, slope, curve = np.int32(start), np.int32(slope), np.int32(curve)
    one, opaque, t_stop, top = np.int32(1 << k.alpha_frac), np.int32(0), np.int32(k.t_stop), np.int32(-1)
    red, green, blue = colour
    for x in range(TILE):
        before = rows[y, _T + x]
        t = _shift(_exponent(start, slope, curve, x), to_cut)
        through = np.int32(one + _shift(rows[y, _MANTISSA + x], -_shift(min(max(t, cut), top), k.cut_frac)))
        through = max(opaque if t >= 0 else through, least)
        through = through if (t >= cut) & (before >= t_stop) else one
        after = _product(before, through, k.alpha_frac)
        weight = _shift(before, k.weight_drop) - _shift(after, k.weight_drop)
        rows[y, _T + x] = after
        rows[y, _RED + x] += _product(weight, red, k.colour_shift)
        rows[y, _GREEN + x] += _product(weight, green, k.colour_shift)
        rows[y, _BLUE + x] += _product(weight, blue, k.colour_shift)
        rows[y, _FAR + x] += _product(weight, depth, k.depth_shift)


@numba.njit(cache=True)
def _composite_background(rows, background, k):
    for y in range(TILE):
        for x in range(TILE):
            weight = _shift(rows[y, _T + x], k.weight_drop)
            rows[y, _RED + x] += _product(weight, background[0], k.colour_shift)
            rows[y, _GREEN + x] += _product(weight, background[1], k.colour_shift)
            rows[y, _BLUE + x] += _product(weight, background[2], k.colour_shift)


@numba.njit(cache=True)
def _bank(splats, order, use, bank, level, outer, tile_x, tile_y, background, mantissas, k, rows):
    """The pass of one level bank over one tile, into `rows`."""
    rows[:] = 0
    rows[:, _T : _T + TILE] = k.t_max
    least = np.int32(0 if outer else (1 << k.alpha_frac) - k.alpha_max_l1)
    for n in range(len(order)):
        if n % 16 == 15 and rows[:, _T : _T + TILE].max() < k.t_stop:
            break
        if not use[n] >> bank & 1:
            continue
        i = order[n]
        kept, corner, sx, sy, cxx, cxy, cyy, v, k3 = _polynomial(splats, i, tile_x, tile_y, k)
        if not kept:
            continue
        opacity = splats.log2_opacity[i, level]
        cut = np.int32(max(opacity - k.support, k.cut_min))
        colour = splats.colour[i, level, 0], splats.colour[i, level, 1], splats.colour[i, level, 2]
        depth = splats.depth[i] if k.depth else np.int32(0)
        corner += (np.int64(opacity) << (k.grid - k.opacity_frac)) + (1 << (k.grid - k.cut_frac - 1))
        first_row, last_row = _row_range(opacity - cut, v, k3, k)
        for y in range(first_row, last_row + 1):
            start, slope = corner + y * sy + (y * (y - 1) >> 1) * cyy, sx + y * cxy
            if _row_may_be_active(start, slope, cxx, np.int64(cut) << (k.grid - k.cut_frac)):
                _composite(rows, y, start, slope, cxx, cut, least, colour, depth, mantissas, k)
    _composite_background(rows, background, k)


@numba.njit(cache=True, inline="always")
def _blend_weight(t, smoothstep, plane_frac):
    """Weight of the outer level from the raw blend parameter."""
    if t < 0:
        return np.int64(0)
    if t >= 1 << plane_frac:
        return np.int64(1 << 8)
    return smoothstep[t >> (plane_frac - tables.BLEND_INDEX_BITS)]


@numba.njit(cache=True)
def _blend(rows, outer_rows, plane, smoothstep, k):
    """Blends the second bank's rows into the first's."""
    for y in range(TILE):
        for x in range(TILE):
            weight = _blend_weight(plane[0] + x * plane[1] + y * plane[2], smoothstep, k.plane_frac)
            for c in (_T, _RED, _GREEN, _BLUE, _FAR):
                a, b = np.int64(rows[y, c + x]), np.int64(outer_rows[y, c + x])
                rows[y, c + x] = a + (((b - a) * weight + 128) >> 8)


@numba.njit(cache=True, nogil=True)
def render_tiles(_slice, begin, end, splats, work, background, mantissas, smoothstep, k, colour, depth, transmittance):
    """Tiles begin..end of `work`, a `vrc_array.TileWork`, into colour, depth and transmittance, as `vrc_array.Pixels`."""
    rows, outer_rows = np.empty((TILE, 6 * TILE), np.int32), np.empty((TILE, 6 * TILE), np.int32)
    for tile in range(begin, end):
        tile_x, tile_y, level, outer, blend = work.header[tile]
        order, use = work.order[work.start[tile] : work.start[tile + 1]], work.use[work.start[tile] : work.start[tile + 1]]
        _bank(splats, order, use, 0, level, outer > 0, tile_x, tile_y, background, mantissas, k, rows)
        if blend:
            _bank(splats, order, use, 1, level + 1, True, tile_x, tile_y, background, mantissas, k, outer_rows)
            _blend(rows, outer_rows, work.plane[tile], smoothstep, k)
        transmittance[tile], depth[tile] = rows[:, _T : _T + TILE], rows[:, _FAR : _FAR + TILE]
        colour[tile, :, :, 0], colour[tile, :, :, 1] = rows[:, _RED : _RED + TILE], rows[:, _GREEN : _GREEN + TILE]
        colour[tile, :, :, 2] = rows[:, _BLUE : _BLUE + TILE]
