"""Rounding of float64 results to small floats inside numba kernels: one arithmetic operation is followed by one `rnd`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden.kernels import compiled
from spec.formats import SmallFloat

_FRACTION = 52

operation = compiled(forceinline=True, error_model="numpy")
"""Decorator for the parts of a kernel that LLVM has to vectorise: they are inlined, and divisions by zero do not raise."""


class RoundTo(NamedTuple):
    """A SmallFloat as the constants that `rnd` needs."""

    drop: int
    low: int
    mask: int
    smallest: float
    largest: float


def round_to(target: SmallFloat) -> RoundTo:
    """The rounding constants of one format."""
    drop = _FRACTION + 1 - target.sig_bits
    return RoundTo(drop, (1 << (drop - 1)) - 1, ~((1 << drop) - 1), target.min, target.max)


@operation
def rnd(x, f):
    """float64 `x` rounded to format `f`, HALF_EVEN; flushed to zero below the smallest number, saturating above the largest.

    With at most 25 significand bits, rounding the float64 result of one + - * / or sqrt gives the correctly rounded small float
    (Figueroa 1995).
    """
    bits = np.float64(x).view(np.int64)
    y = np.int64((bits + f.low + (bits >> f.drop & 1)) & f.mask).view(np.float64)
    if abs(y) < f.smallest:
        return 0.0
    return min(max(y, -f.largest), f.largest)


@operation
def pattern(x, f):
    """Exponent and fraction of a positive number of format `f` as one integer; it grows by 1 for each ulp."""
    return np.float64(x).view(np.int64) >> f.drop


@operation
def dot3(f, a0, a1, a2, b0, b1, b2):
    """The scalar product a . b, with every product and every sum rounded, from left to right."""
    return rnd(rnd(rnd(a0 * b0, f) + rnd(a1 * b1, f), f) + rnd(a2 * b2, f), f)
