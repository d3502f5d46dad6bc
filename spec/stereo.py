"""Warping one eye's frame into the other's: formats, exact tests and records; docs/stereo.md has the arithmetic.

A pixel's disparity is S w / d: w its coverage, the largest transmittance less its own, d its depth sum, both raw, and S the
host's `disparity_scale`, the disparity in pixels of what lies at the far end of the depth scale, as a multiple of
2^-DISPARITY_SCALE_FRAC. The quotient is floored in units of 2^-DISPARITY_FRAC pixels.
"""

from __future__ import annotations

import math

from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import COVERAGE_VALID, COVERAGE_VISIBLE, TILE
from spec.formats import UQ, Fixed
from spec.records import TILE_BITS, Field, Record, tile_index, uint

DISPARITY_FRAC = 8
"""Fraction bits of a disparity: half an ulp is 1/512 pixel, far below what the depth's own rounding costs."""

DISPARITY_SCALE_FRAC = 14
"""Fraction bits of S, the disparity in pixels where depth saturates."""

DISPARITY_SCALE_BITS = 24
"""Bits of the setting S. Above its largest value even the far end of the depth scale moves by more than 1,023 pixels."""

FILL_NEIGHBOURS = 5
"""Warped pixels among the eight around it that a hole inside needs to be filled. Where fewer than eight exist in strip and
frame, `warp_fill` "interior" still asks for as many, and "majority" for more than half of those that exist."""


def disparity_drop(formats: NumberFormats) -> int:
    """Lowest bits of S w that are dropped before the division, which then gives DISPARITY_FRAC fraction bits: 3."""
    return DISPARITY_SCALE_FRAC + formats.transmittance.frac_bits - formats.depth_accumulator.frac_bits - DISPARITY_FRAC


def reach(config: AcceleratorConfig) -> int:
    """Most columns that a pixel may move by; those that would move further are dropped, as those are that leave the frame.

    Three quarters of the columns that the warp unit holds: where the target's pixel of the largest shift and the source's are
    both among them, a quarter is left for tiles that come while others are written. Where whole rows are held no shift is too
    large: none inside a frame is as large as this.
    """
    return config.row_width if config.warp_columns >= config.row_width else config.warp_columns * 3 // 4


def clear_cycles(config: AcceleratorConfig) -> int:
    """Cycles in which the warp unit clears its columns after a reset: two places of a lane in each."""
    return config.warp_columns * TILE // config.warp_lanes // 2


def disparity(config: AcceleratorConfig) -> Fixed:
    """Magnitude of a disparity in pixels. Saturates; what saturates lies beyond `reach`, so its pixel is dropped."""
    return UQ(reach(config).bit_length(), DISPARITY_FRAC)


def background_transmittance(formats: NumberFormats) -> int:
    """Smallest raw transmittance of the background: coverage 1 - T / one below COVERAGE_VISIBLE."""
    one = 1 << formats.transmittance.frac_bits
    return one - math.ceil(one * COVERAGE_VISIBLE) + 1


def solid_transmittance(formats: NumberFormats) -> int:
    """Largest raw transmittance of a pixel with a depth: coverage 1 - T / one at least COVERAGE_VALID."""
    one = 1 << formats.transmittance.frac_bits
    return one - math.ceil(one * COVERAGE_VALID)


def warped_transmittance(config: AcceleratorConfig) -> int:
    """Largest raw transmittance of a pixel that is warped by its depth; above, and below the background's, none is warped."""
    n = config.formats
    return background_transmittance(n) - 1 if config.warp_veiled else solid_transmittance(n)


def _pixel(config: AcceleratorConfig) -> tuple[Field, ...]:
    """What a strip holds of a pixel."""
    return (
        Field("colour", uint(8), "r, g, b as in DisplayPixel", 3),
        Field("key", uint(disparity(config).width), "0: background; else the raw disparity + 1: larger is nearer"),
    )


def warp_pixel(config: AcceleratorConfig) -> Record:
    """A pixel of the source eye's frame on its way into the target's."""
    return Record("WarpPixel", warp_pixel.__doc__, (
        Field("x", uint(TILE_BITS + (TILE - 1).bit_length()), "column in the target eye's frame; 0 where nothing is kept"),
        Field("row", uint((TILE - 1).bit_length()), "row inside the strip"),
        *_pixel(config),
        Field("keep", uint(1), "warped, by `reach` at most, it lies in the frame; otherwise the rest means nothing"),
    ))


def strip_pixel(config: AcceleratorConfig) -> Record:
    """A pixel of a strip, 16 rows of the target eye's frame: a larger key replaces a smaller one, any replaces no pixel."""
    return Record("StripPixel", strip_pixel.__doc__, (
        *_pixel(config),
        Field("valid", uint(1), "a pixel was warped here; otherwise the rest means nothing"),
    ))


def warped_tile(config: AcceleratorConfig) -> Record:
    """What the warp unit finds of a tile of the target eye's frame; one per tile, in tile order."""
    return Record("WarpedTile", warped_tile.__doc__, (
        Field("tile", tile_index(config), "native tile"),
        Field("invalid", uint(1), "holes are left in it: it must be rendered"),
    ))


STEREO_RECORDS = (warp_pixel, strip_pixel, warped_tile)
"""Of machines with stereo alone."""
