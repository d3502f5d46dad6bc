"""Compact records: a Gaussian in 16 bytes for the geometry phase, 32 with the opacities and base colours of all its levels,
and 32 more for its harmonics.

Three records, each relative to the header of the Gaussian's chunk (`spec.chunks`):

    G    CompactGeometry, half a beat per Gaussian: what projection needs, with the strongest opacity
    R    CompactColour, one beat per Gaussian: the same geometry, and opacity and base colour of every level
    SH   CompactHarmonics, one beat after R where the model has harmonics, whatever their degree

A decode unit turns them into the words of `spec.records`, so that what follows does not depend on the format. R and SH lie
together, at beat `colour_base + index * beats`. Gaussians of quality bound 3, which have four levels, get *coarse* fields,
because R would not hold four levels otherwise; all others get *fine* ones. G has the same values as R, bit for bit.

**Decoding.** Below, `>>` and `<<` shift integers, and rs(x, n) = (x + 2^(n-1)) >> n.

*Position.* low + code * 2^(step - STEP_BIAS) of the header's `low` and `step`, rounded to `position` once.

*Scale.* Logarithmic, in 1/128 of an octave: c = 8 * scale_top - code for fine fields and 8 * scale_top - 2 * code for coarse
ones. The `scale` word has exponent field c >> 7 and fraction SCALE_FRACTIONS[c & 127]. The largest code, and every c below 128,
mean zero.

*Quaternion.* `largest` is the position of the component of largest magnitude, which is positive. The three others, in order,
are q = rs(code * ROOT_HALF, b - 1) in raw `quaternion`, where b is the number of bits of a code. The largest is the square root
of x = max(2^26 - sum of q^2, 2^24): with i = (x >> 20) - 16 and r = (x >> 12) & 255 it is
min(rs(32 * ROOT_BASE[i] + ROOT_SLOPE[i] * r, 8), 8191).

*Opacity.* Codes up to 255 are linear: log2 of code / 255, in OPACITY_LOG2. Larger codes are logarithmic, for amplified
opacities: (code - 255) << 5 in raw `log2_opacity`, which is 1/32 of an octave a code.

*Base colour.* min((code << r + s) - (1024 << r), 8191) in raw `sh_dc`, where r is the record's `dc_range`, and s is 0 for fine
fields and 3 for coarse ones. So the codes cover -0.5 to 1.5, times 2^r.

*Levels.* A fine record has three levels; the words of the fourth, which no tile uses, repeat the third.

*Harmonics.* code << e in raw `sh_rest`, where e is the `exponent` of the coefficient's band (degree), but at most the band's
BAND_EXPONENT_MOST, so that no coefficient exceeds the format. The colour unit multiplies by the codes and shifts the band's
sum.

**Losses.** `msv2 study run v3` measures them. Encoding rounds to nearest, ties to even, so that no mean is shifted.
"""

from __future__ import annotations

import math
from typing import Any

from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import MAX_LEVELS
from spec.formats import SQ, Fixed, SmallFloat
from spec.records import Field, Record, uint

POSITION_BITS = 16
"""Bits of a coordinate on its chunk's grid."""

STEP_BIAS = 40
"""The grid's step is 2^(step - STEP_BIAS) world units."""

SCALE_STEPS_LOG2 = 7
"""log2 of the steps of a scale's logarithm in an octave."""

SCALE_FRACTIONS = tuple(round(2048 * 2 ** (i / 128)) - 2048 for i in range(128))
"""Fraction bits of 2^(i / 128) as a `scale` word has them."""

ROOT_HALF = round(math.sqrt(0.5) * 2**13)
"""The root of 1/2 in raw `quaternion`: no component but the largest exceeds it."""


def _root(i: float) -> float:
    """The root, in raw `quaternion`, at the beginning of segment i."""
    return math.sqrt((i + 16) * 2.0**20)


ROOT_BASE = tuple(round(8 * _root(i) + 4 * (_root(i + 0.5) - (_root(i) + _root(i + 1)) / 2)) for i in range(49))
"""Roots at the beginnings of 49 segments, in 1/8 of an ulp. Half of what a chord lies below the root is added, so that the mean
error is near zero."""

ROOT_SLOPE = tuple(round(_root(i + 1) - _root(i)) for i in range(49))
"""What 256 steps inside a segment add, in ulps."""

OPACITY_BITS = 9
"""Bits of an opacity's code."""

OPACITY_ONE = 255
"""The code of opacity 1."""

OPACITY_LOG2 = (-(1 << 14), *(round(1024 * math.log2(code / 255)) for code in range(1, OPACITY_ONE + 1)))
"""Raw `log2_opacity` of the codes up to OPACITY_ONE; code 0 is the smallest number of that format."""

OPACITY_STEP_LOG2 = 5
"""log2 of the raw `log2_opacity` between two codes above OPACITY_ONE."""

DC_LOW = 1024
"""The smallest base colour is -DC_LOW << dc_range in raw `sh_dc`."""

DC_COARSE_SHIFT = 3
"""Bits by which coarse codes of base colours are shorter than `sh_dc`."""

