"""What the parameters of one machine must agree on beyond their own limits.

The arithmetic of docs/array.md and of the culling unit relies on relations between number formats: a shift must not be
negative, a range that was derived for one format must hold in the next, a record must fit its place in memory.
`AcceleratorConfig` checks each parameter by itself; `check_relations` checks all of them together, before a configuration
that somebody put together by hand reaches the renderer or the RTL.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import ENTRY_BYTES
from spec.harmonics import SEED_FRAC_BITS
from spec.memory import BEAT_BYTES, TILE_SETTING_BYTES, WORD_BITS, frame_pixel, frame_settings, splat_record, tile_setting
from spec.records import gaussian_colour, gaussian_geometry, intersection
from spec.tables import BLEND_INDEX_BITS, EXP2_SLOPE_FRAC

EXACT_INT_BITS = (
    "quaternion", "log2_opacity", "sh_dc", "sh_rest", "sh_basis", "depth", "factor", "alpha", "transmittance", "weight",
    "depth_accumulator", "blend_weight")
"""Fixed-point formats whose integer bits follow from what they hold; only their fraction bits may be chosen."""

LEAST_INT_BITS = ("exponent", "slope", "curvature", "cut")
"""Fixed-point formats whose range was derived (docs/array.md): they may have more integer bits, but not fewer."""

SEGMENTS = (1, 2, 4, 8, 16)
"""Numbers of segments that the exponential may have."""

PIXEL_BITS = 31
"""Bits that a product or a sum of a pixel may have, so that a signed 32-bit integer holds it."""

MOST_SUM_BITS = 49
"""Fraction bits of the exact sum of a colour, which has four integer bits and a sign: float64 holds 53 bits."""

OFFSET_PRODUCT_BITS = 48
"""Bits that the product of a conic factor and a distance may have in the setup unit."""


def _number_ranges(n: NumberFormats) -> Iterator[str]:
    """Formats whose kind or range contradicts what they hold."""
    standard = NumberFormats()
    for field in fields(NumberFormats):
        value, usual = getattr(n, field.name), getattr(standard, field.name)
        if type(value) is not type(usual) or getattr(value, "signed", None) != getattr(usual, "signed", None):
            yield f"formats.{field.name} must be of the kind of {usual}, not {value}"
    if n.exp2_segments not in SEGMENTS:
        yield f"formats.exp2_segments must be one of {', '.join(map(str, SEGMENTS))}, not {n.exp2_segments!r}"


def _integer_bits(n: NumberFormats) -> Iterator[str]:
    standard = NumberFormats()
    for name in (*EXACT_INT_BITS, *LEAST_INT_BITS):
        value, usual = getattr(n, name), getattr(standard, name)
        exact = name in EXACT_INT_BITS
        if value.int_bits != usual.int_bits if exact else value.int_bits < usual.int_bits:
            yield f"formats.{name} must have {'' if exact else 'at least '}{usual.int_bits} integer bits, not {value}"
    if n.accumulator.int_bits < n.colour.int_bits:
        yield f"formats.accumulator must have at least the integer bits of colour, {n.colour.int_bits}, not {n.accumulator}"
    if n.depth_key.frac_bits:
        yield f"formats.depth_key must have no fraction bits, not {n.depth_key}"
    least = n.view.sig_bits + 1
    if n.depth_key.int_bits < least:
        yield (f"formats.depth_key must have at least {least} bits, four octaves of view's ulps behind the near plane, "
               f"not {n.depth_key}")
    if n.conic.exp_max:
        yield f"formats.conic must have 0 as its largest exponent, so a bias of {(1 << n.conic.exp_bits) - 1}, not {n.conic}"


def _polynomial(n: NumberFormats) -> Iterator[str]:
    """docs/array.md, "Setup"."""
    if n.factor.frac_bits != n.conic.sig_bits - 1:
        yield f"formats.factor must have the fraction bits of conic's significand, {n.conic.sig_bits - 1}, not {n.factor}"
    if n.conic.sig_bits + n.mean2d.width + 3 > OFFSET_PRODUCT_BITS:
        most = OFFSET_PRODUCT_BITS - 3 - n.conic.sig_bits
        yield f"formats.mean2d must have at most {most} bits beside conic {n.conic}, not {n.mean2d}"
    if n.conic.sig_bits - 1 + n.mean2d.frac_bits <= n.offset.frac_bits:
        most = n.conic.sig_bits + n.mean2d.frac_bits - 2
        yield f"formats.offset must have at most {most} fraction bits, those of mean2d times conic, not {n.offset}"
    if n.cut.frac_bits != n.log2_opacity.frac_bits:
        yield f"formats.cut must have the fraction bits of log2_opacity, {n.log2_opacity.frac_bits}, not {n.cut}"
    if n.cut.frac_bits >= n.exponent.frac_bits:
        yield f"formats.cut must have fewer fraction bits than exponent, {n.exponent.frac_bits}, not {n.cut}"
    for name in ("offset", "factor"):
        if n.exponent.frac_bits > getattr(n, name).frac_bits:
            yield f"formats.exponent must not have more fraction bits than {name} {getattr(n, name)}, not {n.exponent}"
    for name in ("slope", "curvature"):
        if getattr(n, name).frac_bits != n.exponent.frac_bits:
            yield f"formats.{name} must have the fraction bits of exponent, {n.exponent.frac_bits}, not {getattr(n, name)}"
    if n.exponent.width > PIXEL_BITS + 1:
        yield f"formats.exponent must have at most {PIXEL_BITS + 1} bits, not {n.exponent}"


def _pixel(config: AcceleratorConfig) -> Iterator[str]:
    """docs/array.md, "A pixel and an op" and "Level blending"."""
    n, far = config.formats, config.depth_weight
    if n.weight.frac_bits > n.transmittance.frac_bits:
        yield f"formats.weight must not have more fraction bits than transmittance {n.transmittance}, not {n.weight}"
    if (1 << n.cut.frac_bits) // n.exp2_segments < 2:
        yield f"formats.cut must have a fraction bit below the {n.exp2_segments} segments of the exponential, not {n.cut}"
    if EXP2_SLOPE_FRAC + n.cut.frac_bits < n.alpha.frac_bits:
        yield f"formats.alpha must have at most {EXP2_SLOPE_FRAC + n.cut.frac_bits} fraction bits, not {n.alpha}"
    if n.plane.frac_bits < BLEND_INDEX_BITS:
        yield f"formats.plane must have at least {BLEND_INDEX_BITS} fraction bits, not {n.plane}"
    for name, weight, value, total in (("accumulator", n.weight, n.colour, n.accumulator),
                                       ("depth_accumulator", far, n.depth, n.depth_accumulator)):
        bits = weight.frac_bits + value.frac_bits
        if total.frac_bits > bits:
            yield f"formats.{name} must have at most the {bits} fraction bits of a weight times a value, not {total}"
        product = weight.width + value.width
        if product > PIXEL_BITS:
            yield f"a weight {weight} times a value {value} must fit {PIXEL_BITS} bits for {name}, not {product}"
    if n.transmittance.width + n.alpha.frac_bits > PIXEL_BITS - 1:
        most = PIXEL_BITS - 1 - n.alpha.frac_bits
        yield f"formats.transmittance must have at most {most} bits beside alpha {n.alpha}, not {n.transmittance}"


def _colour(n: NumberFormats) -> Iterator[str]:
    """`spec.harmonics`."""
    total = n.sh_basis.frac_bits + n.sh_rest.frac_bits
    if n.sh_basis.frac_bits < SEED_FRAC_BITS:
        yield f"formats.sh_basis must have at least the {SEED_FRAC_BITS} fraction bits of the table of roots, not {n.sh_basis}"
    for name in ("sh_dc", "colour"):
        if getattr(n, name).frac_bits > total:
            yield f"formats.{name} must have at most the {total} fraction bits of sh_basis and sh_rest, not {getattr(n, name)}"
    if total > MOST_SUM_BITS:
        yield f"formats.sh_basis and formats.sh_rest must have at most {MOST_SUM_BITS} fraction bits together, not {total}"


def _places(config: AcceleratorConfig) -> Iterator[str]:
    """Records that do not fit what memory, the registers and the sorter have for them."""
    beat = 8 * BEAT_BYTES
    for record, most in ((gaussian_geometry(config), beat), (splat_record(config), beat),
                         (tile_setting(config), 8 * TILE_SETTING_BYTES), (intersection(config), 8 * ENTRY_BYTES)):
        if record.width > most:
            names = ", ".join(f"{field.name} {field.count} x {field.format}" for field in record.fields)
            yield f"{record.name} must fit {most} bits, not {record.width} ({names})"
    if gaussian_colour(config, 0).width > beat:
        yield f"formats.sh_dc must leave the base colours of all levels {beat} bits, not {config.formats.sh_dc}"
    n = config.formats
    pixel = {field.name: field.format for field in frame_pixel(config).fields}
    for name, place in (("accumulator", "colour"), ("transmittance", "transmittance"), ("depth_accumulator", "depth")):
        if getattr(n, name).width > pixel[place].width:
            yield f"formats.{name} must fit the {pixel[place].width} bits of a FramePixel's {place}, not {getattr(n, name)}"
    for field in frame_settings(config).fields:
        if field.format.width > WORD_BITS:
            yield f"setting {field.name} must fit a register of {WORD_BITS} bits, not {field.format}"


def problems(config: AcceleratorConfig) -> list[str]:
    """What keeps the parameters of `config` from working together: one sentence each, empty where they do."""
    found = list(_number_ranges(config.formats))
    if found:  # the rest would read a fraction where there is none
        return found
    n = config.formats
    return [*_integer_bits(n), *_polynomial(n), *_pixel(config), *_colour(n), *_places(config)]


def check_relations(config: AcceleratorConfig) -> None:
    """Raises ValueError with the first of `problems`, where there is one."""
    for problem in problems(config):
        raise ValueError(problem)
