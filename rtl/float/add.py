"""Sum and difference of two small floats."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, unsigned

from rtl.float.number import Let, fields, normalise, round_and_pack, shift_right, widened
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import SmallFloat


class FloatAdd(FloatUnit):
    """`result` = a + b, or a - b where `subtract` is high. Latency 5, a stage each:

    1. the larger magnitude and the smaller, and their distance in binary places;
    2. the smaller, aligned, with a sticky bit for what leaves the window;
    3. sum or difference;
    4. normalised;
    5. rounded and packed.

    One adder wide enough for the larger operand, the result and two guard bits serves cancellation and alignment alike: a
    difference that loses more than one leading bit is of operands at most one place apart, and exact.

    Parameters:
        a, b, result: formats.
    """

    latency = 5

    def __init__(self, *, a: SmallFloat, b: SmallFloat, result: SmallFloat) -> None:
        for name, number in (("a", a), ("b", b), ("result", result)):
            check_kind(name, number, SmallFloat)
        self._formats = a, b, result
        super().__init__({"a": shape(a), "b": shape(b), "subtract": unsigned(1)}, result)

    @property
    def _window(self) -> int:
        """Bits of the aligned operands, the sticky bit apart."""
        a, b, result = self._formats
        return max(a.sig_bits, b.sig_bits, result.sig_bits) + 2

    def _ordered(self, p: Pipeline, let: Let) -> dict[str, Staged]:
        """What stage 1 registers; exponents are counted from the larger of the two biases."""
        formats, bits = self._formats[:2], (self.a, self.b)
        bias, width = max(f.bias for f in formats), max(f.sig_bits for f in formats)
        a, b = numbers = [fields(x, f) for x, f in zip(bits, formats, strict=True)]
        # A zero's exponent, like its significand, lies below all others.
        e_a, e_b = (let(f"exponent_{name}", Mux(x.nonzero, x.exponent + (bias - f.bias), 0))
                    for name, x, f in zip("ab", numbers, formats, strict=True))
        s_a, s_b = (widened(x.significand, width) for x in numbers)
        swap, negative_b = let("swap", Cat(s_b[:-1], e_b) > Cat(s_a[:-1], e_a)), b.negative ^ self.subtract
        return {name: p.reg(name, lambda x: x, p.data(name, value)) for name, value in {
            "large": Mux(swap, s_b, s_a), "small": Mux(swap, s_a, s_b), "exponent": Mux(swap, e_b, e_a),
            "distance": Mux(swap, e_b - e_a, e_a - e_b)[:-1], "negative": Mux(swap, negative_b, a.negative),
            "differ": a.negative ^ negative_b,
        }.items()}

    def stages(self, p: Pipeline, let: Let) -> Staged:
        to, window, x = self._formats[2], self._window, self._ordered(p, let)
        width = len(x["large"].value)

        def top(significand):
            return Cat(Const(0, window - width), significand)

        def add(large, small, differ):
            large, small = Cat(Const(0, 1), top(large), Const(0, 1)), Cat(small, Const(0, 1))
            return let("sum", (large + (small ^ differ.replicate(len(small))) + differ)[: len(large)])

        aligned = p.reg("aligned", lambda small, n: shift_right(let, top(small), n), x["small"], x["distance"])
        total = p.reg("total", add, x["large"], aligned, x["differ"])
        normal = p.reg("normal", lambda x: Cat(*normalise(let, x)), total)
        places = normal.map(lambda x: x[window + 2 :])
        normal = normal.map(lambda x: x[: window + 2])
        # A carry out of the larger operand's leading bit would be the exponent above its own.
        bias = to.bias - max(f.bias for f in self._formats[:2]) + 1
        return p.reg(
            "outcome", lambda normal, places, exponent, negative: round_and_pack(
                let, to, normal, exponent - places + bias, negative=negative, nonzero=normal[-1]),
            normal, places, x["exponent"], x["negative"])
