"""Float units against rational arithmetic: every operand at tiny widths, mixed formats; directed and random at the used."""

from __future__ import annotations

import itertools
import random
from fractions import Fraction

import pytest
from amaranth.hdl import ClockDomain, Module
from amaranth.sim import Simulator

from rtl.emit import to_verilog
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from spec.config import FPGA_FORMATS, NumberFormats
from spec.formats import SQ, UQ, Fixed, Rounding, SmallFloat
from tests.helpers.float_units import BINARY, UNARY, assert_equal, expected, pattern, simulate, value
from tests.helpers.rtl_streams import assert_rejected

N, SHORT = NumberFormats(), FPGA_FORMATS
TINY = SmallFloat(3, 3, 3)
TRIPLES = [
    (TINY, TINY, TINY),
    (SmallFloat(4, 3, 3), SmallFloat(3, 3, 2), SmallFloat(2, 3, 1)),
    (SmallFloat(3, 3, 3), SmallFloat(3, 3, 3, signed=False), SmallFloat(5, 2, -1)),
    (SmallFloat(2, 2, 1), SmallFloat(2, 3, 5), SmallFloat(6, 4, 7, signed=False)),
    (SmallFloat(3, 2, -2), SmallFloat(4, 2, 3), SmallFloat(4, 4, 7)),
]
PAIRS = [
    (SmallFloat(2, 3, 3), SmallFloat(2, 3, 2)), (TINY, TINY), (SmallFloat(4, 3, 3), SmallFloat(4, 3, 3)),
    (SmallFloat(4, 3, 2), SmallFloat(2, 4, 8)), (SmallFloat(6, 3, 4), SmallFloat(5, 3, 3, signed=False)),
    (SmallFloat(5, 4, 7, signed=False), SmallFloat(7, 4, 7)), (SmallFloat(8, 2, 1), SmallFloat(8, 3, 3)),
    (SmallFloat(9, 2, 2), SmallFloat(10, 3, 3)),
]
MACHINE = [(N.view, N.view, N.view), (N.work, N.work, N.work), (N.view, N.view, N.work), (N.work, N.work, N.conic),
           (N.view, N.work, N.work), (N.work, N.scale, N.work), (SHORT.view, SHORT.view, SHORT.view),
           (SHORT.work, SHORT.work, SHORT.work), (SHORT.view, SHORT.work, SHORT.work)]


def patterns(number: SmallFloat) -> range:
    return range(1 << number.width)


def check_binary(kind: type, formats: tuple[SmallFloat, ...], pairs: list[tuple[int, int]], bubbles: float = 0.0) -> None:
    a, b, result = formats
    rows = [{"a": x, "b": y} for x, y in pairs]
    if kind is FloatAdd:
        rows = [{**row, "subtract": s} for row in rows for s in (0, 1)]
    got = simulate(kind(a=a, b=b, result=result), rows, bubbles=bubbles)
    wanted = [expected(result, BINARY[kind](value(a, row["a"]), value(b, row["b"]) * (-1 if row.get("subtract") else 1)))
              for row in rows]
    assert_equal(rows, got, wanted)


def check_unary(kind: type, a: SmallFloat, result: SmallFloat, operands: list[int], bubbles: float = 0.0) -> None:
    rows = [{"a": x} for x in operands]
    got = simulate(kind(a=a, result=result), rows, bubbles=bubbles)
    assert_equal(rows, got, [expected(result, UNARY[kind](value(a, x))) for x in operands])


@pytest.mark.parametrize("formats", TRIPLES, ids=lambda f: " ".join(map(str, f)))
@pytest.mark.parametrize("kind", BINARY)
def test_every_pair_of_tiny_operands(kind, formats):
    a, b, result = formats
    if kind is FloatDivide and a.sig_bits > result.sig_bits:
        pytest.skip("quotients could be ties: refused")
    check_binary(kind, formats, list(itertools.product(patterns(a), patterns(b))))


@pytest.mark.parametrize(("a", "result"), PAIRS, ids=str)
@pytest.mark.parametrize("kind", UNARY)
def test_every_tiny_operand(kind, a, result):
    check_unary(kind, a, result, list(patterns(a)))


def edges(number: SmallFloat) -> list[int]:
    """Zero, the ends of the range, one, and their neighbours; the patterns of zero that no unit makes."""
    one, top = number.bias << number.sig_bits - 1, (1 << number.exp_bits + number.sig_bits - 1) - 1
    least = 1 << number.sig_bits - 1
    found = [0, 1, least - 1, least, least + 1, one - 1, one, one + 1, one + least - 1, one + least, top - 1, top]
    return [bits + (sign << number.width - 1) for sign in range(1 + number.signed) for bits in found if bits <= top]


