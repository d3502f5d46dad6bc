"""Steps 1-6 of docs/array.md: from a splat's mean and conic to the polynomial of the exponent over a tile.

A register stage holds one addition or one half of a multiplication: first the partial products with either half of an operand,
then their sum. A short operand is not halved; its product waits for a stage instead. The stages compute::

    0   distance to the reference pixel             significands of the conic
    1   3 products of u and v, halves               factors k shifted
    2   ... summed                                  factors k rounded
    3   products shifted                            4 squares and products of k, halves
    4   products rounded                            ... summed
    5   u                                           curve_xx, curve_xy; k2^2 + k3^2
    6   u^2, v^2, u k1, u k2, v k3, halves; fit     curve_yy; curve_xx + curve_xy
    7   ... summed                                  other sums of curvatures
    8   u^2 + v^2; gx rounded; u k2 + v k3          36 (curve_xx + curve_yy)
    9   q; kept; gx; gy rounded                     ... + 64 curve_xy
    10  gy; slope_x                                 ... - q
    11  slope_y; gx + gy
    12  corner

Sums are computed modulo the width of their result's format. The final results fit their formats for every intersection that is
kept, so they are exact.
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Cat, Const, Mux, Value
from amaranth.lib import data

from rtl.fixed import fits, modular, negated_round_shift, round_shift
from rtl.pipeline import Pipeline, Staged
from spec.config import NumberFormats
from spec.constants import TILE
from spec.formats import Fixed, SmallFloat
from spec.tables import CENTRE_EXPONENT_MAX

_WIDEST_PRODUCT = 48
"""Bits of the widest product that an offset may be made of. docs/array.md says that a shift by this much and more gives 0; for
products of at most this width the shift does so by itself."""

_LONGEST_WHOLE = 12
"""Most bits of a factor whose product fits into a stage as a whole."""


class Polynomial(NamedTuple):
    """The polynomial at the tile's first pixel, without opacity; `kept` says that the splat may touch the tile."""

    corner: Staged
    slope_x: Staged
    slope_y: Staged
    curve_xx: Staged
    curve_xy: Staged
    curve_yy: Staged
    kept: Staged


def check_formats(n: NumberFormats) -> None:
    """Raises ValueError if shifts would be negative or if the formats contradict docs/array.md."""
    if n.factor.frac_bits != n.conic.sig_bits - 1:
        raise ValueError(f"factor must have the fraction bits of conic's significand, not {n.factor!r}")
    if n.conic.sig_bits + n.mean2d.width + 3 > _WIDEST_PRODUCT:
        raise ValueError(f"mean2d times conic's significand must fit {_WIDEST_PRODUCT} bits, not {n.mean2d!r}")
    if n.conic.sig_bits - 1 + n.mean2d.frac_bits <= n.offset.frac_bits:
        raise ValueError(f"offset must have fewer fraction bits than mean2d times conic's significand, not {n.offset!r}")
    if n.cut.frac_bits != n.log2_opacity.frac_bits or n.cut.frac_bits >= n.exponent.frac_bits:
        raise ValueError(f"cut must have the fraction bits of log2_opacity, fewer than exponent's, not {n.cut!r}")
    if n.exponent.frac_bits > min(n.offset.frac_bits, n.factor.frac_bits):
        raise ValueError(f"exponent must not have more fraction bits than offset and factor, not {n.exponent!r}")
    if not n.exponent.frac_bits == n.slope.frac_bits == n.curvature.frac_bits:
        raise ValueError(f"slope and curvature must have exponent's fraction bits, not {n.slope!r} and {n.curvature!r}")


def decode_factor(bits: Value, number: SmallFloat) -> tuple[Value, Value]:
    """(signed significand, amount by which the exponent lies below 0) of a conic factor; zero has significand 0."""
    fraction, field = bits[: number.sig_bits - 1], bits[number.sig_bits - 1 : -1]
    magnitude = Cat(fraction, Const(1, 2)).as_signed()
    significand = Mux(field.any(), Mux(bits[-1], -magnitude, magnitude), 0)
    return significand[: number.sig_bits + 1].as_signed(), (number.bias - field)[: number.exp_bits]


