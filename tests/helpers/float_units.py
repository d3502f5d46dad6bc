"""Float units in Amaranth's simulator, and what they must give, by rational arithmetic."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache

from amaranth.sim import Simulator

from rtl.float.add import FloatAdd
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.float.unit import FloatUnit
from spec.formats import SmallFloat
from tests.helpers.exact_rounding import round_exactly, square_root

INFINITE = Fraction(2) ** 2000
"""Stands for the quotient by zero: above every format's range."""


def quotient(a: Fraction, b: Fraction) -> Fraction:
    """a / b as the units define it: zero's quotient is zero, any other by zero infinite with a's sign."""
    if a == 0:
        return Fraction(0)
    return a / b if b else INFINITE * (1 if a > 0 else -1)


def inverse_root(a: Fraction) -> Fraction:
    """1 / sqrt(a), rounding like it; infinite for zero and below."""
    return square_root(1 / a) if a > 0 else INFINITE


BINARY: dict[type[FloatUnit], Callable[[Fraction, Fraction], Fraction]] = {
    FloatAdd: lambda a, b: a + b, FloatMul: lambda a, b: a * b, FloatDivide: quotient}
UNARY: dict[type[FloatUnit], Callable[[Fraction], Fraction]] = {
    FloatReciprocal: lambda a: quotient(Fraction(1), a), FloatRsqrt: inverse_root,
    FloatSqrt: lambda a: square_root(a) if a > 0 else Fraction(0)}


@cache
def value(number: SmallFloat, bits: int) -> Fraction:
    """The number of a bit pattern, from the format's definition."""
    fraction, exponent = bits % (1 << number.sig_bits - 1), bits >> number.sig_bits - 1
    exponent, negative = exponent % (1 << number.exp_bits), number.signed and exponent >> number.exp_bits
    if exponent == 0:
        return Fraction(0)
    magnitude = (1 + Fraction(fraction, 1 << number.sig_bits - 1)) * Fraction(2) ** (exponent - number.bias)
    return -magnitude if negative else magnitude


def pattern(number: SmallFloat, x: Fraction) -> int:
    """The bit pattern of a number of the format."""
    if x == 0:
        return 0
    exponent = next(e for e in range(number.exp_min, number.exp_max + 1) if abs(x) < Fraction(2) ** (e + 1))
    fraction = (abs(x) / Fraction(2) ** exponent - 1) * (1 << number.sig_bits - 1)
    assert fraction.denominator == 1
    magnitude = (exponent + number.bias << number.sig_bits - 1) + fraction.numerator
    return magnitude + (int(x < 0) << number.width - 1)


@cache
def expected(number: SmallFloat, x: Fraction) -> tuple[int, bool]:
    """(bits, saturated) of the exact result x."""
    signed = replace(number, signed=True)
    rounded = round_exactly(x, signed)
    if rounded < 0 and not number.signed:
        return 0, True
    beyond = Fraction(2) ** (number.exp_max - number.sig_bits)  # half an ulp above the largest, a tie, rounds up
    return pattern(number, rounded), abs(x) >= Fraction(2) ** (number.exp_max + 1) - beyond


def simulate(unit: FloatUnit, rows: Sequence[dict[str, int]], *, bubbles: float = 0.0, seed: int = 1) -> list[tuple[int, bool]]:
    """(result, saturated) of every row; every result is where `latency` says, and nowhere else is one."""
    rng, results = random.Random(seed), []
    members = [name for name in unit.signature.members if name not in ("valid", "result_valid", "result", "saturated")]

    async def bench(ctx) -> None:
        waiting, due, cycle = iter(rows), {}, 0
        row = next(waiting, None)
        while row is not None or due:
            taken = row is not None and rng.random() >= bubbles
            ctx.set(unit.valid, taken)
            for name in members:
                ctx.set(getattr(unit, name), row[name] if taken else rng.getrandbits(1))
            assert ctx.get(unit.result_valid) == (cycle in due), f"cycle {cycle}"
            if due.pop(cycle, False):
                results.append((ctx.get(unit.result), bool(ctx.get(unit.saturated))))
            if taken:
                due[cycle + unit.latency] = True
                row = next(waiting, None)
            await ctx.tick()
            cycle += 1

    simulator = Simulator(unit)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return results


def assert_equal(rows: Iterable[dict[str, int]], got: Iterable[object], wanted: Iterable[object]) -> None:
    """Equal item by item; the first difference is shown with its operands."""
    for row, g, w in zip(rows, got, wanted, strict=True):
        assert g == w, row
