"""Small floats against APyTypes and against rational arithmetic: exhaustive up to 8 bits, random above."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest
from apytypes import APyFloatArray, QuantizationMode

from spec.config import NumberFormats
from spec.formats import SmallFloat
from tests.helpers.exact_rounding import round_exactly

SMALL = [
    SmallFloat(sig, exp, bias, signed)
    for sig, exp, signed in itertools.product(range(2, 8), range(2, 8), (False, True))
    for bias in ((1 << exp - 1) - 1, -3)
    if sig - 1 + exp + signed <= 8
]
MACHINE = sorted({f for f in vars(NumberFormats()).values() if isinstance(f, SmallFloat)}, key=str)


def oracle(x: np.ndarray, target: SmallFloat) -> np.ndarray:
    """`x` rounded by APyTypes at an exponent two bits wider, so that its infinities and subnormals stay out of reach;
    the range is then ours: flushed below the smallest normal, saturated above the largest number, which has the
    exponent that IEEE formats keep for infinities."""
    wide = APyFloatArray.from_float(x.tolist(), exp_bits=11, man_bits=52).cast(
        exp_bits=target.exp_bits + 2, man_bits=target.sig_bits - 1, bias=target.bias + (1 << target.exp_bits),
        quantization=QuantizationMode.TIES_EVEN).to_numpy()
    wide = np.where(np.abs(wide) < target.min, 0.0, wide)
    return np.clip(wide, -target.max if target.signed else 0.0, target.max)


def inputs(target: SmallFloat, count: int | None = None) -> np.ndarray:
    """Reals with two significand bits more, from far below the smallest number to beyond the largest: all, or some."""
    finer = 1 << target.sig_bits + 1
    if count is None:
        significands, exponents = np.arange(finer, 2 * finer), np.arange(target.exp_min - 2, target.exp_max + 2)
        x = np.ldexp(significands[:, None] / finer, exponents).ravel()
    else:
        rng = np.random.default_rng(target.width)
        x = np.ldexp(rng.integers(finer, 2 * finer, count) / finer, rng.integers(target.exp_min - 2, target.exp_max + 2, count))
    return np.concatenate([x, -x, [0.0, -0.0]])


def test_rounding_is_apytypes_at_every_small_width():
    for target in SMALL:
        x = inputs(target)
        assert np.array_equal(target.round(x), oracle(x, target)), target
        assert np.array_equal(target.to_float(target.quantise(x)), oracle(x, target)), target


@pytest.mark.parametrize("target", MACHINE, ids=str)
def test_rounding_is_apytypes_and_exact_in_the_machines_formats(target):
    x = inputs(target, 2000)
    expected = oracle(x, target)
    assert np.array_equal(target.round(x), expected)
    assert np.array_equal(target.to_float(target.quantise(x)), expected)
    if target.signed:
        assert [float(round_exactly(Fraction(v), target)) for v in x[::10]] == expected[::10].tolist()


def test_bit_patterns_round_trip_at_every_small_width():
    for target in SMALL:
        bits = np.arange(1 << target.width, dtype=np.uint64)
        value = target.to_float(bits)
        zero = bits >> np.uint64(target.sig_bits - 1) & np.uint64((1 << target.exp_bits) - 1) == 0
        assert (value[zero] == 0).all() and not np.signbit(value[zero]).any(), target
        assert len(set(value[~zero])) == (~zero).sum() and value.max() == target.max, target
        assert np.abs(value[~zero]).min() == target.min, target
        assert np.array_equal(target.quantise(value[~zero]), bits[~zero]), target
        assert (target.quantise(value[zero]) == 0).all(), target


@pytest.mark.parametrize("target", [*SMALL, *MACHINE], ids=str)
def test_patterns_mean_what_apytypes_reads(target):
    """Same fields, same value; read at a wider and shifted exponent, where APyTypes has no subnormals and infinities."""
    rng = np.random.default_rng(2)
    exponent = rng.integers(1, 1 << target.exp_bits, 200)
    fraction = rng.integers(0, 1 << target.sig_bits - 1, 200)
    sign = rng.integers(0, 1 + target.signed, 200)
    bits = (sign << target.exp_bits | exponent) << target.sig_bits - 1 | fraction
    shift = 1 << target.exp_bits
    read = APyFloatArray(sign.tolist(), (exponent + shift).tolist(), fraction.tolist(), exp_bits=target.exp_bits + 2,
                         man_bits=target.sig_bits - 1, bias=target.bias + shift)
    assert np.array_equal(target.to_float(bits), read.to_numpy())


@pytest.mark.parametrize("target", [*SMALL[::7], *MACHINE], ids=str)
def test_fields_give_the_value_back(target):
    bits = target.quantise(inputs(target, 300))
    significand, exponent = target.fields(bits)
    assert np.array_equal(np.ldexp(significand.astype(float), exponent - target.sig_bits + 1), target.to_float(bits))
    zero = significand == 0
    assert (exponent[zero] == target.exp_min).all()
    assert (np.abs(significand[~zero]) >> target.sig_bits - 1 == 1).all()


@pytest.mark.parametrize("target", MACHINE, ids=str)
def test_edges(target):
    assert target.round([np.inf, 1e308]).tolist() == [target.max] * 2
    assert target.round([-np.inf, -1e308]).tolist() == [-target.max if target.signed else 0.0] * 2
    half = target.min * (1 - 2.0 ** -(target.sig_bits + 1))  # a tie with the smallest number, whose significand is even
    assert target.round([half, np.nextafter(half, 0), target.min / 2]).tolist() == [target.min, 0.0, 0.0]
    negative_zero = target.round(-0.0)
    assert negative_zero == 0 and not np.signbit(negative_zero) and target.quantise(-0.0) == 0
    with pytest.raises(ValueError, match="NaN"):
        target.round(np.nan)


@pytest.mark.parametrize(("arguments", "error", "bad"), [
    ((1, 4, 7), ValueError, 1), ((26, 4, 7), ValueError, 26), ((4, 1, 7), ValueError, 1), ((4, 11, 7), ValueError, 11),
    ((4, 4, 1001), ValueError, 1001), ((4.0, 4, 7), TypeError, 4.0), ((4, True, 7), TypeError, True),
    ((4, 4, None), TypeError, None),
])
def test_bad_widths_are_refused(arguments, error, bad):
    with pytest.raises(error, match=f"not {bad!r}$"):
        SmallFloat(*arguments)
