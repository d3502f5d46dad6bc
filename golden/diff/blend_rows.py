"""What forward and backward blending on the CPU share: a splat's row of 16 pixels, pairs of a tile, and a tile's replay.

Arrays are passed with an index throughout: a view costs two calls to count references.
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
_LOWEST = F(-16)  # of log2 alpha; every alpha that shows lies above 2^-8
# 2^f on [-1/2, 1/2] to 2e-7: the interpolating polynomial at Chebyshev nodes.
_EXP2 = tuple(map(F, np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 5, [-0.5, 0.5])
                  .convert(kind=np.polynomial.Polynomial).coef))

BLOCK = 32  # pairs set up at once; whether a tile has stopped is looked at between blocks
COLUMNS = 14  # of a block's pairs
LANES = 2 * TILE  # of a record: alphas, then shares


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
    """A pixel's alpha; 0 where the splat does not reach it or the pixel has stopped."""
    square = u * u
    alpha = min(_exp2(max(top - square, _LOWEST)), alpha_max)
    return alpha if (square <= room) & (before >= _T_STOP) else ZERO


@inlined
def _record(records, at, light, y, u, l1, room, top, alpha_max):
    """One splat over a row of pixels, keeping alphas and shares as record `at`."""
    for x in range(TILE):
        before = light[y, x]
        alpha = alpha_of(before, u + F(x) * l1, room, top, alpha_max)
        share = before * alpha
        light[y, x] = before - share
        records[at, x], records[at, TILE + x] = alpha, share


@kernel
def live_rows(light, live):
    """Mark the rows in which a pixel still takes light; whether there is one."""
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
    """A block's pairs, one a row: here no load waits for another, as they do between loops over pixels.

    Columns: as the table, but for 0, 1: the offset of the tile's first pixel; 11: u there; 12, 13: first and last row met.
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
    """Of row y: u at its first pixel, the rest of the limit, log2 alpha without u; the rest is -1 where no pixel is reached."""
    v = pairs[j, 4] * (pairs[j, 1] + F(y))
    u, room = pairs[j, 11] + pairs[j, 3] * F(y), pairs[j, 5] - v * v
    last = u + F(TILE - 1) * pairs[j, 2]
    nearest = u if u >= 0 else (last if last <= 0 else ZERO)
    return u, (room if nearest * nearest <= room else -ONE), pairs[j, 6] - v * v


@kernel
def clear(light, tile_x, tile_y, width, height):
    """Full light in the pixels of the frame, none beyond its right and lower edges."""
    light[:] = ZERO
    light[: min(TILE, height - tile_y * TILE), : min(TILE, width - tile_x * TILE)] = ONE


@kernel
def last_used(splats, left, top, table, alpha_max, light, pairs, live):
    """Of a block after which the tile has stopped, given the light before it: how many pairs it took."""
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
    """One tile again, keeping a record of each row of pixels gone through: those of pair n start at first_record[n].

    Returns the buffers of records and of their rows, larger ones where those given did not do.
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
def scratch(used):
    """Buffers for replays: light, pairs, live rows, records, their rows, first record of a pair."""
    records, longest = 4 * BLOCK * TILE, 0
    for count in used:
        longest = max(longest, count)
    return (np.empty((TILE, TILE), np.float32), np.empty((BLOCK, COLUMNS), np.float32), np.empty(TILE, np.bool_),
            np.empty((records, LANES), np.float32), np.empty(records, np.uint8), np.empty(longest + 1, np.int64))
