"""Fixed-point formats against APyTypes: exhaustive up to 8 bits, random above."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from apytypes import APyFixedArray, OverflowMode, QuantizationMode

from spec.config import NumberFormats
from spec.formats import SQ, UQ, Fixed, Rounding

MODES = {
    Rounding.FLOOR: QuantizationMode.TRN,
    Rounding.HALF_UP: QuantizationMode.RND,
    Rounding.HALF_EVEN: QuantizationMode.RND_CONV,
}
SMALL = [
    Fixed(i, f, signed)
    for i, f, signed in itertools.product(range(9), range(9), (False, True))
    if 1 <= i + f <= 8 - signed
]
MACHINE = sorted({f for f in vars(NumberFormats()).values() if isinstance(f, Fixed)}, key=str)
FINER = 3
"""Fraction bits of the inputs beyond the format's: every tie, and both neighbours of it."""


def oracle(raw: np.ndarray, target: Fixed, rounding: Rounding) -> np.ndarray:
    """`raw`, of FINER more fraction bits, cast by APyTypes; negative numbers of unsigned formats clamp to zero."""
    held = APyFixedArray(raw.tolist(), int_bits=target.int_bits + 4, frac_bits=target.frac_bits + FINER)
    cast = held.cast(
        int_bits=target.int_bits + 1, frac_bits=target.frac_bits, quantization=MODES[rounding], overflow=OverflowMode.SAT)
    values = np.ldexp(cast.to_numpy(), target.frac_bits).astype(np.int64)
    return values if target.signed else np.maximum(values, 0)


def inputs(target: Fixed, count: int | None = None) -> np.ndarray:
    """Raw numbers of FINER more fraction bits, reaching to twice the format's range: all, or `count` random ones."""
    top = 2 << target.int_bits + target.frac_bits + FINER
    if count is None:
        return np.arange(-top, top)
    rng = np.random.default_rng(target.width)
    near_edges = [edge * 2**FINER + np.arange(-20, 21) for edge in (target.raw_min, 0, target.raw_max)]
    return np.concatenate([rng.integers(-top, top, count), *near_edges])


@pytest.mark.parametrize("rounding", Rounding)
def test_quantise_is_apytypes_cast_at_every_small_width(rounding):
    for target in SMALL:
        raw = inputs(target)
        got = target.quantise(np.ldexp(raw, -target.frac_bits - FINER), rounding)
        assert np.array_equal(got, oracle(raw, target, rounding)), target


@pytest.mark.parametrize("rounding", Rounding)
@pytest.mark.parametrize("target", MACHINE, ids=str)
def test_quantise_is_apytypes_cast_in_the_machines_formats(target, rounding):
    raw = inputs(target, 2000)
    assert np.array_equal(
        target.quantise(np.ldexp(raw, -target.frac_bits - FINER), rounding), oracle(raw, target, rounding))


def test_half_up_is_the_default_and_modes_differ_at_ties():
    x, target = np.array([-1.5, -0.5, 0.5, 1.5, 2.5]), SQ(3, 0)
    assert target.quantise(x).tolist() == target.quantise(x, Rounding.HALF_UP).tolist() == [-1, 0, 1, 2, 3]
    assert target.quantise(x, Rounding.HALF_EVEN).tolist() == [-2, 0, 0, 2, 2]
    assert target.quantise(x, Rounding.FLOOR).tolist() == [-2, -1, 0, 1, 2]


def test_half_up_of_a_hair_below_a_tie_goes_down():
    """0.5 - 2^-54 plus 0.5 is 1 in float64: rounding must not take that way."""
    hair = np.nextafter([0.5, 1.5, -0.5], -np.inf)
    assert SQ(3, 0).quantise(hair).tolist() == [0, 1, -1]


def test_values_and_bit_patterns_round_trip_at_every_small_width():
    for target in SMALL:
        raw = np.arange(target.raw_min, target.raw_max + 1)
        assert len(raw) == 1 << target.width
        assert np.array_equal(target.quantise(target.to_float(raw)), raw), target
        bits = target.to_bits(raw)
        assert sorted(bits.tolist()) == list(range(1 << target.width)), target
        assert np.array_equal(target.from_bits(bits), raw), target
        as_apy = APyFixedArray(bits.tolist(), int_bits=target.int_bits + 1, frac_bits=target.frac_bits)
        if target.signed:
            assert np.array_equal(as_apy.to_numpy(), target.to_float(raw)), target


@pytest.mark.parametrize("target", [*MACHINE, SQ(31, 22), UQ(0, 53)], ids=str)
def test_values_and_bit_patterns_round_trip_above(target):
    raw = np.random.default_rng(1).integers(target.raw_min, target.raw_max, 500, endpoint=True)
    raw = np.concatenate([raw, [target.raw_min, -1 if target.signed else 0, 0, 1, target.raw_max]])
    assert np.array_equal(target.from_bits(target.to_bits(raw)), raw)
    assert np.array_equal(target.quantise(target.to_float(raw)), raw)


@pytest.mark.parametrize("target", [SQ(3, 4), UQ(3, 4), SQ(31, 22)], ids=str)
def test_everything_beyond_saturates_and_nan_is_refused(target):
    assert target.quantise([np.inf, 1e300, 2.0**62]).tolist() == [target.raw_max] * 3
    assert target.quantise([-np.inf, -1e300, -(2.0**62)]).tolist() == [target.raw_min] * 3
    with pytest.raises(ValueError, match="NaN"):
        target.quantise([0.0, np.nan])


def test_shapes_are_kept():
    assert SQ(2, 3).quantise(0.5).shape == ()
    assert UQ(2, 3).to_float(np.zeros((2, 3), np.int32)).shape == (2, 3)


@pytest.mark.parametrize(("width", "low", "high", "name"), [(6, -32, 31, "SQ2.3"), (5, 0, 31, "UQ2.3")])
def test_properties(width, low, high, name):
    target = SQ(2, 3) if low else UQ(2, 3)
    assert (target.width, target.raw_min, target.raw_max, str(target)) == (width, low, high, name)


@pytest.mark.parametrize(("arguments", "error", "bad"), [
    ((1.0, 2), TypeError, 1.0), ((True, 2), TypeError, True), ((1, "2"), TypeError, "2"), ((-1, 2), ValueError, -1),
    ((54, 0), ValueError, 54), ((0, 54), ValueError, 54), ((0, 0), ValueError, 0), ((40, 40), ValueError, 80),
])
@pytest.mark.parametrize("make", [SQ, UQ])
def test_bad_widths_are_refused(make, arguments, error, bad):
    with pytest.raises(error, match=f"not {bad!r}$"):
        make(*arguments)
