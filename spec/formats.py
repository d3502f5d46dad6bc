"""Number formats: fixed point and small floating point.

A format turns real numbers into raw integers and back; it holds no arithmetic. Fixed-point formats are written SQi.f (signed)
and UQi.f (unsigned), where i is the number of integer bits without the sign and f the number of fraction bits. So SQ0.13 has
14 bits in all. (Amaranth's RFC 41 has the same names, but counts the sign in i.) Roundings are named, so that the golden
renderer and the RTL can say which one they implement:

    FLOOR       towards minus infinity: drop the low bits
    HALF_UP     nearest, ties towards plus infinity: add half an ulp, then drop the low bits
    HALF_EVEN   nearest, ties to even: IEEE 754's default

Fixed-point formats saturate. Small floats saturate to the largest magnitude and flush results below the smallest
normal to zero; there are no subnormals, infinities or NaNs, and no negative zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class Rounding(Enum):
    """How a real number becomes a multiple of the ulp."""

    FLOOR = "floor"
    HALF_UP = "half_up"
    HALF_EVEN = "half_even"


def _round(x: np.ndarray, rounding: Rounding) -> np.ndarray:
    if rounding is Rounding.FLOOR:
        return np.floor(x)
    if rounding is Rounding.HALF_UP:
        below = np.floor(x)
        return below + (x - below >= 0.5)  # x + 0.5 may itself round up
    return np.rint(x)


def _check_count(name: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError(f"{name} must be an integer, not {value!r}")
    if not low <= value <= high:
        raise ValueError(f"{name} must be in {low}..{high}, not {value!r}")


@dataclass(frozen=True)
class Fixed:
    """A fixed-point format: `int_bits` integer bits, not counting the sign, and `frac_bits` fraction bits.

    Attributes:
        int_bits: integer bits without the sign.
        frac_bits: fraction bits; the ulp is 2**-frac_bits.
        signed: whether the number is in two's complement, with one more bit for the sign.
    """

    int_bits: int
    frac_bits: int
    signed: bool

    def __post_init__(self) -> None:
        # No format is wider than float64's significand, so float64 holds every value exactly.
        _check_count("int_bits", self.int_bits, 0, 53)
        _check_count("frac_bits", self.frac_bits, 0, 53)
        _check_count("int_bits + frac_bits", self.int_bits + self.frac_bits, 1, 53)

    def __str__(self) -> str:
        return f"{'SQ' if self.signed else 'UQ'}{self.int_bits}.{self.frac_bits}"

    @property
    def width(self) -> int:
        """Bits in all, sign included."""
        return self.int_bits + self.frac_bits + self.signed

    @property
    def raw_min(self) -> int:
        """Smallest raw integer."""
        return -(1 << (self.width - 1)) if self.signed else 0

    @property
    def raw_max(self) -> int:
        """Largest raw integer."""
        return (1 << (self.int_bits + self.frac_bits)) - 1

    def quantise(self, x: np.ndarray | float, rounding: Rounding = Rounding.HALF_UP) -> np.ndarray:
        """Raw int64 of real `x` (any shape), saturated to the format's range. Raises ValueError for NaN."""
        x = np.asarray(x, dtype=np.float64)
        if np.isnan(x).any():
            raise ValueError(f"x must not be NaN to be quantised to {self}, not {x!r}")
        scaled = _round(np.ldexp(np.clip(x, -(2.0**63), 2.0**63), self.frac_bits), rounding)
        return np.clip(scaled, self.raw_min, self.raw_max).astype(np.int64)

    def to_float(self, raw: np.ndarray | int) -> np.ndarray:
        """float64 value of raw integers (any shape)."""
        return np.ldexp(np.asarray(raw, dtype=np.float64), -self.frac_bits)

    def to_bits(self, raw: np.ndarray | int) -> np.ndarray:
        """Two's complement bit pattern, uint64, of raw integers (any shape)."""
        return np.asarray(raw, dtype=np.int64).astype(np.uint64) & np.uint64((1 << self.width) - 1)

    def from_bits(self, bits: np.ndarray | int) -> np.ndarray:
        """Raw int64 of bit patterns (any shape)."""
        raw = np.asarray(bits, dtype=np.uint64).astype(np.int64)
        return np.where(self.signed & (raw >> (self.width - 1) & 1 == 1), raw - (1 << self.width), raw)


def SQ(int_bits: int, frac_bits: int) -> Fixed:
    """Signed fixed point; the sign is not counted in `int_bits`."""
    return Fixed(int_bits, frac_bits, True)


def UQ(int_bits: int, frac_bits: int) -> Fixed:
    """Unsigned fixed point."""
    return Fixed(int_bits, frac_bits, False)


