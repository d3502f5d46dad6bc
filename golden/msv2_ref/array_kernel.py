"""The array's kernels: tiles of int32 pixels, as docs/array.md defines them; one with depth sums, one without.

Intersections are set up in blocks, in float64, which LLVM vectorises. The pixels are then processed in rows of 16, each row one
vector. A tile's `state` is a flat int32 array: for each row its transmittance, three colour sums and depth sum, one after the
other.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from golden.kernels import compiled
from golden.msv2_ref.vectors import LANES, any_lane, choose, load, lookup, ramp, store
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, TILE

_PLANES = 5
_T, _RED, _GREEN, _BLUE, _FAR = range(0, _PLANES * TILE, TILE)
_STATE = TILE * _PLANES * TILE

_BLOCK = 32  # intersections set up at once, one in each column; after each block it is checked whether the tile has stopped
_PAIR_ROWS = 20
(_L1, _L2, _L3, _DX, _DY, _FALLOFF, _OPACITY, _CUT, _PAIR_RED, _PAIR_GREEN, _PAIR_BLUE, _PAIR_DEPTH, _FIRST, _LAST, _CORNER,
 _SLOPE_X, _SLOPE_Y, _XX, _XY, _YY) = range(0, _PAIR_ROWS * _BLOCK, _BLOCK)

_ROW_MARGIN = 0.05  # added to the falloff limit in the row test; the exponent's rounding error stays below 0.01


class ArrayConstants(NamedTuple):
    """Integer constants of one configuration, as the kernels take them: `*_frac` are numbers of fraction bits, the rest raw
    values."""

    mean_frac: int
    sig_bits: int
    offset_frac: int
    offset_max: int
    factor_frac: int
    grid: int  # fraction bits of the exponent
    cut_frac: int
    opacity_frac: int
    cut_min: int
    cut_max: int
    support: int
    alpha_frac: int
    alpha_max_l1: int
    t_max: int
    t_stop: int
    weight_drop: int
    depth_drop: int  # as `weight_drop`, for the weight of the depth sums
    colour_shift: int
    depth_shift: int
    plane_frac: int
    blend_frac: int
    segment_shift: int  # bits of the exponential's argument from here on select the segment, those below the place in it
    segment_rest: int
    slope_shift: int


@cache
def array_constants(config: AcceleratorConfig) -> ArrayConstants:
    """The constants of `config`."""
    n = config.formats
    support, per_segment = tables.support_exponent(config), (1 << n.cut.frac_bits) // n.exp2_segments
    return ArrayConstants(
        mean_frac=n.mean2d.frac_bits, sig_bits=n.conic.sig_bits, offset_frac=n.offset.frac_bits, offset_max=n.offset.raw_max,
        factor_frac=n.factor.frac_bits, grid=n.exponent.frac_bits, cut_frac=n.cut.frac_bits,
        opacity_frac=n.log2_opacity.frac_bits, cut_min=tables.log2_alpha_min(n), cut_max=n.cut.raw_max,
        support=1 << 30 if support is None else support, alpha_frac=n.alpha.frac_bits, alpha_max_l1=tables.alpha_max_l1(n),
        t_max=n.transmittance.raw_max, t_stop=tables.t_stop(n),
        weight_drop=n.transmittance.frac_bits - n.weight.frac_bits,
        colour_shift=n.weight.frac_bits + n.colour.frac_bits - n.accumulator.frac_bits,
        depth_drop=n.transmittance.frac_bits - config.depth_weight.frac_bits,
        depth_shift=config.depth_weight.frac_bits + n.depth.frac_bits - n.depth_accumulator.frac_bits,
        plane_frac=n.plane.frac_bits, blend_frac=n.blend_weight.frac_bits,
        segment_shift=(per_segment - 1).bit_length(), segment_rest=per_segment - 1,
        slope_shift=tables.EXP2_SLOPE_FRAC + n.cut.frac_bits - n.alpha.frac_bits,
    )


@compiled(inline="always")
def _nearest(x):
    return np.floor(x + 0.5)


@compiled(inline="always")
def _power(exponent):
    """2^exponent, float64."""
    return np.int64(np.int64(exponent + 1023) << 52).view(np.float64)


@compiled(inline="always", error_model="numpy")
def _row_range(falloff, v, k3, k):
    """First and last row (inclusive) where v^2 alone is within `falloff` (raw, with the fraction of `cut`); `v` is at row 8."""
    reach = np.sqrt(max(falloff * _power(-k.cut_frac) + _ROW_MARGIN, 0.0)) * _power(k.offset_frac)
    step = max(k3, 1.0) * _power(k.offset_frac - k.factor_frac)
    first, last = np.ceil((-reach - v) / step) + TILE // 2, np.floor((reach - v) / step) + TILE // 2
    return min(max(first, 0.0), TILE), max(min(last, TILE - 1.0), -1.0)


@compiled(error_model="numpy")
def _set_up(pairs, k):
    """Setup steps 1-6 of docs/array.md for the _BLOCK columns of `pairs`: computes FIRST..YY from L1..FALLOFF.

    Float64 holds every value exactly: integers below 2^53, and products of a significand and a distance, of at most 42 bits.
    Adding one half to such a product rounds only where the result is 0 in any case. An intersection that is dropped gets an
    empty range of rows, and its u and v are clamped so that nothing overflows.
    """
    to_offset, to_grid = _power(k.offset_frac - k.mean_frac), _power(k.grid - k.offset_frac - k.factor_frac)
    to_curve, to_falloff = _power(k.grid - 2 * k.factor_frac), _power(k.grid - 2 * k.offset_frac)
    unit, too_far = _power(k.factor_frac), tables.CENTRE_EXPONENT_MAX * _power(2 * k.offset_frac)
    lowest, highest = -k.offset_max - 1.0, k.offset_max + 0.0
    for j in range(_BLOCK):
        l1, l2, l3 = pairs[_L1 + j], pairs[_L2 + j], pairs[_L3 + j]
        dx, dy = pairs[_DX + j], pairs[_DY + j]
        u_all = _nearest(l1 * dx * to_offset) + _nearest(l2 * dy * to_offset)
        v_all = _nearest(l3 * dy * to_offset)
        u, v = min(max(u_all, lowest), highest), min(max(v_all, lowest), highest)
        square = u * u + v * v
        kept = (u == u_all) & (v == v_all) & (square < too_far)
        k1, k2, k3 = _nearest(l1 * unit), _nearest(l2 * unit), _nearest(l3 * unit)
        curve_xx, curve_xy = -_nearest(2.0 * k1 * k1 * to_curve), -_nearest(2.0 * k1 * k2 * to_curve)
        curve_yy = -_nearest(2.0 * (k2 * k2 + k3 * k3) * to_curve)
        gx = np.floor(curve_xx * 0.5) - _nearest(2.0 * u * k1 * to_grid)
        gy = np.floor(curve_yy * 0.5) - _nearest(2.0 * (u * k2 + v * k3) * to_grid)
        corner = 36.0 * (curve_xx + curve_yy) + 64.0 * curve_xy - 8.0 * (gx + gy) - _nearest(square * to_falloff)
        first, last = _row_range(pairs[_FALLOFF + j], v, k3, k)
        pairs[_FIRST + j], pairs[_LAST + j] = first if kept else TILE, last
        pairs[_CORNER + j], pairs[_SLOPE_X + j] = corner, gx - 8.0 * (curve_xx + curve_xy)
        pairs[_SLOPE_Y + j] = gy - 8.0 * (curve_yy + curve_xy)
        pairs[_XX + j], pairs[_XY + j], pairs[_YY + j] = curve_xx, curve_xy, curve_yy


@compiled
def _gather(pairs, splats, order, use, bank, taken, level, left, top, k):
    """Fills columns of `pairs` with those intersections from `taken` on that `bank` uses.

    All reads of splats are in this loop, so that their cache misses overlap. The arrays are taken out of the tuple before it,
    because inside a loop numba would count references to them.

    Returns the number of columns filled, and `taken` after the last intersection.
    """
    mean2d, conic, conic_exp, colour, depth = splats.mean2d, splats.conic, splats.conic_exp, splats.colour, splats.depth
    log2_opacity, count = splats.log2_opacity, 0
    while taken < len(order) and count < _BLOCK:
        i, j = order[taken], count
        count += use[taken] >> bank & 1
        taken += 1
        pairs[_DX + j], pairs[_DY + j] = left - mean2d[i, 0], top - mean2d[i, 1]
        for c in range(3):
            pairs[_L1 + c * _BLOCK + j] = conic[i, c] * _power(conic_exp[i, c] - k.sig_bits + 1)
            pairs[_PAIR_RED + c * _BLOCK + j] = colour[i, level, c]
        pairs[_PAIR_DEPTH + j] = depth[i]
        opacity = log2_opacity[i, level]
        pairs[_OPACITY + j], pairs[_CUT + j] = opacity, min(max(opacity - k.support, k.cut_min), k.cut_max)
        pairs[_FALLOFF + j] = pairs[_OPACITY + j] - pairs[_CUT + j]
    return count, taken


@compiled(inline="always")
def _composite(state, pairs, j, least, segments, k, far):
    """Composites intersection `j` over the rows of pixels that it reaches; with `far`, also into the depth sums.

    `through` is 1 - alpha, and `least` is its smallest value. `segments` hold the mantissa negated, so that shifting it right
    rounds alpha up. In pixels that are not active or have t >= 0, `through` has no meaning until it is masked.
    """
    one, half, to_cut = 1 << k.alpha_frac, 1 << (k.alpha_frac - 1), k.grid - k.cut_frac
    red, green, blue = np.int32(pairs[_PAIR_RED + j]), np.int32(pairs[_PAIR_GREEN + j]), np.int32(pairs[_PAIR_BLUE + j])
    depth = np.int32(pairs[_PAIR_DEPTH + j])
    base, slope, x = load(segments, 0), load(segments, LANES), ramp()
    curve_yy, cut, first = np.int32(pairs[_YY + j]), np.int32(pairs[_CUT + j]), np.int32(pairs[_FIRST + j])
    exponent = np.int32(pairs[_CORNER + j]) + (np.int32(pairs[_OPACITY + j]) << (k.grid - k.opacity_frac)) + (1 << to_cut >> 1)
    exponent += first * np.int32(pairs[_SLOPE_Y + j]) + (first * (first - 1) >> 1) * curve_yy
    slope_x = np.int32(pairs[_SLOPE_X + j]) + first * np.int32(pairs[_XY + j])
    e = exponent + x * slope_x + (x * (x - 1) >> 1) * np.int32(pairs[_XX + j])
    down = np.int32(pairs[_SLOPE_Y + j]) + first * curve_yy + x * np.int32(pairs[_XY + j])
    for y in range(first, np.int32(pairs[_LAST + j]) + 1):
        at, t = y * _PLANES * TILE, e >> to_cut
        e, down = e + down, down + curve_yy
        before = load(state, at + _T)
        active = (t >= cut) & (before >= k.t_stop)
        if not any_lane(active):
            continue
        segment = (t >> k.segment_shift) & (LANES - 1)
        mantissa = lookup(base, segment) - (lookup(slope, segment) * (t & k.segment_rest) >> k.slope_shift)
        through = choose(t >= 0, 0, (mantissa >> (0 - (t >> k.cut_frac) & 31)) + one)
        through = choose(active, choose(through >= least, through, least), one)
        after = before * through + half >> k.alpha_frac
        weight = (before >> k.weight_drop) - (after >> k.weight_drop)
        store(state, at + _T, after)
        _add(state, at + _RED, weight * red, k.colour_shift)
        _add(state, at + _GREEN, weight * green, k.colour_shift)
        _add(state, at + _BLUE, weight * blue, k.colour_shift)
        if far:
            _add(state, at + _FAR, ((before >> k.depth_drop) - (after >> k.depth_drop)) * depth, k.depth_shift)


@compiled(inline="always")
def _add(state, at, product, shift):
    """Adds `product`, shifted right by `shift` and rounded, to the row at `at`."""
    store(state, at, load(state, at) + (product + (1 << shift >> 1) >> shift))


@compiled
def _composite_background(state, background, k):
    for at in range(0, _STATE, _PLANES * TILE):
        weight = load(state, at + _T) >> k.weight_drop
        _add(state, at + _RED, weight * background[0], k.colour_shift)
        _add(state, at + _GREEN, weight * background[1], k.colour_shift)
        _add(state, at + _BLUE, weight * background[2], k.colour_shift)


@compiled
def _stopped(state, k):
    """Whether every pixel of the tile has stopped."""
    for at in range(0, _STATE, _PLANES * TILE):
        if any_lane(load(state, at + _T) >= k.t_stop):
            return False
    return True


@compiled(inline="always")
def _bank(
    splats, order, use, bank, level, outer, tile_x, tile_y, background, segments, k, pairs, state, fresh, final, far,
):
    """Composites intersections of one level of one tile into `state`: with `fresh`, the first ones, so that the state starts
    anew; with `final`, the last ones, so that the background follows. `pairs` is memory for a block and must hold finite
    numbers at first."""
    if fresh:
        rows = state.reshape(TILE, _PLANES * TILE)
        rows[:] = 0
        rows[:, _T : _T + TILE] = k.t_max
    least = 0 if outer else (1 << k.alpha_frac) - k.alpha_max_l1
    centre = (TILE // 2 << k.mean_frac) + (1 << (k.mean_frac - 1))
    left, top = (TILE * tile_x << k.mean_frac) + centre, (TILE * tile_y << k.mean_frac) + centre
    taken = 0
    while taken < len(order) and not _stopped(state, k):
        count, taken = _gather(pairs, splats, order, use, bank, taken, level, left, top, k)
        _set_up(pairs, k)
        for j in range(count):
            _composite(state, pairs, j, least, segments, k, far)
    if final:
        _composite_background(state, background, k)


@compiled
def _deep_bank(
    splats, order, use, bank, level, outer, tile_x, tile_y, background, segments, k, pairs, state, fresh=True, final=True,
):
    _bank(splats, order, use, bank, level, outer, tile_x, tile_y, background, segments, k, pairs, state, fresh, final, True)


@compiled
def _flat_bank(
    splats, order, use, bank, level, outer, tile_x, tile_y, background, segments, k, pairs, state, fresh=True, final=True,
):
    _bank(splats, order, use, bank, level, outer, tile_x, tile_y, background, segments, k, pairs, state, fresh, final, False)


@compiled(inline="always")
def _blend_weight(t, smoothstep, k):
    """Weight of the tile's second level, from the raw blend parameter."""
    if t < 0:
        return np.int64(0)
    if t >= 1 << k.plane_frac:
        return np.int64(1 << k.blend_frac)
    return smoothstep[t >> (k.plane_frac - tables.BLEND_INDEX_BITS)]


