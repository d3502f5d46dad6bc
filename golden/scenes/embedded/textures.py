"""Procedural textures and the sky of the embedded scene, in numba. Vectors are tuples of three floats."""

from __future__ import annotations

import math

from golden.kernels import compiled

PLAIN, CHECKER, PLANKS, BRICK, STRIPES, MOTTLE, TEXT, BOOKS, STAR, RUG = range(10)
"""The patterns that `texture` accepts."""


@compiled
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def add(a, b):
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def scale(a, s):
    """s a."""
    return (a[0] * s, a[1] * s, a[2] * s)


@compiled
def axpy(s, a, b):
    """s a + b."""
    return (s * a[0] + b[0], s * a[1] + b[1], s * a[2] + b[2])


@compiled
def mix(a, b, w):
    """Linear interpolation: a at w = 0, b at w = 1."""
    return (a[0] + (b[0] - a[0]) * w, a[1] + (b[1] - a[1]) * w, a[2] + (b[2] - a[2]) * w)


@compiled
def normalise(a):
    """The unit vector along `a`."""
    return scale(a, 1.0 / math.sqrt(dot(a, a)))


@compiled
def smooth(x, lo, hi):
    """Smoothstep: 0 below lo, 1 above hi."""
    t = min(1.0, max(0.0, (x - lo) / (hi - lo)))
    return t * t * (3.0 - 2.0 * t)


@compiled
def cell_random(i, j):
    """A pseudo-random number in [0, 1) for an integer cell, from a 32-bit hash (multiply and xor-shift)."""
    h = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0


@compiled
def value_noise(u, v):
    """Smooth noise in [0, 1): hashed values at the lattice points, with smoothstep interpolation between them."""
    a, b = math.floor(u), math.floor(v)
    s, t = smooth(u - a, 0.0, 1.0), smooth(v - b, 0.0, 1.0)
    low = cell_random(a, b) + (cell_random(a + 1, b) - cell_random(a, b)) * s
    high = cell_random(a, b + 1) + (cell_random(a + 1, b + 1) - cell_random(a, b + 1)) * s
    return low + (high - low) * t


@compiled
def fractal(u, v):
    """Three octaves of value noise, about 0.5 +- 0.3."""
    return (4.0 * value_noise(u, v) + 2.0 * value_noise(2.03 * u, 2.03 * v) + value_noise(4.1 * u, 4.1 * v)) / 7.0


@compiled
def _planks(a, b, u, v):
    """Boards along u with grain and dark joints, one period wide and four long, each row offset from the one before."""
    row = math.floor(v)
    along = u / 4.0 + 0.37 * row
    board = cell_random(math.floor(along), row)
    grain = value_noise(1.3 * u + 17.0 * board, 9.0 * v)
    colour = mix(a, b, 0.65 * board + 0.35 * grain)
    joint = min(min(v - row, row + 1.0 - v), 4.0 * min(along - math.floor(along), math.floor(along) + 1.0 - along))
    return scale(colour, 0.55 + 0.45 * smooth(joint, 0.0, 0.06))


@compiled
def _brick(a, b, u, v):
    """Bricks two periods long and one high in a running bond; `b` is the mortar."""
    row = math.floor(v)
    x = 0.5 * u + 0.5 * (row % 2)
    column = math.floor(x)
    edge = min(2.0 * min(x - column, column + 1.0 - x), min(v - row, row + 1.0 - v))
    tone = 0.72 + 0.4 * cell_random(column, row) + 0.25 * (fractal(3.0 * u, 3.0 * v) - 0.5)
    return mix(b, scale(a, tone), smooth(edge, 0.05, 0.11))


