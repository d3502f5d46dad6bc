"""Blends one level of a view in float32, and the gradient of its error with respect to opacities and colours.

Tiles are 16x16 pixels; a splat is blended row by row. The backward pass goes from front to back as well: it knows the finished
pixel, so what lies behind a splat is the finished pixel less what has been blended so far.
"""

from __future__ import annotations

import numpy as np

from golden.kernels import compiled
from spec.constants import T_STOP, TILE

_kernel = compiled(nogil=True, fastmath=True, error_model="numpy")
_inlined = compiled(forceinline=True, fastmath=True, error_model="numpy")
F = np.float32
_ZERO, _ONE, _HALF, _STOP, _OPAQUE = F(0), F(1), F(0.5), F(T_STOP), F(1 - 1e-3)
_EXP2 = tuple(map(F, np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 4, [-0.5, 0.5])
                  .convert(kind=np.polynomial.Polynomial).coef))
"""2^f for f in -1/2..1/2, with an error below 1e-5."""

LOOK = 5
"""Columns of what a level gives a splat: log2 of its opacity (0), the largest exponent that it covers (1), its colour (2-4)."""


@_inlined
def _exp2(t):
    """2^t for t in -126..127."""
    whole = np.floor(t + _HALF)
    f = t - whole
    c0, c1, c2, c3, c4 = _EXP2
    power = np.int32((np.int32(whole) + np.int32(127)) << 23).view(np.float32)
    return power * (c0 + f * (c1 + f * (c2 + f * (c3 + f * c4))))


@_inlined
def _row(geometry, look, i, left, y):
    """For row y of a tile: u at its first pixel, the rest of the exponent's limit (below 0: no pixel), log2 alpha without u."""
    dx, dy = left - geometry[i, 0], y - geometry[i, 1]
    v, u = geometry[i, 4] * dy, geometry[i, 2] * dx + geometry[i, 3] * dy
    room = look[i, 1] - v * v
    last = u + F(TILE - 1) * geometry[i, 2]
    nearest = u if u >= 0 else (last if last <= 0 else _ZERO)
    return u, (room if nearest * nearest <= room else -_ONE), look[i, 0] - v * v


@_inlined
def _alpha(u, room, top, alpha_max):
    square = u * u
    alpha = min(_exp2(max(top - square, F(-16))), alpha_max)
    return alpha if square <= room else _ZERO


@_inlined
def _rows_of(geometry, look, i, top):
    """First and last row of a tile whose first row is at `top` that a splat meets."""
    rim = np.sqrt(max(look[i, 1], _ZERO)) / geometry[i, 4]
    dy = top - geometry[i, 1]
    return int(max(np.ceil(-rim - dy), _ZERO)), int(min(np.floor(rim - dy), F(TILE - 1)))


@_kernel
def draw(geometry, look, start, splat, width, height, alpha_max, image, weight):
    """Blends a level on black.

    Args:
        geometry, start, splat: those of a LevelView.
        look: (M, LOOK) float32; a negative exponent leaves a splat out.
        alpha_max: float32, the bound on alpha.
        image: (height, width, 4) float32, written: red, green, blue and the transmittance.
        weight: (M,) float32, increased by the sum of T alpha over the pixels; empty: not wanted.
    """
    tiles_x = (width + TILE - 1) // TILE
    light = np.empty((TILE, TILE), np.float32)
    red, green, blue = np.empty_like(light), np.empty_like(light), np.empty_like(light)
    for tile in range(len(start) - 1):
        left, top = F(tile % tiles_x * TILE + 0.5), F(tile // tiles_x * TILE + 0.5)
        light[:], red[:], green[:], blue[:] = _ONE, _ZERO, _ZERO, _ZERO
        for e in range(start[tile], start[tile + 1]):
            i = splat[e]
            if look[i, 1] < 0:
                continue
            first, last = _rows_of(geometry, look, i, top)
            total = _ZERO
            for y in range(first, last + 1):
                u, room, level = _row(geometry, look, i, left, top + F(y))
                if room < 0:
                    continue
                for x in range(TILE):
                    before = light[y, x]
                    share = before * _alpha(u + F(x) * geometry[i, 2], room, level, alpha_max)
                    light[y, x] = before - share
                    red[y, x] += share * look[i, 2]
                    green[y, x] += share * look[i, 3]
                    blue[y, x] += share * look[i, 4]
                    total += share
            if len(weight):
                weight[i] += total
            if (e & 31) == 31 and light.max() < _STOP:
                break
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        for y in range(min(TILE, height - y0)):
            for x in range(min(TILE, width - x0)):
                image[y0 + y, x0 + x, 0], image[y0 + y, x0 + x, 1] = red[y, x], green[y, x]
                image[y0 + y, x0 + x, 2], image[y0 + y, x0 + x, 3] = blue[y, x], light[y, x]


@_kernel
def gradient(geometry, look, start, splat, width, height, alpha_max, image, slope, result):
    """The gradient of an error with respect to what `draw` blends.

    Args:
        image: what `draw` wrote.
        slope: (height, width, 4) float32, the error's derivative by the image.
        result: (M, 4) float32, increased by the derivatives by log opacity (0) and colour (1-3); the other arguments are those
            of `draw`.
    """
    tiles_x = (width + TILE - 1) // TILE
    light, behind = np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32)
    g = np.empty((3, TILE, TILE), np.float32)
    for tile in range(len(start) - 1):
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        left, top = F(x0 + 0.5), F(y0 + 0.5)
        light[:], behind[:], g[:] = _ZERO, _ZERO, _ZERO
        for y in range(min(TILE, height - y0)):
            for x in range(min(TILE, width - x0)):
                light[y, x] = _ONE
                for c in range(3):
                    g[c, y, x] = slope[y0 + y, x0 + x, c]
                for c in range(4):
                    behind[y, x] += slope[y0 + y, x0 + x, c] * image[y0 + y, x0 + x, c]
        for e in range(start[tile], start[tile + 1]):
            i = splat[e]
            if look[i, 1] < 0:
                continue
            first, last = _rows_of(geometry, look, i, top)
            opacity = red = green = blue = _ZERO
            for y in range(first, last + 1):
                u, room, level = _row(geometry, look, i, left, top + F(y))
                if room < 0:
                    continue
                for x in range(TILE):
                    before = light[y, x]
                    alpha = _alpha(u + F(x) * geometry[i, 2], room, level, alpha_max)
                    share = before * alpha
                    shown = g[0, y, x] * look[i, 2] + g[1, y, x] * look[i, 3] + g[2, y, x] * look[i, 4]
                    rest = behind[y, x] - share * shown
                    light[y, x], behind[y, x] = before - share, rest
                    free = alpha < _OPAQUE
                    opacity += (share * shown - alpha * rest / (_ONE - alpha if free else _ONE)) if free else _ZERO
                    red += share * g[0, y, x]
                    green += share * g[1, y, x]
                    blue += share * g[2, y, x]
            result[i, 0] += opacity
            result[i, 1] += red
            result[i, 2] += green
            result[i, 3] += blue
            if (e & 31) == 31 and light.max() < _STOP:
                break