@compiled
def _blend(rows, outer_rows, plane, smoothstep, k):
    """Blends the rows of the second level into those of the first."""
    for y in range(TILE):
        for x in range(TILE):
            weight = _blend_weight(plane[0] + x * plane[1] + y * plane[2], smoothstep, k)
            for c in (_T, _RED, _GREEN, _BLUE, _FAR):
                a, b = np.int64(rows[y, c + x]), np.int64(outer_rows[y, c + x])
                rows[y, c + x] = a + (((b - a) * weight + (1 << k.blend_frac - 1)) >> k.blend_frac)


@compiled(inline="always")
def _finish(rows, at, colour, depth, transmittance):
    """Takes the pixels out of a tile's state."""
    transmittance[at], depth[at] = rows[:, _T : _T + TILE], rows[:, _FAR : _FAR + TILE]
    colour[at, :, :, 0], colour[at, :, :, 1] = rows[:, _RED : _RED + TILE], rows[:, _GREEN : _GREEN + TILE]
    colour[at, :, :, 2] = rows[:, _BLUE : _BLUE + TILE]


@compiled(inline="always")
def _render_tiles(bank_pass, begin, end, splats, work, background, segments, smoothstep, k, colour, depth, transmittance):
    pairs, state, outer_state = np.ones(_PAIR_ROWS * _BLOCK), np.empty(_STATE, np.int32), np.empty(_STATE, np.int32)
    rows, outer_rows = state.reshape(TILE, _PLANES * TILE), outer_state.reshape(TILE, _PLANES * TILE)
    for tile in range(begin, end):
        tile_x, tile_y, level, outer, blend = work.header[tile]
        order, use = work.order[work.start[tile] : work.start[tile + 1]], work.use[work.start[tile] : work.start[tile + 1]]
        bank_pass(splats, order, use, 0, level, outer > 0, tile_x, tile_y, background, segments, k, pairs, state)
        if blend:
            bank_pass(splats, order, use, 1, level + 1, True, tile_x, tile_y, background, segments, k, pairs, outer_state)
            _blend(rows, outer_rows, work.plane[tile], smoothstep, k)
        _finish(rows, tile, colour, depth, transmittance)


