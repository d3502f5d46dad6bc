"""Blending on the CPU, forward and backward: float32, a tile at a time, splat by splat over rows of 16 pixels as vectors.

The backward pass divides by nothing. A tile's forward pass is repeated, keeping each row's alphas and shares T alpha; then,
back to front, dL/dalpha = T (g . c - G), with g the gradient at the pixel and G that of what lies behind, composited from
transmittance 1: G <- G + alpha (g . c - G), starting from the background. Alphas of 1 and transmittances of 0 need no care.
Each pair of a splat and a tile has its own gradients, summed per splat in the order of pairs: nothing depends on threads.
"""

from __future__ import annotations

import numba
import numpy as np

from golden.msv2_ref.parallel import SLICES
from golden.training.pairs import TileLists
from golden.training.slices import run_slices
from spec.constants import EXPONENT_SCALE, LOG2E_HALF, T_STOP, TILE

_kernel = numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
_inlined = numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
_F = np.float32

_ONE, _HALF, _ZERO, _T_STOP = _F(1), _F(0.5), _F(0), _F(T_STOP)
_SCALE, _LOG2E = _F(EXPONENT_SCALE), _F(2 * LOG2E_HALF)
_LOWEST = _F(-16)  # of log2 alpha; every alpha that shows lies above 2^-8
# 2^f on [-1/2, 1/2] to 2e-7: the interpolating polynomial at Chebyshev nodes.
_EXP2 = tuple(map(_F, np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 5, [-0.5, 0.5])
                  .convert(kind=np.polynomial.Polynomial).coef))

_BLOCK = 32  # pairs set up at once; whether a tile has stopped is looked at between blocks
_LANES = 2 * TILE  # of a record: alphas, then shares
_T, _RED, _GREEN, _BLUE, _FAR = range(0, 5 * TILE, TILE)
_BEHIND = _T  # the backward pass keeps G where the forward pass keeps T, and gradients in place of sums

SUMS = 10
"""Gradients of a pair: opacity (times it), mean2d 2, factor 3, colour 3, depth."""


@_kernel
def _pack(_slice, begin, end, mean2d, factor, opacity, colour, depth, q_max, table):
    """One row a splat: mean, conic factor scaled to exponents of 2, its reach in y, limit, log2 opacity, colour, depth."""
    for i in range(begin, end):
        table[i, 0], table[i, 1] = mean2d[i, 0], mean2d[i, 1]
        for c in range(3):
            table[i, 2 + c], table[i, 7 + c] = factor[i, c] * _SCALE, colour[i, c]
        table[i, 5], table[i, 6] = q_max[i] * _LOG2E, np.log2(opacity[i])
        table[i, 10] = depth[i]
        table[i, 11] = np.sqrt(table[i, 5]) / table[i, 4]


@_inlined
def _exp2(t):
    """2^t for t in -126..127: the exponent's bits times a polynomial of the fraction."""
    whole = np.floor(t + _HALF)
    f = t - whole
    c0, c1, c2, c3, c4, c5 = _EXP2
    power = np.int32((np.int32(whole) + np.int32(127)) << 23).view(np.float32)
    return power * (c0 + f * (c1 + f * (c2 + f * (c3 + f * (c4 + f * c5)))))


@_inlined
def _alpha(before, u, room, top, alpha_max):
    """A pixel's alpha; 0 where the splat does not reach it or the pixel has stopped."""
    square = u * u
    alpha = min(_exp2(max(top - square, _LOWEST)), alpha_max)
    return alpha if (square <= room) & (before >= _T_STOP) else _ZERO


@_inlined
def _composite(rows, y, u, l1, room, top, alpha_max, red, green, blue, depth):
    """One splat over row `y`: u at its first pixel and l1 its step; `room` is what the row leaves of the exponent's limit."""
    for x in range(TILE):
        before = rows[y, _T + x]
        share = before * _alpha(before, u + _F(x) * l1, room, top, alpha_max)
        rows[y, _T + x] = before - share
        rows[y, _RED + x] += share * red
        rows[y, _GREEN + x] += share * green
        rows[y, _BLUE + x] += share * blue
        rows[y, _FAR + x] += share * depth


@_inlined
def _record(record, light, y, u, l1, room, top, alpha_max):
    """As `_composite`, keeping alphas and shares."""
    for x in range(TILE):
        before = light[y, x]
        alpha = _alpha(before, u + _F(x) * l1, room, top, alpha_max)
        share = before * alpha
        light[y, x] = before - share
        record[x], record[TILE + x] = alpha, share


