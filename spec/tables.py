"""ROM contents and derived integer constants of the array. Golden renderer and RTL share this data, but no arithmetic."""

from __future__ import annotations

import math

import numpy as np

from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, EXPONENT_SCALE, LOG2E_HALF, LOW_PASS, T_STOP

EXP2_SLOPE_FRAC = 6
"""Fraction bits of the slopes of the exponential's segments."""

BLEND_INDEX_BITS = 7
"""Bits of the blend parameter that address the smoothstep table."""


def exp2_segments(formats: NumberFormats) -> tuple[np.ndarray, np.ndarray]:
    """(base, slope), int64 (segments,): a piecewise linear approximation of 2^f for f in [0, 1).

    mantissa = base[s] + floor(slope[s] * r / 2^k), where f's raw value (fraction bits of `cut`) is s * 2^b + r,
    k = EXP2_SLOPE_FRAC + (fraction bits of `cut`) - (fraction bits of `alpha`). Base and mantissa have the fraction bits of
    `alpha`; slopes are UQ1.EXP2_SLOPE_FRAC. The base of each segment minimises its largest error given the rounded slope.
    """
    count, frac, input_frac = formats.exp2_segments, formats.alpha.frac_bits, formats.cut.frac_bits
    per_segment = (1 << input_frac) // count
    shift = EXP2_SLOPE_FRAC + input_frac - frac
    base, slope = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for s in range(count):
        r = np.arange(per_segment)
        exact = np.exp2((s * per_segment + r) / (1 << input_frac)) * (1 << frac)
        slope[s] = round((exact[-1] - exact[0]) / (per_segment - 1) * 2.0**shift)
        error = exact - np.floor(slope[s] * r / 2.0**shift)
        below_two = (2 << frac) - 1 - (int(slope[s]) * (per_segment - 1) >> shift)
        base[s] = np.clip(round((error.max() + error.min()) / 2), 1 << frac, below_two)
    return base, slope


def smoothstep_table(formats: NumberFormats) -> np.ndarray:
    """int64 (2^BLEND_INDEX_BITS,): raw blend weight, 3 t^2 - 2 t^3 for t in [0, 1), taken at the middle of each step."""
    t = (np.arange(1 << BLEND_INDEX_BITS) + 0.5) / (1 << BLEND_INDEX_BITS)
    return formats.blend_weight.quantise(t * t * (3 - 2 * t))


def log2_alpha_min(formats: NumberFormats) -> int:
    """log2(1/255), the exponent of the smallest visible alpha, as a raw number of format `cut`."""
    return int(formats.cut.quantise(math.log2(ALPHA_MIN)))


def scaled_low_pass(formats: NumberFormats) -> float:
    """LOW_PASS / EXPONENT_SCALE^2 in the `work` format, as it is added to covariances that are divided by EXPONENT_SCALE^2."""
    return float(formats.work.round(LOW_PASS / EXPONENT_SCALE**2))


def support_exponent(config: AcceleratorConfig) -> int | None:
    """Falloff exponent at the support radius, as a raw number with the fraction bits of `cut`; None where the support is not
    cut."""
    if config.support_sigma is None:
        return None
    return round(LOG2E_HALF * config.support_sigma**2 * (1 << config.formats.cut.frac_bits))


def alpha_max_l1(formats: NumberFormats) -> int:
    """ALPHA_MAX_L1, the upper bound of alpha in level 1, as a raw number of format `alpha`."""
    return int(formats.alpha.quantise(ALPHA_MAX_L1))


def t_stop(formats: NumberFormats) -> int:
    """T_STOP, the transmittance below which a pixel stops, as a raw number of format `transmittance`."""
    return math.ceil(T_STOP * (1 << formats.transmittance.frac_bits))


CENTRE_EXPONENT_MAX = 512
"""A splat whose falloff exponent at the tile's centre reaches this value cannot touch the tile, so the setup unit drops it
there.

A splat that touches the tile has sqrt(exponent) <= sqrt(15) at some pixel of it (alpha >= 1/255 with amplification 128). The
square root of the exponent grows by at most EXPONENT_SCALE / sqrt(LOW_PASS) = 1.551 per pixel, over at most 8 sqrt(2) pixels to
the reference point (8, 8): (3.87 + 17.55)^2 = 459. The exponents of kept splats therefore stay below
(sqrt(512) + 17.55)^2 = 1,614 over the whole tile, which the 11 integer bits of `exponent` hold.
"""
