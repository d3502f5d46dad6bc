"""Parts that forward and backward blending on the CPU share: one splat over a row of 16 pixels, the setup of a tile's
intersections, and the replay of a tile.

Functions take whole arrays and an index instead of slices of arrays, because making a slice costs two calls that count
references.
"""

from __future__ import annotations

import numpy as np

from golden.kernels import compiled
from spec.constants import EXPONENT_SCALE, LOG2E_HALF, T_STOP, TILE

kernel = compiled(nogil=True, fastmath=True, error_model="numpy")
inlined = compiled(forceinline=True, fastmath=True, error_model="numpy")
F = np.float32

ONE, HALF, ZERO, _T_STOP = F(1), F(0.5), F(0), F(T_STOP)
SCALE, LOG2E = F(EXPONENT_SCALE), F(2 * LOG2E_HALF)
_LOWEST = F(-16)  # lower bound of log2 alpha; every alpha that is composited lies above 2^-8
# 2^f on [-1/2, 1/2] with an error below 2e-7: the interpolating polynomial at Chebyshev nodes.
_EXP2 = tuple(map(F, np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 5, [-0.5, 0.5])
                  .convert(kind=np.polynomial.Polynomial).coef))

BLOCK = 32  # intersections set up at once; between blocks it is checked whether the tile has stopped
COLUMNS = 14  # numbers that are set up for an intersection
LANES = 2 * TILE  # numbers in a record: 16 alphas, then 16 shares T alpha


@inlined
def _exp2(t):
    """2^t for t in -126..127: the exponent's bits times a polynomial of the fraction."""
    whole = np.floor(t + HALF)
    f = t - whole
    c0, c1, c2, c3, c4, c5 = _EXP2
    power = np.int32((np.int32(whole) + np.int32(127)) << 23).view(np.float32)
    return power * (c0 + f * (c1 + f * (c2 + f * (c3 + f * (c4 + f * c5)))))


@inlined
def alpha_of(before, u, room, top, alpha_max):
    """Alpha of a pixel; 0 where the splat does not reach it or the pixel has stopped."""
    square = u * u
    alpha = min(_exp2(max(top - square, _LOWEST)), alpha_max)
    return alpha if (square <= room) & (before >= _T_STOP) else ZERO


@inlined
def _record(records, at, light, y, u, l1, room, top, alpha_max):
    """Composites one splat over a row of pixels and keeps alphas and shares as record `at`."""
    for x in range(TILE):
        before = light[y, x]
        alpha = alpha_of(before, u + F(x) * l1, room, top, alpha_max)
        share = before * alpha
        light[y, x] = before - share
        records[at, x], records[at, TILE + x] = alpha, share


@kernel
def live_rows(light, live):
    """Marks the rows in which a pixel has not stopped yet; returns whether there is such a row."""
    some = False
    for y in range(TILE):
        most = ZERO
        for x in range(TILE):
            most = max(most, light[y, x])
        live[y] = most >= _T_STOP
        some |= live[y]
    return some


@kernel
def set_up(splats, left, top, table, pairs):
    """Sets up the intersections of a block, one in each row of `pairs`.

    Gathering them here lets the loads overlap; between loops over pixels, each load would wait for the one before.

    The columns are those of the table, except for these. 0, 1: offset of the tile's first pixel; 11: u there; 12, 13: first and
    last row that the splat meets.
    """
    for j in range(len(splats)):
        i = splats[j]
        dx, dy, rim = left - table[i, 0], top - table[i, 1], table[i, 11]
        for c in range(2, 11):
            pairs[j, c] = table[i, c]
        pairs[j, 0], pairs[j, 1], pairs[j, 11] = dx, dy, table[i, 2] * dx + table[i, 3] * dy
        pairs[j, 12], pairs[j, 13] = max(np.ceil(-rim - dy), ZERO), min(np.floor(rim - dy), F(TILE - 1))


