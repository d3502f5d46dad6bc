"""The product of two fixed-point numbers, as an operator of datapaths."""

from __future__ import annotations

from amaranth.hdl import Cat, Value

from rtl.fixed import as_integer, fits, modular
from rtl.float.number import Let
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import Fixed


class FixedMul(FloatUnit):
    """`result` = a * b, rounded HALF_UP. Latency: 4 cycles. Throughput: one product per cycle.

    Stages: registers for the operands, which may come through multiplexers; a times each half of b; the sum; the rounded sum.

    The result is exact modulo its format's range. `saturated` is high where it does not fit.

    Parameters:
        a, b, result: signed formats; the result has fewer fraction bits than a and b together.
    """

    latency = 4

    def __init__(self, *, a: Fixed, b: Fixed, result: Fixed) -> None:
        for name, number in (("a", a), ("b", b), ("result", result)):
            check_kind(name, number, Fixed)
            if not number.signed:
                raise ValueError(f"{name} must be signed, not {number!r}")
        if result.frac_bits >= a.frac_bits + b.frac_bits:
            raise ValueError(f"result must have fewer than {a.frac_bits + b.frac_bits} fraction bits, not {result!r}")
        self._formats = a, b, result
        super().__init__({"a": shape(a), "b": shape(b)}, result)

    def stages(self, p: Pipeline, let: Let) -> Staged:
        a, b, to = self._formats
        half, drop = b.width // 2, a.frac_bits + b.frac_bits - to.frac_bits
        operand, other = (p.data(name, port).to(1) for name, port in (("a", self.a), ("b", self.b)))
        low = p.reg("low", lambda a, b: a * b[:half], operand, other)
        high = p.reg("high", lambda a, b: a * b[half:].as_signed(), operand, other)
        # The bits below the rounding bit do not influence the result.
        total = p.reg("product", lambda low, high: (
            Cat(low[:half], (low[half:].as_signed() + high)).as_signed() >> (drop - 1)), low, high)

        def finish(total: Value) -> Value:
            rounded = let("rounded", as_integer((total + 1) >> 1))
            return Cat(modular(rounded, to), ~fits(rounded, to))

        return p.reg("outcome", finish, total)