@_kernel
def _live_rows(light, live):
    """Mark the rows in which a pixel still takes light; whether there is one."""
    some = False
    for y in range(TILE):
        most = _ZERO
        for x in range(TILE):
            most = max(most, light[y, x])
        live[y] = most >= _T_STOP
        some |= live[y]
    return some


@_kernel
def _set_up(splats, left, top, table, pairs):
    """A block's pairs, one a row: here no load waits for another, as they do between loops over pixels.

    Columns: as the table, but for 0, 1: the offset of the tile's first pixel; 11: u there; 12, 13: first and last row met.
    """
    for j in range(len(splats)):
        row = table[splats[j]]
        dx, dy, rim = left - row[0], top - row[1], row[11]
        for c in range(2, 11):
            pairs[j, c] = row[c]
        pairs[j, 0], pairs[j, 1], pairs[j, 11] = dx, dy, row[2] * dx + row[3] * dy
        pairs[j, 12], pairs[j, 13] = max(np.ceil(-rim - dy), _ZERO), min(np.floor(rim - dy), _F(TILE - 1))


@_inlined
def _row(pair, y):
    """u at the row's first pixel, v, and what the row leaves of the limit; the last is negative where no pixel is reached."""
    v = pair[4] * (pair[1] + _F(y))
    u, room = pair[11] + pair[3] * _F(y), pair[5] - v * v
    last = u + _F(TILE - 1) * pair[2]
    nearest = u if u >= 0 else (last if last <= 0 else _ZERO)
    return u, v, (room if nearest * nearest <= room else -_ONE)


@_kernel
def _clear(light, tile_x, tile_y, width, height):
    """Full light in the pixels of the frame, none beyond its right and lower edges."""
    light[:] = _ZERO
    light[: min(TILE, height - tile_y * TILE), : min(TILE, width - tile_x * TILE)] = _ONE


@_kernel
def _last_used(splats, left, top, table, alpha_max, light, pairs, live):
    """Of a block after which the tile has stopped, given the light before it: how many pairs it took."""
    record = np.empty(_LANES, np.float32)
    _set_up(splats, left, top, table, pairs)
    for j in range(len(splats)):
        pair = pairs[j]
        for y in range(int(pair[12]), int(pair[13]) + 1):
            u, v, room = _row(pair, y)
            if room >= 0:
                _record(record, light, y, u, pair[2], room, pair[6] - v * v, alpha_max)
        if not _live_rows(light, live):
            return j + 1
    return len(splats)


@_kernel
def _draw(splats, left, top, table, alpha_max, rows, before, pairs, live):
    """One tile, `rows` cleared: pairs used before all its pixels stopped, and rows of pixels gone through."""
    visited, used, light = 0, len(splats), rows[:, _T : _T + TILE]
    for begin in range(0, len(splats), _BLOCK):
        if not _live_rows(light, live):
            block = splats[begin - _BLOCK : begin]
            used = begin - _BLOCK + _last_used(block, left, top, table, alpha_max, before, pairs, live)
            break
        before[:] = light
        block = splats[begin : begin + _BLOCK]
        _set_up(block, left, top, table, pairs)
        for j in range(len(block)):
            pair = pairs[j]
            for y in range(int(pair[12]), int(pair[13]) + 1):
                u, v, room = _row(pair, y)
                if (room >= 0) & live[y]:
                    visited += 1
                    _composite(rows, y, u, pair[2], room, pair[6] - v * v, alpha_max, pair[7], pair[8], pair[9], pair[10])
    else:
        if len(splats) and not _live_rows(light, live):
            begin = (len(splats) - 1) // _BLOCK * _BLOCK
            used = begin + _last_used(splats[begin:], left, top, table, alpha_max, before, pairs, live)
    return used, visited


