"""Floored quotients of integers by long division, one bit of the quotient per stage.

A stage doubles the remainder, appends the next bit of the numerator, and subtracts the divisor unless the difference would be
negative. A quotient of 19 bits takes 19 subtractions of 19 bits. The alternative of a table, a Newton step and an exact
residual would take three products of as many bits each.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline


class Divider(wiring.Component):
    """`quotient` = floor(numerator / divisor).

    Parameters:
        numerator_bits, divisor_bits, quotient_bits: widths; the numerator must be wider than the quotient.

    Ports:
        load: operands are at the input; without it the stages keep their contents.
        numerator, divisor: unsigned operands.
        over: one cycle after the operands: the quotient needs more bits or the divisor is 0; the quotient is then undefined.
        quotient: `quotient_bits` cycles after the operands.

    Throughput: one quotient per cycle, without back-pressure. Latency: `quotient_bits` cycles.
    """

    def __init__(self, *, numerator_bits: int, divisor_bits: int, quotient_bits: int):
        widths = {"divisor_bits": divisor_bits, "quotient_bits": quotient_bits, "numerator_bits": numerator_bits}
        for name, bits in widths.items():
            if not isinstance(bits, int) or isinstance(bits, bool):
                raise TypeError(f"{name} must be an integer, not {bits!r}")
            if bits < 1:
                raise ValueError(f"{name} must be 1 or more, not {bits!r}")
        if numerator_bits <= quotient_bits:
            raise ValueError(f"numerator_bits must be more than {quotient_bits}, not {numerator_bits!r}")
        self.latency = quotient_bits
        super().__init__({
            "load": In(1), "numerator": In(numerator_bits), "divisor": In(divisor_bits), "over": Out(1),
            "quotient": Out(quotient_bits),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        p = Pipeline(m, load=self.load)
        divisor = p.data("divisor", self.divisor)
        above = p.data("above", self.numerator[self.latency :])
        remainder = above.map(lambda r: r[: len(self.divisor)])  # smaller than the divisor, or else `over` is set
        # numerator bits leave at the top, quotient bits enter at the bottom
        rest = p.data("rest", self.numerator[: self.latency])
        m.d.comb += self.over.eq(p.reg("over", lambda r, d: r >= d, above, divisor).value)
        for _ in range(self.latency):
            bits = len(self.divisor)

            def step(remainder: Value, rest: Value, divisor: Value, bits: int = bits) -> Value:
                doubled = Cat(rest[-1], remainder)
                less = doubled - divisor
                return Cat(~less[-1], rest[:-1], Mux(less[-1], doubled[:bits], less[:bits]))

            both = p.reg("step", step, remainder, rest, divisor)
            rest, remainder = both.map(lambda v: v[: self.latency]), both.map(lambda v: v[self.latency :])
        m.d.comb += self.quotient.eq(rest.value)
        return m