class _Arithmetic:
    """The operations of the polynomial unit, each with its own register stages of `p`."""

    def __init__(self, p: Pipeline, n: NumberFormats) -> None:
        self.p, self.n = p, n

    def product(self, name: str, a: Staged, b: Staged) -> Staged:
        """a b in two stages: the products with the low and with the high half of b, then their sum. A short b is left whole."""
        width, half = len(a.value) + len(b.value), len(b.value) // 2
        if len(b.value) <= _LONGEST_WHOLE:
            whole = self.p.reg(f"{name}_whole", lambda x, y: x * y, a, b)
            return whole.to(whole.stage + 1)
        low = self.p.reg(f"{name}_low", lambda x, y: x * y[:half], a, b)
        high = self.p.reg(f"{name}_high", lambda x, y: x * y[half:].as_signed(), a, b)
        return self.p.reg(name, lambda low, high: (low + (high << half))[:width].as_signed(), low, high)

    def add(self, name: str, a: Staged, b: Staged, number: Fixed | None = None) -> Staged:
        return self.p.reg(name, lambda x, y: modular(x + y, number) if number else x + y, a, b)

    def minus_twice(self, name: str, x: Staged, shift: int, number: Fixed) -> Staged:
        """-rs(2 x, shift), where rs is the rounding shift of docs/array.md."""
        return self.p.reg(name, lambda x: modular(negated_round_shift(x << 1, shift), number), x)

    def offset(self, index: int, significand: Staged, below: Staged, distance: Staged) -> Staged:
        """Step 2. A rounding right shift by n is a plain shift by n - 1, then one by 1 that rounds halves up."""
        n = self.n
        shift = n.conic.sig_bits - 1 + n.mean2d.frac_bits - n.offset.frac_bits  # for exponent 0
        whole = self.product(f"product_{index}", significand, distance)
        halves = self.p.reg(f"halves_{index}", lambda x, below: x.shift_right(shift - 1) >> below, whole, below)
        return self.p.reg(f"offset_{index}", lambda x: x.shift_right(1) + x[0], halves)

    def factor(self, index: int, significand: Staged, below: Staged) -> Staged:
        """Step 4, with the same split of the rounding shift."""
        halves = self.p.reg(f"factor_halves_{index}", lambda m, below: (m << 1) >> below, significand, below)
        return self.p.reg(f"factor_{index}", lambda x: modular(x.shift_right(1) + x[0], self.n.factor), halves)