@inlined
def row_of(pairs, j, y):
    """For row y: u at its first pixel, the rest of the exponent's limit (-1 if no pixel is reached), and log2 alpha without
    u."""
    v = pairs[j, 4] * (pairs[j, 1] + F(y))
    u, room = pairs[j, 11] + pairs[j, 3] * F(y), pairs[j, 5] - v * v
    last = u + F(TILE - 1) * pairs[j, 2]
    nearest = u if u >= 0 else (last if last <= 0 else ZERO)
    return u, (room if nearest * nearest <= room else -ONE), pairs[j, 6] - v * v


@kernel
def clear(light, tile_x, tile_y, width, height):
    """Sets the transmittance to 1 in the pixels of the frame and to 0 beyond the frame's right and lower edges."""
    light[:] = ZERO
    light[: min(TILE, height - tile_y * TILE), : min(TILE, width - tile_x * TILE)] = ONE


@kernel
def last_used(splats, left, top, table, alpha_max, light, pairs, live):
    """Of a block within which the tile stopped, the number of intersections used, given the transmittance before the block."""
    records = np.empty((1, LANES), np.float32)
    set_up(splats, left, top, table, pairs)
    for j in range(len(splats)):
        for y in range(int(pairs[j, 12]), int(pairs[j, 13]) + 1):
            u, room, top_alpha = row_of(pairs, j, y)
            if room >= 0:
                _record(records, 0, light, y, u, pairs[j, 2], room, top_alpha, alpha_max)
        if not live_rows(light, live):
            return j + 1
    return len(splats)


@kernel
def _twice(records, row_of_record):
    """Buffers of twice the size with the same contents."""
    larger, rows = np.empty((2 * len(records), LANES), np.float32), np.empty(2 * len(records), np.uint8)
    larger[: len(records)], rows[: len(records)] = records, row_of_record
    return larger, rows


@kernel
def replay(splats, left, top, table, alpha_max, light, pairs, live, records, row_of_record, first_record):
    """Blends a tile again and keeps a record of each row of pixels; the records of intersection n start at first_record[n].

    Returns the buffers of records and of their rows, which are larger ones if those given were too small.
    """
    at = 0
    for begin in range(0, len(splats), BLOCK):
        while at + BLOCK * TILE > len(records):
            records, row_of_record = _twice(records, row_of_record)
        live_rows(light, live)
        block = splats[begin : begin + BLOCK]
        set_up(block, left, top, table, pairs)
        for j in range(len(block)):
            first_record[begin + j] = at
            for y in range(int(pairs[j, 12]), int(pairs[j, 13]) + 1):
                u, room, top_alpha = row_of(pairs, j, y)
                if (room >= 0) & live[y]:
                    _record(records, at, light, y, u, pairs[j, 2], room, top_alpha, alpha_max)
                    row_of_record[at] = y
                    at += 1
    first_record[len(splats)] = at
    return records, row_of_record


@kernel
def replay_tile(
    tile, tiles_x, width, height, splats, table, alpha_max, light, pairs, live, records, row_of_record, first_record
):
    """Replays the tile with this number from its start; returns the centre of its first pixel, and what `replay` returns."""
    tile_y, tile_x = tile // tiles_x, tile % tiles_x
    left, top = F(tile_x * TILE) + HALF, F(tile_y * TILE) + HALF
    clear(light, tile_x, tile_y, width, height)
    records, row_of_record = replay(
        splats, left, top, table, alpha_max, light, pairs, live, records, row_of_record, first_record)
    return left, top, records, row_of_record


@kernel
def scratch(used):
    """Buffers for replays: transmittance, intersections, live rows, records, their rows, and the first record of each
    intersection."""
    records, longest = 4 * BLOCK * TILE, 0
    for count in used:
        longest = max(longest, count)
    return (np.empty((TILE, TILE), np.float32), np.empty((BLOCK, COLUMNS), np.float32), np.empty(TILE, np.bool_),
            np.empty((records, LANES), np.float32), np.empty(records, np.uint8), np.empty(longest + 1, np.int64))
