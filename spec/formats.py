"""Number formats: fixed point and small floating point.

A format turns real numbers into raw integers and back; it holds no arithmetic. It is written the same way everywhere, in
tables, configuration files and on the command line:

    UQ1.8             unsigned fixed point: 1 integer bit and 8 fraction bits, 9 bits in all
    SQ5.14            signed fixed point: a sign bit, 5 integer bits and 14 fraction bits, 20 bits in all
    float18e8b127     small float: a sign bit, 8 exponent bits of bias 127, 18 significand bits (17 stored), 26 bits in all
    ufloat12e6b40     the same without a sign bit: 6 exponent bits of bias 40, 12 significand bits (11 stored), 17 bits in all

The sign bit of `SQ` is not counted among the integer bits, so that `SQ5.14` reaches from -32 up to 32 less an ulp. Amaranth's
RFC 41 counts the sign bit in `i_bits` and writes the same format SQ(6, 14).

Rounding and overflow are named, so that golden and RTL can say which one they implement:

    FLOOR       towards minus infinity: drop the low bits
    HALF_UP     nearest, ties towards plus infinity: add half an ulp, then drop the low bits
    HALF_EVEN   nearest, ties to even: IEEE 754's default

Fixed-point formats saturate. Small floats saturate to the largest magnitude and flush results below the smallest
normal to zero; there are no subnormals, infinities or NaNs, and no negative zero.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

import numpy as np

from spec.errors import InputError


class Rounding(Enum):
    """How a real number becomes a multiple of the ulp."""

    FLOOR = "floor"
    HALF_UP = "half_up"
    HALF_EVEN = "half_even"


def _round(x: np.ndarray, rounding: Rounding) -> np.ndarray:
    if rounding is Rounding.HALF_EVEN:
        return np.asarray(np.rint(x))
    below = np.asarray(np.floor(x))
    return below if rounding is Rounding.FLOOR else np.asarray(below + (x - below >= 0.5))  # x + 0.5 may itself round up


def _check_count(name: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError(f"{name} must be an integer, not {value!r}")
    if not low <= value <= high:
        raise ValueError(f"{name} must be in {low}..{high}, not {value!r}")


@dataclass(frozen=True)
class Fixed:
    """A fixed-point format: `int_bits` integer bits, `frac_bits` fraction bits and, where it is signed, a sign bit besides.

    Attributes:
        int_bits: integer bits; the sign bit is not one of them.
        frac_bits: fraction bits; the ulp is 2**-frac_bits.
        signed: two's complement, with a sign bit above the integer bits.
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
        return np.asarray(np.clip(scaled, self.raw_min, self.raw_max).astype(np.int64))

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
    """Signed fixed point of 1 + `int_bits` + `frac_bits` bits: the sign bit is not one of the integer bits."""
    return Fixed(int_bits, frac_bits, True)


def UQ(int_bits: int, frac_bits: int) -> Fixed:
    """Unsigned fixed point of `int_bits` + `frac_bits` bits."""
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
        return f"{'' if self.signed else 'u'}float{self.sig_bits}e{self.exp_bits}b{self.bias}"

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

NOTATION = "UQ1.8, SQ5.14, float18e8b127 or ufloat12e6b40"
"""One example of each way to write a format, for messages."""

_FIXED = re.compile(r"([US])Q(\d{1,3})\.(\d{1,3})")
_FLOAT = re.compile(r"(u?)float(\d{1,3})e(\d{1,3})b(-?\d{1,4})")


def parse_format(text: str) -> Format:
    """The format that `text` writes as `str(format)` does; InputError for anything else."""
    fixed, small = _FIXED.fullmatch(text.strip()), _FLOAT.fullmatch(text.strip())
    try:
        if fixed:
            return Fixed(int(fixed[2]), int(fixed[3]), fixed[1] == "S")
        if small:
            return SmallFloat(int(small[2]), int(small[3]), int(small[4]), not small[1])
    except ValueError as error:
        raise InputError(f"format {text!r} is not accepted: {error}") from error
    raise InputError(f"format {text!r} is not accepted: write it as in {NOTATION}")