def polynomial(
    p: Pipeline, n: NumberFormats, tile_x: Value, tile_y: Value, mean2d: data.View, conic: data.View, *,
    quarter: Value | None = None,
) -> Polynomial:
    """The registers of steps 1-6, from values at the input of `p`; the last of them is at stage 13.

    With `quarter`, a constant signal with the column (bit 0) and the row (bit 1) of a quarter of the tile, the polynomial is
    given at the first pixel of that quarter. Along an axis on which this is the pixel at the tile's centre, the steps from the
    centre to the first pixel are left out.
    """
    def steps(x: Value, *axes: int) -> Value:
        """A term of the way from the centre to the first pixel along these axes."""
        return x if quarter is None else Mux(Cat(quarter[axis] for axis in axes).any(), 0, x)

    a, grid = _Arithmetic(p, n), n.exponent.frac_bits
    centre = Const((TILE + 1) << (n.mean2d.frac_bits - 1), n.mean2d.frac_bits + 4)  # the middle of pixel 8 is at 8.5
    dx = p.reg("dx", lambda mean, tile: Cat(centre, tile) - mean, p.data("mean_x", mean2d[0]), p.data("tile_x", tile_x))
    dy = p.reg("dy", lambda mean, tile: Cat(centre, tile) - mean, p.data("mean_y", mean2d[1]), p.data("tile_y", tile_y))
    decoded = [decode_factor(conic[i], n.conic) for i in range(3)]
    m = [p.reg(f"significand_{i}", lambda x: x, p.data("m", decoded[i][0])) for i in range(3)]
    below = [p.reg(f"below_{i}", lambda x: x, p.data("below", decoded[i][1])) for i in range(3)]

    wide_u = a.add("u", a.offset(0, m[0], below[0], dx), a.offset(1, m[1], below[1], dy))
    wide_v = a.offset(2, m[2], below[2], dy).to(wide_u.stage)
    centred = p.reg("centred", lambda u, v: fits(u, n.offset) & fits(v, n.offset), wide_u, wide_v)
    u, v = (wide.map(lambda x: modular(x, n.offset)) for wide in (wide_u, wide_v))
    k1, k2, k3 = (a.factor(i, m[i], below[i]) for i in range(3))

    second, first = 2 * n.factor.frac_bits - grid, n.offset.frac_bits + n.factor.frac_bits - grid
    k2_squared, k3_squared = a.product("k2_squared", k2, k2), a.product("k3_squared", k3, k3)
    curve_xx = a.minus_twice("curve_xx", a.product("k1_squared", k1, k1), second, n.curvature)
    curve_xy = a.minus_twice("curve_xy", a.product("k1_k2", k1, k2), second, n.curvature)
    curve_yy = a.minus_twice("curve_yy", a.add("k23_squared", k2_squared, k3_squared), second, n.curvature)

    square = a.add("square", a.product("u_squared", u, u), a.product("v_squared", v, v))
    limit = CENTRE_EXPONENT_MAX << 2 * n.offset.frac_bits
    kept = p.reg("kept", lambda square, centred: (square < limit) & centred, square, centred)
    q = p.reg("q", lambda x: modular(round_shift(x, 2 * n.offset.frac_bits - grid), n.exponent), square)
    slope_u = a.minus_twice("slope_u", a.product("u_k1", u, k1), first, n.slope)
    slope_v = a.minus_twice("slope_v", a.add("uv_k", a.product("u_k2", u, k2), a.product("v_k3", v, k3)), first, n.slope)
    gx = p.reg("gx", lambda slope, curve: modular(slope + (curve >> 1), n.slope), slope_u, curve_xx)
    gy = p.reg("gy", lambda slope, curve: modular(slope + (curve >> 1), n.slope), slope_v, curve_yy)

    curves_x = p.reg("curves_x", lambda xx, xy: steps(xx, 0) + steps(xy, 1), curve_xx, curve_xy)
    curves_y = p.reg("curves_y", lambda yy, xy: steps(yy, 1) + steps(xy, 0), curve_yy, curve_xy)
    slope_x = p.reg("slope_x", lambda g, curves: modular(g - (curves << 3), n.slope), gx, curves_x)
    slope_y = p.reg("slope_y", lambda g, curves: modular(g - (curves << 3), n.slope), gy, curves_y)
    both = p.reg("curves", lambda xx, yy: steps(xx, 0) + steps(yy, 1), curve_xx, curve_yy)
    pure = p.reg("pure", lambda c: modular((c << 5) + (c << 2), n.exponent), both)
    curves = p.reg("curves_all", lambda x, y: modular(x + (steps(y, 0, 1) << 6), n.exponent), pure, curve_xy)
    falloff = p.reg("falloff", lambda x, q: modular(x - q, n.exponent), curves, q)
    slopes = p.reg("g", lambda gx, gy: steps(gx, 0) + steps(gy, 1), gx, gy)
    corner = p.reg("corner", lambda x, g: modular(x - (g << 3), n.exponent), falloff, slopes)
    return Polynomial(corner, slope_x, slope_y, curve_xx, curve_xy, curve_yy, kept)
