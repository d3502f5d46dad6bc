"""The product of two small floats."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, Value

from rtl.float.number import Let, fields, product, round_and_pack_early
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import SmallFloat


class FloatMul(FloatUnit):
    """`result` = a * b. Throughput: one result per cycle. Latency: 3 cycles.

    Stages: a's significand times the parts of b's; the sum of these products; normalising, rounding and packing.

    Parameters:
        a, b, result: formats.
    """

    latency = 3

    def __init__(self, *, a: SmallFloat, b: SmallFloat, result: SmallFloat) -> None:
        for name, number in (("a", a), ("b", b), ("result", result)):
            check_kind(name, number, SmallFloat)
        self._formats = a, b, result
        super().__init__({"a": shape(a), "b": shape(b)}, result)

    def stages(self, p: Pipeline, let: Let) -> Staged:
        a_format, b_format, to = self._formats
        a, b = fields(self.a, a_format), fields(self.b, b_format)
        exponent = p.data("exponent", a.exponent + b.exponent + (to.bias - a_format.bias - b_format.bias))
        negative, nonzero = p.data("negative", a.negative ^ b.negative), p.data("nonzero", a.nonzero & b.nonzero)

        # Only `nonzero` tells zeros apart. The hidden ones of both operands are taken as set, so that the product need not wait
        # for `nonzero`.
        hidden = Const(1, 1)
        significand = product(
            p, let, "product", *(p.data(name, Cat(x[: number.sig_bits - 1], hidden)) for name, x, number in (
                ("a", self.a, a_format), ("b", self.b, b_format))))

        def finish(significand: Value, exponent: Value, negative: Value, nonzero: Value) -> Value:
            # The product of significands in [1, 2) lies in [1, 4).
            two = significand[-1]
            normal = Mux(two, significand, significand << 1)[: len(significand)]
            return round_and_pack_early(let, to, normal, exponent, negative=negative, nonzero=nonzero, one_more=two)

        return p.reg("outcome", finish, significand, exponent.to(1), negative, nonzero)
