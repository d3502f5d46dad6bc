"""Correct rounding into small floats by rational arithmetic: nothing of it is floating point."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt

from spec.formats import SmallFloat


def round_exactly(x: Fraction, target: SmallFloat) -> Fraction:
    """`x` rounded to nearest, ties to even, at unbounded exponent; then flushed below the smallest and saturated."""
    magnitude = abs(x)
    if magnitude == 0:
        return Fraction(0)
    exponent = magnitude.numerator.bit_length() - magnitude.denominator.bit_length()
    exponent -= magnitude < Fraction(2) ** exponent
    ulp = Fraction(2) ** (exponent - target.sig_bits + 1)
    magnitude = round(magnitude / ulp) * ulp  # Fraction rounds half to even
    if magnitude < Fraction(2) ** target.exp_min:
        return Fraction(0)
    largest = (2 - Fraction(1, 1 << target.sig_bits - 1)) * Fraction(2) ** target.exp_max
    return min(magnitude, largest) * (1 if x > 0 else -1)


def square_root(x: Fraction, bits: int = 128) -> Fraction:
    """A number that rounds like the root of `x` to any precision well below `bits`: its bits, and a sticky one below them."""
    scaled = (x.numerator << 2 * bits) // x.denominator
    root = isqrt(scaled)
    exact = Fraction(root, 1 << bits) ** 2 == x
    return Fraction(2 * root + (not exact), 2 << bits)
