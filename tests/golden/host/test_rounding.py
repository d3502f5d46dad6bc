"""One operation, one `rnd`: against SmallFloat.round, and against rational arithmetic."""

from __future__ import annotations

import operator
from fractions import Fraction

import numba
import numpy as np
import pytest

from golden.host.rounding import dot3, pattern, rnd, round_to
from spec.config import NumberFormats
from spec.formats import SmallFloat
from tests.helpers.exact_rounding import round_exactly, square_root

N = NumberFormats()
FORMATS = [N.view, N.work, N.conic, SmallFloat(25, 8, 127), SmallFloat(3, 4, 7)]
OPERATIONS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}


@numba.njit
def rnd_all(x, f):
    return np.array([rnd(v, f) for v in x])


def numbers(target: SmallFloat, count: int, seed: int, spread: int = 20) -> np.ndarray:
    """Random numbers of the format around 1; exponents near each other now and then, for cancellation."""
    rng = np.random.default_rng(seed)
    low, high = max(target.exp_min, -spread), min(target.exp_max, spread)
    x = np.ldexp(rng.uniform(1, 2, count), rng.integers(low, high, count, endpoint=True)) * rng.choice((-1, 1), count)
    return target.round(x)


@pytest.mark.parametrize("target", FORMATS, ids=str)
def test_rnd_is_the_formats_own_rounding(target):
    rng = np.random.default_rng(1)
    x = np.ldexp(rng.normal(size=4000), rng.integers(target.exp_min - 3, target.exp_max + 4, 4000))
    ties = np.ldexp(rng.integers(1 << target.sig_bits, 2 << target.sig_bits, 1000), int(-target.sig_bits))
    edges = np.array([target.min, target.min / 2, target.min * (1 - 2.0**-40), target.max, target.max * 2, np.inf, 0.0])
    x = np.concatenate([x, ties, edges, np.nextafter(ties, 0), np.nextafter(ties, 9)])
    x = np.concatenate([x, -x])
    assert np.array_equal(rnd_all(x, round_to(target)), target.round(x))


@pytest.mark.parametrize("symbol", OPERATIONS)
@pytest.mark.parametrize("target", FORMATS, ids=str)
def test_rounding_the_float64_result_rounds_the_operation_correctly(target, symbol):
    """Figueroa's theorem: float64 has at least 2 p + 2 significand bits for p <= 25."""
    operate, f = OPERATIONS[symbol], round_to(target)
    spread = min(20, target.sig_bits + 2)
    a, b = numbers(target, 400, 2, spread), numbers(target, 400, 3, spread)
    a, b = np.concatenate([a, b, a, a]), np.concatenate([b, b, a, target.round(a * (1 + 2.0 ** (1 - target.sig_bits)))])
    for x, y in zip(a.tolist(), b.tolist(), strict=True):
        if symbol == "/" and y == 0:
            continue
        assert rnd(operate(x, y), f) == float(round_exactly(operate(Fraction(x), Fraction(y)), target)), (x, y)


@pytest.mark.parametrize("target", FORMATS, ids=str)
def test_roots_and_their_halves_are_correct(target):
    f = round_to(target)
    squares = np.arange(1, 50) ** 2.0
    for x in [*np.abs(numbers(target, 500, 4)).tolist(), *target.round(squares).tolist()]:
        if x > 0:
            assert rnd(np.sqrt(x), f) == float(round_exactly(square_root(Fraction(x)), target)), x


def test_the_oracle_of_roots_is_right():
    assert square_root(Fraction(9, 4)) == Fraction(3, 2)
    low = square_root(Fraction(2)) - Fraction(1, 1 << 100)
    assert low**2 < 2 < (low + Fraction(1, 1 << 99)) ** 2


def test_one_rounding_too_many_would_be_noticed():
    """With 27 significand bits the theorem's condition fails: rounding through float64 gives a wrong sum."""
    target = SmallFloat(25, 8, 127)
    x, y = Fraction(1) + Fraction(1, 1 << 25), Fraction(1, 1 << 80)  # a tie and a hair, which float64 drops
    assert rnd(float(x) + float(y), round_to(target)) != float(round_exactly(x + y, target))


@pytest.mark.parametrize("target", [N.view, N.conic], ids=str)
def test_patterns_rise_by_one_an_ulp(target):
    f = round_to(target)
    x = np.sort(np.abs(numbers(target, 500, 5)))
    got = [pattern(v, f) for v in x.tolist()]
    assert np.array_equal(np.diff(got) > 0, np.diff(x) > 0)
    one_up = target.to_float(target.quantise(x[x < target.max]) + np.uint64(1))
    assert [pattern(v, f) for v in one_up.tolist()] == [p + 1 for p in got[: len(one_up)]]


def test_dot_product_rounds_every_step_left_to_right():
    target, f = N.work, round_to(N.work)
    a, b = numbers(target, 300, 6).reshape(-1, 3), numbers(target, 300, 7).reshape(-1, 3)

    def step(x: Fraction) -> Fraction:
        return round_exactly(x, target)

    for p, q in zip(a.tolist(), b.tolist(), strict=True):
        products = [step(Fraction(x) * Fraction(y)) for x, y in zip(p, q, strict=True)]
        assert dot3(f, *p, *q) == float(step(step(products[0] + products[1]) + products[2]))
