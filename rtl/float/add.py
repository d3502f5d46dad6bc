"""The sum and the difference of two small floats."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, Value, unsigned

from rtl.float.number import Let, fields, normalise, round_and_pack, shift_right, widened
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import SmallFloat


class FloatAdd(FloatUnit):
    """`result` = a + b, or a - b where `subtract` is high. Throughput: one result per cycle. Latency: 5 cycles, one per stage:

    1. orders the operands by magnitude and finds the difference of their exponents;
    2. aligns the smaller operand, with a sticky bit for the bits that leave the window;
    3. adds or subtracts;
    4. normalises;
    5. rounds and packs.

    One adder, wide enough for the larger operand, the result and two guard bits, serves for cancellation and for alignment. A
    difference that loses more than one leading bit has operands whose exponents differ by at most one, and is exact.

    Parameters:
        a, b, result: formats.
        stalls: whether it has the port `advance`.
    """

    latency = 5

    def __init__(self, *, a: SmallFloat, b: SmallFloat, result: SmallFloat, stalls: bool = False) -> None:
        for name, number in (("a", a), ("b", b), ("result", result)):
            check_kind(name, number, SmallFloat)
        self._formats = a, b, result
        super().__init__({"a": shape(a), "b": shape(b), "subtract": unsigned(1)}, result, stalls=stalls)

    @property
    def _window(self) -> int:
        """Number of bits of the aligned operands, without the sticky bit."""
        a, b, result = self._formats
        return max(a.sig_bits, b.sig_bits, result.sig_bits) + 2

    def _ordered(self, p: Pipeline, let: Let) -> dict[str, Staged]:
        """The registers of stage 1. Exponents are relative to the larger of the two biases."""
        formats, bits = self._formats[:2], (self.a, self.b)
        bias, width = max(f.bias for f in formats), max(f.sig_bits for f in formats)
        a, b = numbers = [fields(x, f) for x, f in zip(bits, formats, strict=True)]
        # The exponent and the significand of a zero are 0, so that it counts as the smaller operand.
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

        def top(significand: Value) -> Value:
            return Cat(Const(0, window - width), significand)

        def add(large: Value, small: Value, differ: Value) -> Value:
            large, small = Cat(Const(0, 1), top(large), Const(0, 1)), Cat(small, Const(0, 1))
            return let("sum", (large + (small ^ differ.replicate(len(small))) + differ)[: len(large)])

        aligned = p.reg("aligned", lambda small, n: shift_right(let, top(small), n), x["small"], x["distance"])
        total = p.reg("total", add, x["large"], aligned, x["differ"])
        normal = p.reg("normal", lambda x: Cat(*normalise(let, x)), total)
        places = normal.map(lambda x: x[window + 2 :])
        normal = normal.map(lambda x: x[: window + 2])
        # The top bit of `normal` is the carry out of the larger operand's leading bit, so its exponent is larger by one.
        bias = to.bias - max(f.bias for f in self._formats[:2]) + 1
        return p.reg(
            "outcome", lambda normal, places, exponent, negative: round_and_pack(
                let, to, normal, exponent - places + bias, negative=negative, nonzero=normal[-1]),
            normal, places, x["exponent"], x["negative"])