@_kernel
def _forward(_slice, begin, _end, start, splat, table, alpha_max, background, tiles_x, image, far, light, used, visited):
    """The tiles of a slice, every SLICES-th: neighbours, which are alike, fall to different threads."""
    rows, before = np.empty((TILE, 5 * TILE), np.float32), np.empty((TILE, TILE), np.float32)
    pairs, live = np.empty((_BLOCK, 14), np.float32), np.empty(TILE, np.bool_)
    height, width = far.shape
    for tile in range(begin, len(used), SLICES):
        tile_y, tile_x = tile // tiles_x, tile % tiles_x
        rows[:] = _ZERO
        _clear(rows[:, _T : _T + TILE], tile_x, tile_y, width, height)
        left, top = _F(tile_x * TILE) + _HALF, _F(tile_y * TILE) + _HALF
        used[tile], visited[tile] = _draw(
            splat[start[tile] : start[tile + 1]], left, top, table, alpha_max, rows, before, pairs, live)
        for y in range(min(TILE, height - tile_y * TILE)):
            row = tile_y * TILE + y
            for x in range(min(TILE, width - tile_x * TILE)):
                column, rest = tile_x * TILE + x, rows[y, _T + x]
                far[row, column], light[row, column] = rows[y, _FAR + x], rest
                image[row, column, 0] = rows[y, _RED + x] + rest * background[0]
                image[row, column, 1] = rows[y, _GREEN + x] + rest * background[1]
                image[row, column, 2] = rows[y, _BLUE + x] + rest * background[2]


@_kernel
def _replay(splats, left, top, table, alpha_max, light, pairs, live, records, record_row, first_record):
    """One tile again, keeping a record of each row of pixels gone through: those of pair n start at first_record[n]."""
    at = 0
    for begin in range(0, len(splats), _BLOCK):
        _live_rows(light, live)
        block = splats[begin : begin + _BLOCK]
        _set_up(block, left, top, table, pairs)
        for j in range(len(block)):
            pair = pairs[j]
            first_record[begin + j] = at
            for y in range(int(pair[12]), int(pair[13]) + 1):
                u, v, room = _row(pair, y)
                if (room >= 0) & live[y]:
                    _record(records[at], light, y, u, pair[2], room, pair[6] - v * v, alpha_max)
                    record_row[at] = y
                    at += 1
    first_record[len(splats)] = at


@_inlined
def _accumulate(rows, y, record, u, l1, dx, dy, v, alpha_max, red, green, blue, depth, sums):
    """One splat over a row, backward: updates G and adds to the vectors of sums."""
    for x in range(TILE):
        alpha, share, behind = record[x], record[TILE + x], rows[y, _BEHIND + x]
        g_red, g_green, g_blue, g_far = rows[y, _RED + x], rows[y, _GREEN + x], rows[y, _BLUE + x], rows[y, _FAR + x]
        beyond = g_red * red + g_green * green + g_blue * blue + g_far * depth - behind
        rows[y, _BEHIND + x] = behind + alpha * beyond
        w = share * beyond if alpha < alpha_max else _ZERO
        wu = w * (u + _F(x) * l1)
        sums[x] += w
        sums[TILE + x] += wu
        sums[2 * TILE + x] += w * v
        sums[3 * TILE + x] += wu * (dx + _F(x))
        sums[4 * TILE + x] += wu * dy
        sums[5 * TILE + x] += w * (v * dy)
        sums[6 * TILE + x] += share * g_red
        sums[7 * TILE + x] += share * g_green
        sums[8 * TILE + x] += share * g_blue
        sums[9 * TILE + x] += share * g_far


@_kernel
def _finish(pair, sums, out):
    """A pair's gradients from its vectors of sums; w is dL/dalpha times alpha, hence minus dL/dq."""
    total = np.empty(SUMS, np.float32)
    for k in range(SUMS):
        part = _ZERO
        for x in range(TILE):
            part += sums[k * TILE + x]
        total[k] = part
    slope = _ONE / _SCALE
    out[0] = total[0]
    out[1] = (total[1] * pair[2]) / _LOG2E * _F(2)
    out[2] = (total[1] * pair[3] + total[2] * pair[4]) / _LOG2E * _F(2)
    out[3], out[4], out[5] = -slope * total[3], -slope * total[4], -slope * total[5]
    for k in range(6, SUMS):
        out[k] = total[k]