def near(rng: random.Random, number: SmallFloat, bits: int) -> int:
    """A number close to another: a few ulps or binades away, so that sums cancel, round up and tie."""
    step = rng.choice([0, 1, -1, 2, 1 << number.sig_bits - 2, *(k << number.sig_bits - 1 for k in range(-3, 30))])
    top = (1 << number.exp_bits + number.sig_bits - 1) - 1
    return min(max((bits & top) + step + rng.choice([0, 0, rng.randrange(4)]), 0), top) | rng.getrandbits(number.signed) << (
        number.width - 1)


def directed_pairs(a: SmallFloat, b: SmallFloat, count: int) -> list[tuple[int, int]]:
    """All pairs of edges, then random operands: independent, close to each other, and with few significant bits, for ties."""
    rng = random.Random(a.width)
    pairs = list(itertools.product(edges(a), edges(b)))
    for _ in range(count):
        x, y = rng.randrange(1 << a.width), rng.randrange(1 << b.width)
        pairs += [(x, y), (x, near(rng, b, expected(b, value(a, x))[0]))]
        sparse = (1 << a.sig_bits // 2) - 1, (1 << b.sig_bits // 2) - 1
        pairs.append((x & ~sparse[0], y & ~sparse[1]))
    return pairs


@pytest.mark.parametrize("formats", MACHINE, ids=lambda f: " ".join(map(str, f)))
@pytest.mark.parametrize("kind", BINARY)
def test_the_machines_formats(kind, formats):
    if kind is FloatDivide and formats[0].sig_bits > formats[2].sig_bits:
        pytest.skip("quotients could be ties: refused")
    check_binary(kind, formats, directed_pairs(*formats[:2], 150), bubbles=0.2)


def test_a_longer_operand_is_rounded_once():
    """A tie of the result's format and a hair: float64 drops the hair, and rounding its sum would go the wrong way."""
    tie, hair = Fraction(1) + Fraction(1, 1 << N.work.sig_bits), Fraction(1, 1 << 100)
    a, b = pattern(N.view, tie), pattern(N.work, hair)
    up, even = expected(N.work, tie + hair)[0], pattern(N.work, Fraction(1))
    rows = [{"a": a, "b": b, "subtract": subtract} for subtract in (0, 1)]
    assert [bits for bits, _ in simulate(FloatAdd(a=N.view, b=N.work, result=N.work), rows)] == [up, even] == [even + 1, even]
    assert N.work.round(float(tie) + float(hair)) == 1


@pytest.mark.parametrize("number", [N.view, N.work, SHORT.view, SHORT.work], ids=str)
@pytest.mark.parametrize("kind", UNARY)
def test_the_machines_reciprocals_and_roots(kind, number):
    rng = random.Random(5)
    one = number.bias << number.sig_bits - 1
    squares = [pattern(number, Fraction(k * k)) for k in range(1, min(400, 1 << number.sig_bits // 2))]
    close = [one + (e << number.sig_bits - 1) + d for e in range(-2, 3) for d in range(-8, 9)]
    some = [rng.randrange(1 << number.width) for _ in range(900)]
    check_unary(kind, number, number, [*edges(number), *squares, *close, *some], bubbles=0.2)


FIXED = [(SQ(3, 4), SmallFloat(4, 3, 3)), (UQ(3, 4), SmallFloat(4, 3, 3)), (SQ(0, 6), SmallFloat(7, 3, 8)),
         (SQ(5, 3), SmallFloat(3, 2, 1, signed=False)), (UQ(0, 5), SmallFloat(2, 4, 12)), (SQ(9, 0), SmallFloat(5, 3, 0))]


def to_fixed(x: Fraction, number: Fixed, rounding: Rounding) -> tuple[int, bool]:
    """(raw, saturated): the definition of the two roundings, in rationals."""
    scaled = x * (1 << number.frac_bits)
    raw = (scaled + (Fraction(1, 2) if rounding is Rounding.HALF_UP else 0)).__floor__()
    return min(max(raw, number.raw_min), number.raw_max), not number.raw_min <= raw <= number.raw_max


@pytest.mark.parametrize(("fixed", "number"), FIXED, ids=str)
def test_every_conversion(fixed, number):
    rows = [{"a": raw} for raw in range(fixed.raw_min, fixed.raw_max + 1)]
    wanted = [expected(number, Fraction(row["a"], 1 << fixed.frac_bits)) for row in rows]
    assert_equal(rows, simulate(FixedToFloat(a=fixed, result=number), rows), wanted)
    rows = [{"a": bits} for bits in patterns(number)]
    for rounding in (Rounding.HALF_UP, Rounding.FLOOR):
        wanted = [to_fixed(value(number, row["a"]), fixed, rounding) for row in rows]
        assert_equal(rows, simulate(FloatToFixed(a=number, result=fixed, rounding=rounding), rows), wanted)


@pytest.mark.parametrize(("number", "fixed", "rounding"), [
    (N.view, SQ(15, 10), Rounding.HALF_UP), (N.view, N.depth, Rounding.HALF_UP), (N.work, N.colour, Rounding.HALF_UP),
    (N.work, SQ(15, 10), Rounding.FLOOR)], ids=str)
def test_the_machines_conversions_to_fixed(number, fixed, rounding):
    rng = random.Random(6)
    ulp = Fraction(1, 1 << fixed.frac_bits)
    halves = [k * ulp / 2 * s for k in (*range(1, 40), *range(fixed.raw_max - 9, fixed.raw_max + 9)) for s in (1, -1)]
    operands = [*edges(number), *(expected(number, x)[0] for x in halves), *(
        expected(number, Fraction(rng.randint(-4 * fixed.raw_max, 4 * fixed.raw_max), 4) * ulp)[0] for _ in range(600))]
    rows = [{"a": bits} for bits in operands]
    wanted = [to_fixed(value(number, bits), fixed, rounding) for bits in operands]
    assert_equal(rows, simulate(FloatToFixed(a=number, result=fixed, rounding=rounding), rows, bubbles=0.2), wanted)


@pytest.mark.parametrize(("fixed", "number"), [
    (SQ(1, 26), N.work), (N.sh_dc, N.work), (N.cut, N.work), (UQ(30, 0), N.view)], ids=str)
def test_the_machines_conversions_from_fixed(fixed, number):
    rng = random.Random(7)
    some = [(1 << k) + d for k in range(fixed.width - fixed.signed) for d in (-1, 0, 1)]
    some += [rng.randrange(1 << rng.randrange(1, fixed.width)) for _ in range(600)]
    some += [(rng.getrandbits(number.sig_bits) * 2 + 1) << max(0, fixed.width - number.sig_bits - 3) for _ in range(100)]
    some = [x for x in (*some, *(-x for x in some), fixed.raw_min, fixed.raw_max) if fixed.raw_min <= x <= fixed.raw_max]
    rows = [{"a": raw} for raw in some]
    wanted = [expected(number, Fraction(raw, 1 << fixed.frac_bits)) for raw in some]
    assert_equal(rows, simulate(FixedToFloat(a=fixed, result=number), rows, bubbles=0.2), wanted)


UNITS = {
    FloatAdd: (TINY, TINY), FloatMul: (TINY, TINY), FloatDivide: (TINY, TINY), FloatReciprocal: (TINY,), FloatRsqrt: (TINY,),
    FloatSqrt: (TINY,), FixedToFloat: (SQ(3, 4),), FloatToFixed: (TINY,)}


@pytest.mark.parametrize("kind", UNITS)
def test_reset_drops_what_is_on_its_way(kind):
    unit = kind(**dict(zip("ab", UNITS[kind], strict=False)), result=SQ(3, 4) if kind is FloatToFixed else TINY)
    top, domain, seen = Module(), ClockDomain("sync"), []
    top.domains += domain
    top.submodules.unit = unit

    async def bench(ctx) -> None:
        ctx.set(unit.valid, 1)
        await ctx.tick().repeat(2)
        ctx.set(unit.valid, 0)
        ctx.set(domain.rst, 1)
        await ctx.tick()
        ctx.set(domain.rst, 0)
        for _ in range(unit.latency + 3):
            seen.append(ctx.get(unit.result_valid))
            await ctx.tick()

    simulator = Simulator(top)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert seen and not any(seen)


@pytest.mark.parametrize(("make", "error", "bad"), [
    (lambda: FloatAdd(a=3, b=TINY, result=TINY), TypeError, 3),
    (lambda: FloatMul(a=TINY, b=SQ(1, 2), result=TINY), TypeError, SQ(1, 2)),
    (lambda: FloatDivide(a=TINY, b=TINY, result=None), TypeError, None),
    (lambda: FloatReciprocal(a="view", result=TINY), TypeError, "view"),
    (lambda: FixedToFloat(a=TINY, result=TINY), TypeError, TINY),
    (lambda: FloatToFixed(a=TINY, result=TINY), TypeError, TINY),
    (lambda: FloatToFixed(a=TINY, result=SQ(1, 2), rounding=Rounding.HALF_EVEN), ValueError, Rounding.HALF_EVEN),
    (lambda: FloatDivide(a=SmallFloat(4, 3, 3), b=TINY, result=TINY), ValueError, SmallFloat(4, 3, 3)),
    (lambda: FloatSqrt(a=SmallFloat(7, 3, 3), result=TINY), ValueError, SmallFloat(7, 3, 3)),
    (lambda: FloatReciprocal(a=SmallFloat(2, 3, 3), result=SmallFloat(12, 3, 3)), ValueError, SmallFloat(12, 3, 3)),
])
def test_formats_that_do_not_fit_are_refused(make, error, bad):
    assert_rejected(make, error, bad)


def test_emission_is_deterministic():
    assert to_verilog(FloatMul(a=N.work, b=N.work, result=N.work), "mul") == to_verilog(
        FloatMul(a=N.work, b=N.work, result=N.work), "mul")
