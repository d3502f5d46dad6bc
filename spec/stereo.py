"""Warping one eye's frame into the other's: formats and exact tests. docs/stereo.md has the arithmetic.

A pixel's disparity is S w / d. Here w is its coverage, the largest transmittance minus the pixel's own, and d is its depth sum;
both are raw numbers. S is the host's setting `disparity_scale`: the disparity of a point at the far end of the depth scale, in
units of 2^-DISPARITY_SCALE_FRAC pixels. The quotient is rounded down to a multiple of 2^-DISPARITY_FRAC pixels.
"""

from __future__ import annotations

import math

from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import COVERAGE_VALID, COVERAGE_VISIBLE, TILE
from spec.formats import UQ, Fixed

DISPARITY_FRAC = 8
"""Fraction bits of a disparity: half an ulp is 1/512 pixel, far below what the depth's own rounding costs."""

DISPARITY_SCALE_FRAC = 14
"""Fraction bits of S, the disparity in pixels where depth saturates."""

DISPARITY_SCALE_BITS = 24
"""Bits of the setting S. At its largest value even a point at the far end of the depth scale moves by 1,023 pixels."""

FILL_NEIGHBOURS = 5
"""Number of warped pixels that a hole needs among its eight neighbours to be filled. At an edge, where fewer than eight
neighbours exist in strip and frame, `warp_fill` "interior" needs the same number, and "majority" more than half of those that
exist."""


def disparity_drop(formats: NumberFormats) -> int:
    """Number of lowest bits of S w that are dropped before the division, so that it gives DISPARITY_FRAC fraction bits. The
    default formats give 3."""
    return DISPARITY_SCALE_FRAC + formats.transmittance.frac_bits - formats.depth_accumulator.frac_bits - DISPARITY_FRAC


def reach(config: AcceleratorConfig) -> int:
    """Largest number of columns by which a pixel may move. Pixels that would move further are dropped, like those that leave
    the frame.

    It is three quarters of the columns that the warp unit holds. The unit must hold a source pixel's column and every column
    to which the pixel may move; the last quarter is left for tiles that arrive while others are written. Where the unit holds
    whole rows, there is no limit: no shift inside a frame is as large as the row width.
    """
    return config.row_width if config.warp_columns >= config.row_width else config.warp_columns * 3 // 4


def clear_cycles(config: AcceleratorConfig) -> int:
    """Number of cycles in which the warp unit clears its columns after a reset: each lane clears two places per cycle."""
    return config.warp_columns * TILE // config.warp_lanes // 2


def disparity(config: AcceleratorConfig) -> Fixed:
    """Format of a disparity's magnitude in pixels. It saturates; a saturated disparity lies beyond `reach`, so its pixel is
    dropped."""
    return UQ(reach(config).bit_length(), DISPARITY_FRAC)


def background_transmittance(formats: NumberFormats) -> int:
    """Smallest raw transmittance T of a background pixel, whose coverage 1 - T / 2^(fraction bits) is below
    COVERAGE_VISIBLE."""
    one = 1 << formats.transmittance.frac_bits
    return one - math.ceil(one * COVERAGE_VISIBLE) + 1


def solid_transmittance(formats: NumberFormats) -> int:
    """Largest raw transmittance T of a pixel with a valid depth, whose coverage 1 - T / 2^(fraction bits) is at least
    COVERAGE_VALID."""
    one = 1 << formats.transmittance.frac_bits
    return one - math.ceil(one * COVERAGE_VALID)


def warped_transmittance(config: AcceleratorConfig) -> int:
    """Largest raw transmittance of a pixel that is warped by its depth. Pixels between this and the background's transmittance
    are not warped."""
    n = config.formats
    return background_transmittance(n) - 1 if config.warp_veiled else solid_transmittance(n)
