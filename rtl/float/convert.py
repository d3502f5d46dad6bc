"""Conversions between fixed point and small floats."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, Value

from rtl.fixed import as_integer, fits, saturate
from rtl.float.number import Let, fields, normalise, round_and_pack, shift_right
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import Fixed, Rounding, SmallFloat


class FixedToFloat(FloatUnit):
    """`result` = a, rounded HALF_EVEN. Throughput: one result per cycle. Latency: 3 cycles.

    Stages: takes the magnitude; normalises it; rounds and packs.

    Parameters:
        a, result: formats.
    """

    latency = 3

    def __init__(self, *, a: Fixed, result: SmallFloat) -> None:
        check_kind("a", a, Fixed)
        check_kind("result", result, SmallFloat)
        self._a, self._result = a, result
        super().__init__({"a": shape(a)}, result)

    def stages(self, p: Pipeline, let: Let) -> Staged:
        a, width = as_integer(self.a), self._a.width
        negative = p.data("negative", a[-1])
        magnitude = p.reg("magnitude", lambda a: Mux(a[-1], -a, a)[:width], p.data("a", a))
        normal = p.reg("normal", lambda x: Cat(*normalise(let, x)), magnitude)
        exponent = width - 1 - self._a.frac_bits + self._result.bias  # biased exponent of the top bit

        def finish(x: Value, negative: Value) -> Value:
            normal, places = x[:width], x[width:]
            return round_and_pack(let, self._result, normal, exponent - places, negative=negative, nonzero=normal[-1])

        return p.reg("outcome", finish, normal, negative)


class FloatToFixed(FloatUnit):
    """`result` = a, rounded to a multiple of the result's ulp and saturated. Throughput: one result per cycle. Latency: 3
    cycles.

    Stages: finds the distance to shift; shifts; rounds and saturates.

    Parameters:
        a, result: formats.
        rounding: HALF_UP or FLOOR.
    """

    latency = 3

    def __init__(self, *, a: SmallFloat, result: Fixed, rounding: Rounding = Rounding.HALF_UP) -> None:
        check_kind("a", a, SmallFloat)
        check_kind("result", result, Fixed)
        if rounding not in (Rounding.HALF_UP, Rounding.FLOOR):
            raise ValueError(f"rounding must be HALF_UP or FLOOR, not {rounding!r}")
        self._a, self._result, self._rounding = a, result, rounding
        super().__init__({"a": shape(a)}, result)

    def stages(self, p: Pipeline, let: Let) -> Staged:
        number, to = self._a, self._result
        a = fields(self.a, number)
        # The significand first stands with its leading one at 2^magnitude ulps, where it saturates, and is then shifted right.
        magnitude = to.int_bits + to.frac_bits
        width = max(magnitude + 2, number.sig_bits)  # includes at least one bit below the ulp
        places = let("distance", as_integer(magnitude - to.frac_bits + number.bias - a.exponent))
        negative = p.data("negative", a.negative)
        large = p.reg("large", lambda x, nonzero: x[-1] & nonzero, p.data("places", places), p.data("nonzero", a.nonzero))
        places = p.reg("places", lambda x: Mux(x[-1], 0, x[:-1]), p.data("places", places))
        top = Const(0, width - number.sig_bits)
        shifted = p.reg("shifted", lambda x, n, large: Cat(shift_right(let, Cat(top, x), n), large),
                        p.data("significand", a.significand).to(1), places, large)

        def finish(x: Value, negative: Value) -> Value:
            x, large = x[:-1], x[-1]
            below = len(x) - (magnitude + 1)
            whole, half, rest = x[below:] | large.replicate(magnitude + 1), x[below - 1], x[: below - 1].any()
            # -(m + up) = ~m + (not up), so one adder serves for both signs.
            up = half & (~negative | rest) if self._rounding is Rounding.HALF_UP else negative & (half | rest)
            signed = Cat(whole, Const(0, 1)) ^ negative.replicate(magnitude + 2)
            rounded = let("rounded", signed.as_signed() + (up ^ negative))
            return Cat(saturate(rounded, to), ~fits(rounded, to))

        return p.reg("outcome", finish, shifted, negative)
