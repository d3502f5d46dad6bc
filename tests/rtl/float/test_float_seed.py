"""Reciprocals and roots over all significands, in integers: float64 and one rounding are right, seeds keep their bounds."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from rtl.float.seed import seed, seeds
from spec.config import NumberFormats
from spec.formats import SmallFloat

N = NumberFormats()
USED = [SmallFloat(bits, 8, 127) for bits in (10, 12, 14, 16, 18, 20)]
"""The `work` format as it is and as `make tradeoff` tries it; the `view` format, too, is among them."""


def significands(bits: int) -> np.ndarray:
    """All of them, as integers."""
    return np.arange(1 << bits - 1, 1 << bits, dtype=np.int64)


def in_ulps(number: SmallFloat, result: np.ndarray, ulp_bits: int) -> np.ndarray:
    """float64 results rounded to the format, in units of 2^-ulp_bits."""
    units = np.ldexp(number.round(result), ulp_bits)
    assert (units == np.rint(units)).all()
    return units.astype(np.int64)


@pytest.mark.parametrize("number", [*USED, SmallFloat(22, 8, 127)], ids=str)
def test_rounding_the_float64_reciprocal_is_correct(number):
    """1 / m in (1/2, 1]: k ulps are nearest when (2 k - 1) m < 2 < (2 k + 1) m, in ulps; a tie would be an equality."""
    p = number.sig_bits
    m = significands(p)[1:]
    k = in_ulps(number, 1 / np.ldexp(m.astype(float), 1 - p), p)
    two = 1 << 2 * p
    assert ((2 * k - 1) * m < two).all() and (two < (2 * k + 1) * m).all()
    assert number.round(1 / 1.0) == 1


def test_the_used_formats_are_covered():
    assert N.work in USED and N.view in USED


@pytest.mark.parametrize("parity", [0, 1])
@pytest.mark.parametrize("number", USED, ids=str)
def test_rounding_the_float64_reciprocal_root_is_correct(number, parity):
    """Two operations of float64 and one rounding: (2 k - 1)^2 m < 4 < (2 k + 1)^2 m, in ulps, for every m in [1, 4)."""
    p = number.sig_bits
    m = significands(p)[1 - parity :] << parity
    k = in_ulps(number, 1.0 / np.sqrt(np.ldexp(m.astype(float), 1 - p)), p)
    four = 1 << 3 * p + 1  # (2 k)^2 m counts 2^-(2 p + 2) and 2^-(p - 1)
    assert ((2 * k - 1) ** 2 * m < four).all() and (four < (2 * k + 1) ** 2 * m).all()


@pytest.mark.parametrize("parity", [0, 1])
@pytest.mark.parametrize("number", USED, ids=str)
def test_rounding_the_float64_root_is_correct(number, parity):
    p = number.sig_bits
    m = significands(p) << parity
    k = in_ulps(number, np.sqrt(np.ldexp(m.astype(float), 1 - p)), p - 1)
    scaled = m << p + 1  # (2 k)^2 counts 2^-2 p
    assert ((2 * k - 1) ** 2 < scaled).all() and (scaled < (2 * k + 1) ** 2).all()


@pytest.mark.parametrize("sig_bits", [2, 3, 4, 7, 18, 20])
@pytest.mark.parametrize("root", [False, True])
def test_bounds_of_seeds_hold_and_are_met(root, sig_bits):
    """Residuals in exact integers, over all significands."""
    for s in [*islice(seeds(root, sig_bits), 0, 40, 7), seed(root, sig_bits, 0, 4)]:
        low, high = 0.0, 0.0
        for parity in range(1 + root):
            m = significands(sig_bits)
            t = (m - m[0]) >> max(0, sig_bits - 1 - s.index_bits - s.t_bits)
            entry = (t >> s.t_bits) + (parity << s.index_bits)
            fall = np.array(s.slope)[entry] * (t & (1 << s.t_bits) - 1)
            y = (np.array(s.offset)[entry] << s.slope_frac) - fall >> s.slope_frac
            one = 1 << sig_bits - 1 + s.frac_bits * (1 + root)
            residual = one - (m << parity) * y ** (1 + root)
            low, high = min(low, residual.min() / one), max(high, residual.max() / one)
            assert (y > 0).all()
        assert (low, high) == (s.low, s.high)