FINE_LEVELS = 3
"""Levels of a fine record; a coarse one has MAX_LEVELS."""

BANDS = (range(3), range(3, 8), range(8, 15))
"""Terms of the harmonics of degree 1, 2 and 3."""

BAND_BITS = (7, 5, 5)
"""Bits of a coefficient's code, by degree."""

BAND_EXPONENT_BITS = 4
"""Bits of the exponent of a band's coefficients."""

BAND_EXPONENT_MOST = (5, 7, 7)
"""Largest exponents, by degree: with them the codes reach both ends of `sh_rest`."""

COARSE_BOUND = MAX_LEVELS - 1
"""The quality bound whose records are coarse."""


def _contradictions(n: NumberFormats) -> list[str]:
    """The formats of words that compact records decode to, where they are not those that the encodings above assume."""
    wanted: dict[str, Fixed | SmallFloat] = {
        "scale": SmallFloat(12, 6, n.scale.bias, signed=False), "quaternion": SQ(0, 13), "log2_opacity": SQ(4, 10),
        "sh_dc": SQ(2, 11), "sh_rest": SQ(1, 10)}
    return [f"{name} must be {number} with compact records, not {getattr(n, name)}"
            for name, number in wanted.items() if getattr(n, name) != number]


def check_formats(config: AcceleratorConfig) -> None:
    """Raises ValueError where the words that compact records decode to have other formats than the encodings above assume."""
    for contradiction in _contradictions(config.formats):
        raise ValueError(contradiction)


def with_compact_records(config: AcceleratorConfig, **changes: Any) -> AcceleratorConfig:
    """The machine with chunks of compact records and these changes; with the standard formats, where its own contradict the
    records."""
    formats = NumberFormats() if _contradictions(config.formats) else config.formats
    return config.with_(order="spatial", chunks=True, records="compact", formats=formats, **changes)


def scale_bits(coarse: bool) -> int:
    """Bits of a scale's code."""
    return 10 if coarse else 11


def quaternion_bits(coarse: bool) -> int:
    """Bits of the code of a quaternion's component."""
    return 10 if coarse else 11


def dc_bits(coarse: bool) -> int:
    """Bits of a base colour's code."""
    return 9 if coarse else 12


def levels_held(coarse: bool) -> int:
    """Levels whose opacity and base colour a record holds."""
    return MAX_LEVELS if coarse else FINE_LEVELS


def _geometry(coarse: bool) -> tuple[Field, ...]:
    return (
        Field("position", uint(POSITION_BITS), "code of each coordinate", 3),
        Field("scale", uint(scale_bits(coarse)), "code of each standard deviation", 3),
        Field("largest", uint(2), "the quaternion's component of largest magnitude, of w, x, y, z"),
        Field("quaternion", SQ(quaternion_bits(coarse) - 1, 0), "codes of the three others, in order", 3),
    )


def compact_geometry(config: AcceleratorConfig, coarse: bool = False) -> Record:
    """G: what the geometry phase reads of a Gaussian, 16 bytes. A coarse record is that of a Gaussian with four levels."""
    return Record("CompactGeometry" + "Coarse" * coarse, compact_geometry.__doc__, (
        *_geometry(coarse),
        Field("opacity", uint(OPACITY_BITS), "code of the largest opacity among the levels that use the Gaussian"),
    ))


def compact_geometry_coarse(config: AcceleratorConfig) -> Record:
    """G of a Gaussian with four levels."""
    return compact_geometry(config, coarse=True)


def compact_colour(config: AcceleratorConfig, coarse: bool = False) -> Record:
    """R: a Gaussian with the opacities and base colours of its levels, one beat. A coarse record is that of a Gaussian with
    four levels."""
    levels = levels_held(coarse)
    return Record("CompactColour" + "Coarse" * coarse, compact_colour.__doc__, (
        *_geometry(coarse),
        Field("dc_range", uint(2), "log2 of the factor of the range of base colours"),
        Field("opacity", uint(OPACITY_BITS), "code of the opacity, per level", levels),
        Field("dc", uint(dc_bits(coarse)), "code of the base colour: r, g, b of level 1, then of the others", 3 * levels),
    ))


def compact_colour_coarse(config: AcceleratorConfig) -> Record:
    """R of a Gaussian with four levels."""
    return compact_colour(config, coarse=True)


def compact_harmonics(config: AcceleratorConfig) -> Record:
    """SH: the harmonics of a Gaussian, one beat; bands beyond the model's degree are 0."""
    return Record("CompactHarmonics", compact_harmonics.__doc__, (
        Field("exponent", uint(BAND_EXPONENT_BITS), "exponent of degree 1, 2, 3", 3),
        *(Field(f"degree_{d}", SQ(bits - 1, 0), f"codes of degree {d}: r, g, b of each term, in 3DGS order", 3 * len(terms))
          for d, (terms, bits) in enumerate(zip(BANDS, BAND_BITS, strict=True), 1)),
    ))


COMPACT_RECORDS = (
    compact_geometry, compact_geometry_coarse, compact_colour, compact_colour_coarse, compact_harmonics)