@compiled
def _text(a, b, u, v):
    """Lines of words: dark strokes of colour `b` on paper of colour `a`, with every sixth line empty."""
    line = math.floor(v)
    column = math.floor(1.6 * u)
    x, y = 1.6 * u - column, v - line
    word = cell_random(math.floor(column / 3.0) + 7, line)
    inked = 0.22 < y < 0.78 and word > 0.12 and line % 6 != 0
    glyph = cell_random(column, line)
    stroke = (x < 0.3) or (glyph > 0.45 and y < 0.42) or (glyph < 0.6 and x > 0.62 and y > 0.45)
    return b if inked and stroke and x < 0.85 else a


@compiled
def _books(a, b, u, v):
    """Spines one period wide on shelves four periods high; `a` is the board, `b` the shadow above the books."""
    shelf = math.floor(v / 4.0)
    height = v - 4.0 * shelf
    if height < 0.35:
        return a
    spine = math.floor(u + 0.5 * shelf)
    if height > 2.6 + 1.1 * cell_random(spine, shelf + 31):
        return b
    hue, tone = cell_random(spine, shelf), 0.35 + 0.5 * cell_random(spine, shelf + 57)
    colour = scale((
        0.55 + 0.45 * math.cos(6.2831853 * hue), 0.5 + 0.4 * math.cos(6.2831853 * (hue + 0.31)),
        0.5 + 0.4 * math.cos(6.2831853 * (hue + 0.63)),
    ), tone)
    if 1.6 < height < 2.0:
        colour = mix(colour, (0.95, 0.9, 0.7), 0.6)
    x = u + 0.5 * shelf - spine
    return scale(colour, 0.45 + 0.55 * smooth(min(x, 1.0 - x), 0.0, 0.12))


@compiled
def _star(a, b, u, v):
    """A Siemens star of 18 pairs of sectors, one period in radius, and a ring around it; it has all spatial frequencies."""
    r = math.sqrt(u * u + v * v)
    if r > 1.0:
        return b if 1.08 < r < 1.16 else a
    return b if math.sin(18.0 * math.atan2(v, u)) > 0.0 else a


@compiled
def _rug(a, b, u, v):
    """Rings and radial petals of a round rug, one period in radius."""
    r, angle = math.sqrt(u * u + v * v), math.atan2(v, u)
    petal = r + 0.05 * math.cos(12.0 * angle)
    if r > 0.9:
        return b
    if petal > 0.74:
        return mix(a, b, 0.5 + 0.5 * math.copysign(1.0, math.sin(36.0 * angle)))
    return (0.86, 0.72, 0.42) if math.floor(7.0 * petal) % 2 else a


@compiled
def texture(pattern, a, b, u, v):
    """Colour of a pattern (PLAIN..RUG) with colours `a` and `b` at (u, v), in periods of the pattern."""
    if pattern == CHECKER:
        return a if (math.floor(u) + math.floor(v)) % 2 == 0 else b
    if pattern == PLANKS:
        return _planks(a, b, u, v)
    if pattern == BRICK:
        return _brick(a, b, u, v)
    if pattern == STRIPES:
        return mix(a, b, smooth(abs(u - math.floor(u) - 0.5), 0.2, 0.28))
    if pattern == MOTTLE:
        return mix(a, b, smooth(fractal(u, v), 0.25, 0.75))
    if pattern == TEXT:
        return _text(a, b, u, v)
    if pattern == BOOKS:
        return _books(a, b, u, v)
    if pattern == STAR:
        return _star(a, b, u, v)
    if pattern == RUG:
        return _rug(a, b, u, v)
    return a


@compiled
def sky(d):
    """Colour of the sky along unit direction `d`: a gradient with clouds."""
    rise = max(0.0, d[2])
    blue = mix((0.86, 0.92, 0.97), (0.33, 0.56, 0.88), smooth(rise, 0.0, 0.55))
    azimuth = math.atan2(d[0], d[1])
    cloud = smooth(fractal(5.0 * azimuth + 3.0, 16.0 * rise), 0.5, 0.72)
    return mix(blue, (0.98, 0.98, 0.98), 0.85 * cloud)
