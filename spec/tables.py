"""ROM contents and derived integer constants of the array, for golden and RTL alike: data, not arithmetic."""

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
    """(base, slope), int64 (segments,): the piecewise linear 2^f on [0, 1).

    mantissa = base[s] + floor(slope[s] * r / 2^k), where f's raw value (fraction bits of `cut`) is s * 2^b + r,
    k = EXP2_SLOPE_FRAC + (fraction bits of `cut`) - (fraction bits of `alpha`). Base and mantissa have `alpha`'s fraction;
    slopes are UQ1.EXP2_SLOPE_FRAC. The base of a segment minimises its largest error given the rounded slope.
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
    """int64 (2^BLEND_INDEX_BITS,): raw blend weight for t in [0, 1), taken at the middle of each step."""
    t = (np.arange(1 << BLEND_INDEX_BITS) + 0.5) / (1 << BLEND_INDEX_BITS)
    return formats.blend_weight.quantise(t * t * (3 - 2 * t))


def log2_alpha_min(formats: NumberFormats) -> int:
    """Raw `cut` of alpha = 1/255."""
    return int(formats.cut.quantise(math.log2(ALPHA_MIN)))


def scaled_low_pass(formats: NumberFormats) -> float:
    """LOW_PASS among covariances that are divided by EXPONENT_SCALE^2, in the `work` format."""
    return float(formats.work.round(LOW_PASS / EXPONENT_SCALE**2))


def support_exponent(config: AcceleratorConfig) -> int | None:
    """Raw (fraction of `cut`) exponent lost at the support radius; None where the support is not cut."""
    if config.support_sigma is None:
        return None
    return round(LOG2E_HALF * config.support_sigma**2 * (1 << config.formats.cut.frac_bits))


def alpha_max_l1(formats: NumberFormats) -> int:
    """Raw alpha of level 1's upper bound."""
    return int(formats.alpha.quantise(ALPHA_MAX_L1))


def t_stop(formats: NumberFormats) -> int:
    """Raw transmittance: a pixel stops below it."""
    return math.ceil(T_STOP * (1 << formats.transmittance.frac_bits))


CENTRE_EXPONENT_MAX = 512
"""A pair whose falloff exponent at the tile's centre reaches this cannot touch the tile: dropped by the setup unit.

A touching pair has sqrt(exponent) <= sqrt(15) somewhere in the tile (alpha >= 1/255 with amplification 128), and the
exponent's square root grows by at most EXPONENT_SCALE / sqrt(LOW_PASS) = 1.551 a pixel, over at most 8 sqrt(2) pixels to
the reference point (8, 8): (3.87 + 17.55)^2 = 459. Kept pairs therefore stay below (sqrt(512) + 17.55)^2 = 1,614 over
the whole tile, which the exponent's 11 integer bits hold.
"""