@dataclass(frozen=True)
class SmallFloat:
    """A small floating-point format: sign, biased exponent, significand with a hidden leading one.

    Bits from the top: sign (if `signed`), exponent (`exp_bits`), fraction (`sig_bits - 1`). Exponent field 0 is the
    number zero. Value: (1 + fraction / 2**(sig_bits - 1)) * 2**(exponent - bias).

    Attributes:
        sig_bits: significand bits, including the hidden one. There are at most 25, so that one operation in float64 followed
            by one rounding gives the correctly rounded result (Figueroa 1995: p <= (53 - 2) / 2), provided that no operand
            of a sum is longer than its result.
        exp_bits: exponent bits.
        bias: exponent bias.
        signed: whether negative numbers exist; unsigned formats clamp them to zero.
    """

    sig_bits: int
    exp_bits: int
    bias: int
    signed: bool = True

    def __post_init__(self) -> None:
        _check_count("sig_bits", self.sig_bits, 2, 25)
        _check_count("exp_bits", self.exp_bits, 2, 10)
        _check_count("bias", self.bias, -1000, 1000)

    def __str__(self) -> str:
        return f"{'' if self.signed else 'u'}float(sig {self.sig_bits}, exp {self.exp_bits}, bias {self.bias})"

    @property
    def width(self) -> int:
        """Bits in all."""
        return self.signed + self.exp_bits + self.sig_bits - 1

    @property
    def exp_min(self) -> int:
        """Exponent of the smallest normal."""
        return 1 - self.bias

    @property
    def exp_max(self) -> int:
        """Exponent of the largest number."""
        return (1 << self.exp_bits) - 1 - self.bias

    @property
    def max(self) -> float:
        """Largest number."""
        return float(np.ldexp(2.0 - np.ldexp(1.0, 1 - self.sig_bits), self.exp_max))

    @property
    def min(self) -> float:
        """Smallest positive number."""
        return float(np.ldexp(1.0, self.exp_min))

    def round(self, x: np.ndarray | float) -> np.ndarray:
        """float64 of `x` (any shape), rounded into the format by HALF_EVEN. Raises ValueError for NaN."""
        x = np.asarray(x, dtype=np.float64)
        if np.isnan(x).any():
            raise ValueError(f"x must not be NaN to be rounded to {self}, not {x!r}")
        clipped = np.clip(x, -self.max if self.signed else 0.0, self.max)
        mantissa, exponent = np.frexp(clipped)
        rounded = np.ldexp(np.rint(np.ldexp(mantissa, self.sig_bits)), exponent - self.sig_bits)
        rounded = np.where(np.abs(rounded) < self.min, 0.0, rounded)
        return np.clip(rounded, -self.max, self.max) + 0.0

    def quantise(self, x: np.ndarray | float) -> np.ndarray:
        """Bit patterns, uint64, of real `x` (any shape), rounded by HALF_EVEN. Raises ValueError for NaN."""
        value = self.round(x)
        mantissa, exponent = np.frexp(np.abs(value))
        zero = value == 0
        fraction = np.ldexp(mantissa, self.sig_bits).astype(np.uint64) & np.uint64((1 << (self.sig_bits - 1)) - 1)
        biased = np.where(zero, 0, exponent - 1 + self.bias).astype(np.uint64)
        bits = (biased << np.uint64(self.sig_bits - 1)) | np.where(zero, np.uint64(0), fraction)
        return bits | ((value < 0).astype(np.uint64) << np.uint64(self.width - 1)) if self.signed else bits

    def to_float(self, bits: np.ndarray | int) -> np.ndarray:
        """float64 values of bit patterns (any shape)."""
        bits = np.asarray(bits, dtype=np.uint64)
        fraction = (bits & np.uint64((1 << (self.sig_bits - 1)) - 1)).astype(np.float64)
        exponent = (bits >> np.uint64(self.sig_bits - 1) & np.uint64((1 << self.exp_bits) - 1)).astype(np.int64)
        magnitude = np.ldexp(1.0 + np.ldexp(fraction, 1 - self.sig_bits), exponent - self.bias)
        sign = np.where(self.signed & (bits >> np.uint64(self.width - 1) & np.uint64(1) == 1), -1.0, 1.0)
        return np.where(exponent == 0, 0.0, sign * magnitude)

    def fields(self, bits: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """(significand, exponent), int64, of bit patterns: value = significand * 2**(exponent - sig_bits + 1).

        The significand is signed and includes the hidden one; zero gives (0, exp_min).
        """
        value = self.to_float(bits)
        exponent = np.where(value == 0, self.exp_min, np.frexp(value)[1] - 1)
        return np.ldexp(value, self.sig_bits - 1 - exponent).astype(np.int64), exponent.astype(np.int64)


Format = Fixed | SmallFloat