@compiled(nogil=True)
def render_tiles(_slice, begin, end, splats, work, background, segments, smoothstep, k, colour, depth, transmittance):
    """Renders tiles begin..end of `work`, an `array.TileWork`, into colour, depth and transmittance as in `array.Pixels`."""
    _render_tiles(_deep_bank, begin, end, splats, work, background, segments, smoothstep, k, colour, depth, transmittance)


@compiled(nogil=True)
def render_tiles_flat(_slice, begin, end, splats, work, background, segments, smoothstep, k, colour, depth, transmittance):
    """As `render_tiles`, without depth sums, which are 0."""
    _render_tiles(_flat_bank, begin, end, splats, work, background, segments, smoothstep, k, colour, depth, transmittance)


@compiled(inline="always")
def _visit_tiles(bank_pass, splats, work, places, background, segments, smoothstep, k, colour, depth, transmittance):
    pairs, states, done = np.ones(_PAIR_ROWS * _BLOCK), np.zeros((SUPER_TILES, 2, _STATE), np.int32), 0
    for visit in range(len(work.header)):
        tile_x, tile_y, level, outer, blend = work.header[visit]
        order, use = work.order[work.start[visit] : work.start[visit + 1]], work.use[work.start[visit] : work.start[visit + 1]]
        place, fresh, final = places[visit, 0], places[visit, 1] > 0, places[visit, 2] > 0
        state, next_state = states[place, 0], states[place, 1]
        bank_pass(
            splats, order, use, 0, level, outer > 0, tile_x, tile_y, background, segments, k, pairs, state, fresh, final)
        if blend:
            bank_pass(
                splats, order, use, 1, level + 1, True, tile_x, tile_y, background, segments, k, pairs, next_state, fresh,
                final)
        if final:
            rows = state.reshape(TILE, _PLANES * TILE)
            if blend:
                _blend(rows, next_state.reshape(TILE, _PLANES * TILE), work.plane[visit], smoothstep, k)
            _finish(rows, done, colour, depth, transmittance)
            done += 1


@compiled
def visit_tiles(splats, work, places, background, segments, smoothstep, k, colour, depth, transmittance):
    """Renders tiles in pieces, whose states are kept between them. A piece is a tile of `work`; `places` (pieces, 3) int64 hold
    for each where its tile's state is kept, whether it is the tile's first one and whether its last. Pixels appear in the order
    of the last pieces."""
    _visit_tiles(_deep_bank, splats, work, places, background, segments, smoothstep, k, colour, depth, transmittance)


@compiled
def visit_tiles_flat(splats, work, places, background, segments, smoothstep, k, colour, depth, transmittance):
    """As `visit_tiles`, without depth sums, which are 0."""
    _visit_tiles(_flat_bank, splats, work, places, background, segments, smoothstep, k, colour, depth, transmittance)