@_kernel
def _back(splats, numbers, left, top, table, alpha_max, rows, pairs, records, record_row, first_record, sums, gradient):
    """One tile's records back to front."""
    for begin in range((len(splats) - 1) // _BLOCK * _BLOCK, -1, -_BLOCK):
        block = splats[begin : begin + _BLOCK]
        _set_up(block, left, top, table, pairs)
        for j in range(len(block) - 1, -1, -1):
            pair, n = pairs[j], begin + j
            sums[:] = _ZERO
            for r in range(first_record[n], first_record[n + 1]):
                y = record_row[r]
                dy = pair[1] + _F(y)
                _accumulate(rows, y, records[r], pair[11] + pair[3] * _F(y), pair[2], pair[0], dy, pair[4] * dy, alpha_max,
                            pair[7], pair[8], pair[9], pair[10], sums)
            _finish(pair, sums, gradient[numbers[n]])


@_kernel
def _scratch(begin, used, visited):
    """Buffers for the replay of a slice's tiles: light, pairs, live rows, records, their rows, first record of a pair."""
    most, longest = 0, 0
    for tile in range(begin, len(used), SLICES):
        most, longest = max(most, visited[tile]), max(longest, used[tile])
    return (np.empty((TILE, TILE), np.float32), np.empty((_BLOCK, 14), np.float32), np.empty(TILE, np.bool_),
            np.empty((most, _LANES), np.float32), np.empty(most, np.uint8), np.empty(longest + 1, np.int64))


@_kernel
def _backward(
    _slice, begin, _end, start, splat, number, table, alpha_max, background, tiles_x, used, visited, g_image, g_far, g_light,
    gradient
):
    light, pairs, live, records, record_row, first_record = _scratch(begin, used, visited)
    rows, sums = np.empty((TILE, 5 * TILE), np.float32), np.empty(SUMS * TILE, np.float32)
    height, width = g_far.shape
    for tile in range(begin, len(used), SLICES):
        tile_y, tile_x = tile // tiles_x, tile % tiles_x
        left, top = _F(tile_x * TILE) + _HALF, _F(tile_y * TILE) + _HALF
        _clear(light, tile_x, tile_y, width, height)
        splats = splat[start[tile] : start[tile] + used[tile]]
        _replay(splats, left, top, table, alpha_max, light, pairs, live, records, record_row, first_record)
        rows[:] = _ZERO
        for y in range(min(TILE, height - tile_y * TILE)):
            row = tile_y * TILE + y
            for x in range(min(TILE, width - tile_x * TILE)):
                column = tile_x * TILE + x
                red, green, blue = g_image[row, column, 0], g_image[row, column, 1], g_image[row, column, 2]
                rows[y, _RED + x], rows[y, _GREEN + x], rows[y, _BLUE + x] = red, green, blue
                rows[y, _FAR + x] = g_far[row, column]
                rows[y, _BEHIND + x] = (
                    g_light[row, column] + red * background[0] + green * background[1] + blue * background[2])
        numbers = number[start[tile] : start[tile + 1]]
        _back(splats, numbers, left, top, table, alpha_max, rows, pairs, records, record_row, first_record, sums, gradient)
        for n in range(used[tile], len(numbers)):
            gradient[numbers[n]] = _ZERO


@_kernel
def _reduce(_slice, begin, end, order, room, opacity, gradient, g_mean2d, g_factor, g_opacity, g_colour, g_depth):
    """Sums of the pairs' gradients, splat by splat."""
    total = np.empty(SUMS, np.float64)
    for k in range(begin, end):
        total[:] = 0
        for p in range(room[k], room[k + 1]):
            for c in range(SUMS):
                total[c] += gradient[p, c]
        i = order[k]
        g_opacity[i], g_depth[i] = total[0] / opacity[i], total[9]
        g_mean2d[i, 0], g_mean2d[i, 1] = total[1], total[2]
        for c in range(3):
            g_factor[i, c], g_colour[i, c] = total[3 + c], total[6 + c]


@_kernel
def _usage(
    _slice, begin, _end, start, splat, number, table, alpha_max, tiles_x, used, visited, width, height, weight, strongest
):
    """Per pair the sum of its shares, per pixel the splat of the largest share, the nearer of equals."""
    light, pairs, live, records, record_row, first_record = _scratch(begin, used, visited)
    largest = np.empty((TILE, TILE), np.float32)
    for tile in range(begin, len(used), SLICES):
        tile_y, tile_x = tile // tiles_x, tile % tiles_x
        left, top = _F(tile_x * TILE) + _HALF, _F(tile_y * TILE) + _HALF
        _clear(light, tile_x, tile_y, width, height)
        splats, first = splat[start[tile] : start[tile] + used[tile]], start[tile]
        _replay(splats, left, top, table, alpha_max, light, pairs, live, records, record_row, first_record)
        largest[:] = _ZERO
        for n in range(used[tile]):
            total = _ZERO
            for r in range(first_record[n], first_record[n + 1]):
                y = record_row[r]
                for x in range(TILE):
                    share = records[r, TILE + x]
                    total += share
                    if share > largest[y, x]:
                        largest[y, x], strongest[tile, y, x] = share, splats[n]
            weight[number[first + n]] = total
        for n in range(first + used[tile], start[tile + 1]):
            weight[number[n]] = _ZERO


@_kernel
def _count_tiles(start, used, splat, tiles):
    for tile in range(len(used)):
        for e in range(start[tile], start[tile] + used[tile]):
            tiles[splat[e]] += 1


@_kernel
def _sum_usage(order, room, weight_of_pair, strongest, weight, dominated):
    for k in range(len(order)):
        total = 0.0
        for p in range(room[k], room[k + 1]):
            total += weight_of_pair[p]
        weight[order[k]] = total
    for i in strongest:
        if i >= 0:
            dominated[i] += 1


class Blending:
    """One view's blending: made by the forward pass, kept for the backward pass and for what is asked about it.

    Attributes:
        image: (H, W, 3), background included.
        depth_sum: (H, W) sum of T alpha z.
        transmittance: (H, W).
        tiles: (M,) int32, tiles that used each splat before they stopped.
    """

    def __init__(
        self, splats: tuple[np.ndarray, ...], q_max: np.ndarray, lists: TileLists, size: tuple[int, int], alpha_max: float,
        background: tuple[float, float, float]
    ) -> None:
        """Forward.

        Args:
            splats: float32 mean2d (M, 2), factor (M, 3), opacity (M,), colour (M, 3), depth (M,).
            size: width and height.
        """
        width, height = size
        self.lists, self.opacity, self.size = lists, splats[2], size
        self.alpha_max, self.background = _F(alpha_max), np.asarray(background, _F)
        self.tiles_x = -(-width // TILE)
        self.table = np.empty((len(q_max), 12), _F)
        run_slices(_pack, len(q_max), *splats, q_max, self.table)
        self.image, self.depth_sum, self.transmittance = (np.empty((height, width, *c), _F) for c in ((3,), (), ()))
        self.used, self.visited = np.empty((2, len(lists.start) - 1), np.int64)
        run_slices(_forward, SLICES, lists.start, lists.splat, self.table, self.alpha_max, self.background, self.tiles_x,
                   self.image, self.depth_sum, self.transmittance, self.used, self.visited)
        self.tiles = np.zeros(len(q_max), np.int32)
        _count_tiles(lists.start, self.used, lists.splat, self.tiles)

    def backward(self, g_image: np.ndarray, g_depth_sum: np.ndarray, g_transmittance: np.ndarray) -> tuple[np.ndarray, ...]:
        """Gradients of mean2d, factor, opacity, colour and depth, given those of the three results."""
        lists, count = self.lists, len(self.table)
        gradient = np.empty((len(lists.splat), SUMS), _F)
        run_slices(_backward, SLICES, lists.start, lists.splat, lists.pair, self.table, self.alpha_max, self.background,
                   self.tiles_x, self.used, self.visited, g_image, g_depth_sum, g_transmittance, gradient)
        results = tuple(np.empty((count, *c), _F) for c in ((2,), (3,), (), (3,), ()))
        run_slices(_reduce, count, lists.order, lists.room, self.opacity, gradient, *results)
        return results

    def usage(self) -> tuple[np.ndarray, np.ndarray]:
        """(M,) int32 pixels whose largest T alpha is the splat's, and (M,) float32 sum of its T alpha over pixels."""
        lists, count = self.lists, len(self.table)
        weight_of_pair = np.empty(len(lists.splat), _F)
        strongest = np.full((len(self.used), TILE, TILE), -1, np.int32)
        run_slices(_usage, SLICES, lists.start, lists.splat, lists.pair, self.table, self.alpha_max, self.tiles_x, self.used,
                   self.visited, *self.size, weight_of_pair, strongest)
        weight, dominated = np.empty(count, _F), np.zeros(count, np.int32)
        _sum_usage(lists.order, lists.room, weight_of_pair, strongest.ravel(), weight, dominated)
        return dominated, weight
