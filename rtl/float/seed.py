"""First approximations of 1/m and 1/sqrt(m): tables of straight lines, with error bounds that hold for every m."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

_SLOPE_GUARD = 1
"""Fraction bits of a slope beyond those of t. With them, rounding a slope moves a segment's end by at most a quarter of the
seed's ulp."""


@dataclass(frozen=True)
class Seed:
    """y = (offset[i] * 2^slope_frac - slope[i] * t) >> slope_frac, in units of 2^-frac_bits, for a significand m in [1, 2).

    i is the top `index_bits` bits of m's fraction, for roots with the parity of the exponent above them; t is the next `t_bits`
    bits.

    Attributes:
        root: whether y approximates 1/sqrt(m), or 1/sqrt(2 m) for parity 1, instead of 1/m.
        index_bits, t_bits, frac_bits, slope_frac: the numbers of bits in the formula above.
        offset, slope: the tables.
        low, high: bounds of the residual 1 - m y, or 1 - m y^2 for roots.
    """

    root: bool
    index_bits: int
    t_bits: int
    frac_bits: int
    slope_frac: int
    offset: tuple[int, ...]
    slope: tuple[int, ...]
    low: float
    high: float

    @property
    def worst(self) -> float:
        """The largest magnitude of the residual."""
        return max(-self.low, self.high)


@cache
def seed(root: bool, sig_bits: int, index_bits: int, frac_bits: int) -> Seed:
    """The table with 2^index_bits segments per octave, and the residual's exact range over all significands of `sig_bits`."""
    t_bits = max(1, min(frac_bits, sig_bits - 1) - index_bits)
    slope_frac = t_bits + _SLOPE_GUARD
    offsets, slopes, low, high = [], [], 0.0, 0.0
    for parity in range(1 + root):
        for i in range(1 << index_bits):
            offset, slope, residuals = _segment(root, sig_bits, index_bits, t_bits, frac_bits, slope_frac, parity, i)
            offsets.append(offset)
            slopes.append(slope)
            low, high = min(low, residuals[0]), max(high, residuals[1])
    return Seed(root, index_bits, t_bits, frac_bits, slope_frac, tuple(offsets), tuple(slopes), low, high)


def _segment(
    root: bool, sig_bits: int, index_bits: int, t_bits: int, frac_bits: int, slope_frac: int, parity: int, i: int,
) -> tuple[int, int, tuple[float, float]]:
    """Offset and slope of one segment, and the extremes of its residual.

    As long as t does not change, the residual falls with m, so its extremes lie at the ends of the 2^t_bits cells.
    """
    t = np.arange(1 << t_bits)
    cell = 2.0 ** -(index_bits + t_bits)
    first = 1 + i * 2.0**-index_bits + t * cell
    last = first + cell - 2.0 ** (1 - sig_bits)
    first, last = first * 2.0**parity, last * 2.0**parity

    def exact(m: np.ndarray) -> np.ndarray:
        return 1 / np.sqrt(m) if root else 1 / m

    def residuals(offset: int) -> tuple[float, float]:
        y = ((offset << slope_frac) - slope * t >> slope_frac) * 2.0**-frac_bits
        y = y * y if root else y
        return float((1 - last * y).min()), float((1 - first * y).max())

    ends = exact(np.array([first[0], (first[-1] + cell * 2.0**parity)]))
    slope = int(np.rint((ends[0] - ends[1]) * 2.0 ** (frac_bits + slope_frac - t_bits)))
    guess = int(np.rint(ends[0] * 2.0**frac_bits))
    best = min(range(guess - 4 - (1 << frac_bits >> 2 * index_bits + 3), guess + 3), key=lambda o: max(map(abs, residuals(o))))
    return best, slope, residuals(best)


def seeds(root: bool, sig_bits: int) -> Iterator[Seed]:
    """Tables in order of size: those with the fewest segments first, and of these those with the fewest fraction bits first."""
    for index_bits in range(sig_bits - 1):
        for frac_bits in range(max(3, 2 * index_bits + 2), 2 * index_bits + 8):
            yield seed(root, sig_bits, index_bits, frac_bits)
