"""The volume rendering array: ordered entries to pixels, as docs/array.md defines it.

Organised for a CPU: one pass over a tile's entries per level bank, rows of 16 pixels as vectors of int32, and rows that
the splat cannot reach skipped by a conservative test. None of that changes a bit.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from golden.msv2_ref.parallel import for_slices
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import TILE

_ROW_MARGIN = 0.05  # added to the falloff limit of the row test; rounding of the exponent stays below 0.01


class ArraySplats(NamedTuple):
    """Splats as the array reads them, one row per splat.

    Attributes:
        mean2d: (N, 2) int32, raw `mean2d`.
        conic: (N, 3) int32, signed significands of the Cholesky factors.
        conic_exp: (N, 3) int32, their exponents, <= 0.
        log2_opacity: (N, levels) int32, raw `log2_opacity`.
        colour: (N, levels, 3) int32, raw `colour`.
        depth: (N,) int32, raw `depth`.
    """

    mean2d: np.ndarray
    conic: np.ndarray
    conic_exp: np.ndarray
    log2_opacity: np.ndarray
    colour: np.ndarray
    depth: np.ndarray


class Pixels(NamedTuple):
    """Finished pixels by tile: `colour` (tiles, 16, 16, 3), `depth` and `transmittance` (tiles, 16, 16), raw int32."""

    colour: np.ndarray
    depth: np.ndarray
    transmittance: np.ndarray


class _Shifts(NamedTuple):
    """Integer constants of one configuration, as the kernels take them."""

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


@cache
def _shifts(config: AcceleratorConfig) -> _Shifts:
    n = config.formats
    support = tables.support_exponent(config)
    return _Shifts(
        mean_frac=n.mean2d.frac_bits, sig_bits=n.conic.sig_bits, offset_frac=n.offset.frac_bits, offset_max=n.offset.raw_max,
        factor_frac=n.factor.frac_bits, grid=n.exponent.frac_bits, cut_frac=n.cut.frac_bits,
        opacity_frac=n.log2_opacity.frac_bits, cut_min=tables.log2_alpha_min(n),
        support=1 << 30 if support is None else support, alpha_frac=n.alpha.frac_bits, alpha_max_l1=tables.alpha_max_l1(n),
        t_max=n.transmittance.raw_max, t_stop=tables.t_stop(n),
        weight_drop=n.transmittance.frac_bits - n.weight.frac_bits,
        colour_shift=n.weight.frac_bits + n.colour.frac_bits - n.accumulator.frac_bits,
        depth_shift=n.weight.frac_bits + n.depth.frac_bits - n.depth_accumulator.frac_bits,
    )


@cache
def _mantissas(config: AcceleratorConfig) -> np.ndarray:
    """(2^F(cut),) int32: the exponential's mantissa for every fraction."""
    n = config.formats
    base, slope = tables.exp2_segments(n)
    fraction = np.arange(1 << n.cut.frac_bits)
    segment, rest = np.divmod(fraction, len(fraction) // n.exp2_segments)
    shift = tables.EXP2_SLOPE_FRAC + n.cut.frac_bits - n.alpha.frac_bits
    return (base[segment] + (slope[segment] * rest >> shift)).astype(np.int32)


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


@numba.njit(cache=True)
def _polynomial(mean, conic, conic_exp, tile_x, tile_y, k):
    """Setup steps 1-6: (kept, corner, slope_x, slope_y, curve_xx, curve_xy, curve_yy, v, k3)."""
    half = 1 << (k.mean_frac - 1)
    dx = ((np.int64(TILE) * tile_x + TILE // 2) << k.mean_frac) + half - mean[0]
    dy = ((np.int64(TILE) * tile_y + TILE // 2) << k.mean_frac) + half - mean[1]
    m1, m2, m3 = np.int64(conic[0]), np.int64(conic[1]), np.int64(conic[2])
    u = _offset(m1, conic_exp[0], dx, k) + _offset(m2, conic_exp[1], dy, k)
    v = _offset(m3, conic_exp[2], dy, k)
    lowest, highest = -k.offset_max - 1, k.offset_max
    square = u * u + v * v
    kept = lowest <= u <= highest and lowest <= v <= highest
    kept = kept and square < np.int64(tables.CENTRE_EXPONENT_MAX) << (2 * k.offset_frac)
    if not kept:
        return False, 0, 0, 0, 0, 0, 0, 0, 0
    k1, k2, k3 = _factor(m1, conic_exp[0], k), _factor(m2, conic_exp[1], k), _factor(m3, conic_exp[2], k)
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
    """First and last row (inclusive) where v^2 alone stays within `falloff` (raw, fraction of the cut); v is at row 8."""
    reach = np.sqrt(falloff / (1 << k.cut_frac) + _ROW_MARGIN)
    centre, step = v / (1 << k.offset_frac), max(k3, 1) / (1 << k.factor_frac)
    low = TILE // 2 + np.ceil((-reach - centre) / step)
    high = TILE // 2 + np.floor((reach - centre) / step)
    return int(max(low, 0)), int(min(high, TILE - 1))


def _make_bank_kernel(depth: bool):
    """The pass of one level bank over one tile; `depth` selects whether depth sums exist."""

    @numba.njit(cache=True, nogil=True)
    def bank_kernel(splats, order, use, bank, level, outer, tile_x, tile_y, background, mantissas, k, t, red, green, blue, far):
        t[:] = k.t_max
        red[:] = 0
        green[:] = 0
        blue[:] = 0
        far[:] = 0
        active_exponent = np.empty(TILE, np.int32)
        colour_half, depth_half = np.int32((1 << k.colour_shift) >> 1), np.int32((1 << k.depth_shift) >> 1)
        alpha_half, alpha_one = np.int32(1 << (k.alpha_frac - 1)), np.int32(1 << k.alpha_frac)
        alpha_cap = alpha_one if outer else np.int32(k.alpha_max_l1)
        fraction_mask = np.int32((1 << k.cut_frac) - 1)
        colour_shift, depth_shift = np.int32(k.colour_shift), np.int32(k.depth_shift)
        alpha_frac, cut_frac, grid_shift = np.int32(k.alpha_frac), np.int32(k.cut_frac), np.int32(k.grid - k.cut_frac)
        weight_drop, t_stop = np.int32(k.weight_drop), np.int32(k.t_stop)
        for n in range(len(order)):
            if n % 16 == 15 and t.max() < t_stop:
                break
            if not use[n] >> bank & 1:
                continue
            i = order[n]
            kept, corner, sx, sy, cxx, cxy, cyy, v, k3 = _polynomial(
                splats.mean2d[i], splats.conic[i], splats.conic_exp[i], tile_x, tile_y, k)
            if not kept:
                continue
            opacity = splats.log2_opacity[i, level]
            cut = np.int32(max(opacity - k.support, k.cut_min))
            corner += (np.int64(opacity) << (k.grid - k.opacity_frac)) + (1 << (k.grid - k.cut_frac - 1))
            r, g, b = splats.colour[i, level, 0], splats.colour[i, level, 1], splats.colour[i, level, 2]
            z = splats.depth[i]
            first_row, last_row = _row_range(opacity - cut, v, k3, k)
            for y in range(first_row, last_row + 1):
                row_start = np.int32(corner + y * sy + y * (y - 1) // 2 * cyy)
                row_slope = np.int32(sx + y * cxy)
                curve = np.int32(cxx)
                any_active = False
                for x in range(TILE):
                    e = np.int32(row_start + np.int32(x) * row_slope + np.int32(x * (x - 1) // 2) * curve) >> grid_shift
                    active_exponent[x] = e
                    any_active |= e >= cut
                if not any_active:
                    continue
                base = y * TILE
                for x in range(TILE):
                    p = base + x
                    e = active_exponent[x]
                    before = t[p]
                    clipped = min(e, np.int32(-1))
                    alpha = np.int32(mantissas[clipped & fraction_mask] >> (-(clipped >> cut_frac)))
                    alpha = alpha_one if e >= 0 else alpha
                    alpha = min(alpha, alpha_cap)
                    alpha = alpha if (e >= cut) & (before >= t_stop) else np.int32(0)
                    after = np.int32(before - (np.int32(before * alpha + alpha_half) >> alpha_frac))
                    w = np.int32((before >> weight_drop) - (after >> weight_drop))
                    t[p] = after
                    red[p] += np.int32(w * r + colour_half) >> colour_shift
                    green[p] += np.int32(w * g + colour_half) >> colour_shift
                    blue[p] += np.int32(w * b + colour_half) >> colour_shift
                    if depth:
                        far[p] += np.int32(w * z + depth_half) >> depth_shift
        for p in range(TILE * TILE):
            w = t[p] >> weight_drop
            red[p] += np.int32(w * background[0] + colour_half) >> colour_shift
            green[p] += np.int32(w * background[1] + colour_half) >> colour_shift
            blue[p] += np.int32(w * background[2] + colour_half) >> colour_shift

    return bank_kernel


@numba.njit(cache=True, inline="always")
def _blend_weight(t, smoothstep, plane_frac):
    """Weight of the outer level from the raw blend parameter."""
    if t < 0:
        return np.int64(0)
    if t >= 1 << plane_frac:
        return np.int64(1 << 8)
    return smoothstep[t >> (plane_frac - tables.BLEND_INDEX_BITS)]


@numba.njit(cache=True)
def _blend(state, plane, smoothstep, plane_frac):
    """Blends the second bank of `state` (2, 5, 256) into the first."""
    for p in range(TILE * TILE):
        t = plane[0] + p % TILE * plane[1] + p // TILE * plane[2]
        weight = _blend_weight(t, smoothstep, plane_frac)
        for c in range(5):
            a, b = np.int64(state[0, c, p]), np.int64(state[1, c, p])
            state[0, c, p] = a + (((b - a) * weight + 128) >> 8)


def _make_frame_kernel(depth: bool):
    bank_kernel = _make_bank_kernel(depth)

    @numba.njit(cache=True, nogil=True)
    def frame_kernel(_slice, begin, end, splats, work, background, mantissas, smoothstep, plane_frac, k, colour, far, last_t):
        for tile in range(begin, end):
            tile_x, tile_y, level, outer, blend = work.header[tile]
            first, end = work.start[tile], work.start[tile + 1]
            mine, using = work.order[first:end], work.use[first:end]
            state = np.empty((2, 5, TILE * TILE), np.int32)
            for bank in range(2 if blend else 1):
                bank_kernel(splats, mine, using, bank, level + bank, outer + bank > 0, tile_x, tile_y, background, mantissas, k,
                            state[bank, 0], state[bank, 1], state[bank, 2], state[bank, 3], state[bank, 4])
            if blend:
                _blend(state, work.plane[tile], smoothstep, plane_frac)
            for p in range(TILE * TILE):
                y, x = p // TILE, p % TILE
                last_t[tile, y, x] = state[0, 0, p]
                colour[tile, y, x, 0] = state[0, 1, p]
                colour[tile, y, x, 1] = state[0, 2, p]
                colour[tile, y, x, 2] = state[0, 3, p]
                far[tile, y, x] = state[0, 4, p]

    return frame_kernel


@cache
def _frame_kernel(depth: bool):
    return _make_frame_kernel(depth)


class TileWork(NamedTuple):
    """What the array does for a frame, entries in rendering order.

    Attributes:
        header: (tiles, 5) int64: tile_x, tile_y, index of the tile's level in the splats' arrays, outer, blend.
        plane: (tiles, 3) int64, raw `plane`.
        start: (tiles + 1,) int64, first entry of each tile.
        order: (entries,) int32, row of each entry's splat.
        use: (entries,) uint8, bit 0: the tile's level uses the splat, bit 1: the next one does.
    """

    header: np.ndarray
    plane: np.ndarray
    start: np.ndarray
    order: np.ndarray
    use: np.ndarray


def render(config: AcceleratorConfig, splats: ArraySplats, work: TileWork, background: np.ndarray) -> Pixels:
    """Every tile's pixels. `background` is (3,) raw `colour`."""
    tiles, n = len(work.header), config.formats
    colour = np.empty((tiles, TILE, TILE, 3), np.int32)
    depth, transmittance = np.zeros((tiles, TILE, TILE), np.int32), np.empty((tiles, TILE, TILE), np.int32)
    for_slices(
        _frame_kernel(config.depth), tiles, splats, work, np.asarray(background, np.int32), _mantissas(config),
        tables.smoothstep_table(n), n.plane.frac_bits, _shifts(config), colour, depth, transmittance)
    return Pixels(colour, depth, transmittance)


def split_conic(config: AcceleratorConfig, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(significand, exponent) int32 of `conic` values held in float64, any shape."""
    conic = config.formats.conic
    mantissa, exponent = np.frexp(value)
    significand = np.ldexp(mantissa, conic.sig_bits).astype(np.int32)
    return significand, np.where(value == 0, conic.exp_min, exponent - 1).astype(np.int32)


def decode_conic(config: AcceleratorConfig, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(significand, exponent) int32 of raw `conic` bit patterns, any shape."""
    significand, exponent = config.formats.conic.fields(bits)
    return significand.astype(np.int32), exponent.astype(np.int32)


def render_tiles(config: AcceleratorConfig, headers: np.ndarray, entries: np.ndarray, background: np.ndarray) -> Pixels:
    """The array on its own input records.

    Args:
        config: the machine.
        headers: (tiles,) of `spec.records.tile_header`'s dtype; `count` says how many entries each takes.
        entries: (sum of counts,) of `spec.records.array_entry`'s dtype, in order.
        background: (3,) raw `colour`.

    Raises:
        ValueError: the headers' counts do not sum to the number of entries.
    """
    start = np.concatenate(([0], np.cumsum(headers["count"], dtype=np.int64)))
    if start[-1] != len(entries):
        raise ValueError(f"the headers' counts must sum to the number of entries, {len(entries)}, not {int(start[-1])!r}")
    significand, exponent = decode_conic(config, entries["conic"])
    splats = ArraySplats(
        entries["mean2d"].astype(np.int32), significand, exponent, entries["log2_opacity"].astype(np.int32),
        entries["colour"].reshape(-1, 2, 3).astype(np.int32), entries["depth"].astype(np.int32))
    level = np.zeros(len(headers), np.int64)  # entries carry the tile's own level first
    header = np.stack([headers["tile_x"], headers["tile_y"], level, headers["outer"], headers["blend"]], 1)
    use = (entries["use"] @ np.array([1, 2])).astype(np.uint8)
    order = np.arange(len(entries), dtype=np.int32)
    work = TileWork(header.astype(np.int64), headers["plane"].astype(np.int64), start, order, use)
    return render(config, splats, work, background)
