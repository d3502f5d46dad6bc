"""The decoding of compact geometry in whole numbers and fractions, one value at a time, as `spec.compact` says it in words."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from spec import compact as text
from spec.formats import SmallFloat
from tests.helpers.exact_rounding import round_exactly


def rs(x: int, n: int) -> int:
    """(x + 2^(n-1)) >> n."""
    return (x + (1 << n - 1)) >> n


def position(number: SmallFloat, low: int, code: int, step: int) -> int:
    """The bits of a coordinate."""
    at = Fraction(float(number.to_float(low))) + code * Fraction(2) ** (step - text.STEP_BIAS)
    return int(number.quantise(float(round_exactly(at, number))))


def scale(code: int, scale_top: int, coarse: bool) -> int:
    """The bits of a scale."""
    c = 8 * scale_top - (2 * code if coarse else code)
    if code == (1 << text.scale_bits(coarse)) - 1 or c < 128:
        return 0
    return (c >> 7) << 11 | text.SCALE_FRACTIONS[c & 127]


def quaternion(largest: int, codes: Sequence[int], coarse: bool) -> list[int]:
    """The four components."""
    others = [rs(code * text.ROOT_HALF, text.quaternion_bits(coarse) - 1) for code in codes]
    x = max((1 << 26) - sum(q * q for q in others), 1 << 24)
    i, r = (x >> 20) - 16, (x >> 12) & 255
    return [*others[:largest], min(rs(32 * text.ROOT_BASE[i] + text.ROOT_SLOPE[i] * r, 8), 8191), *others[largest:]]


def opacity(code: int) -> int:
    """Raw `log2_opacity`."""
    return text.OPACITY_LOG2[code] if code <= text.OPACITY_ONE else (code - text.OPACITY_ONE) << text.OPACITY_STEP_LOG2
