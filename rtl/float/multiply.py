"""Product of two small floats."""

from __future__ import annotations

from amaranth.hdl import Mux

from rtl.float.number import fields, round_and_pack
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import SmallFloat


class FloatMul(FloatUnit):
    """`result` = a * b. Latency 2: product of the significands; normalised, rounded and packed.

    Parameters:
        a, b, result: formats.
    """

    latency = 2

    def __init__(self, *, a: SmallFloat, b: SmallFloat, result: SmallFloat) -> None:
        for name, number in (("a", a), ("b", b), ("result", result)):
            check_kind(name, number, SmallFloat)
        self._formats = a, b, result
        super().__init__({"a": shape(a), "b": shape(b)}, result)

    def stages(self, p: Pipeline) -> Staged:
        a_format, b_format, to = self._formats
        a, b = fields(self.a, a_format), fields(self.b, b_format)
        product = p.data("product", a.significand * b.significand)
        exponent = p.data("exponent", a.exponent + b.exponent + (to.bias - a_format.bias - b_format.bias))
        negative, nonzero = p.data("negative", a.negative ^ b.negative), p.data("nonzero", a.nonzero & b.nonzero)

        def finish(product, exponent, negative, nonzero):
            # Significands in [1, 2) have a product in [1, 4).
            two = product[-1]
            normal = Mux(two, product, product << 1)[: len(product)]
            return round_and_pack(to, normal, exponent, negative=negative, nonzero=nonzero, one_more=two)

        return p.reg("outcome", finish, product.to(1), exponent.to(1), negative.to(1), nonzero.to(1))
