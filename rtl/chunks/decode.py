"""Decoders of compact geometry (`spec.compact`) as combinational logic: functions of Amaranth Values, which hold no register.
Those that use a value more than once take `let`, which names it (`rtl.float.number.Let`).

`geometry_codes` brings the codes of a coarse record to the width of those of a fine one, so that one decoder serves both. The
other functions give the operands of positions, the scales, and the components of a quaternion. The largest component is a
root, too long for one cycle: `rtl.chunks.geometry_decode` puts registers between its parts. `decode_colour` decodes opacities
and base colours.
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Array, Cat, Const, Mux, Value
from amaranth.lib import data

from rtl.fixed import as_integer, round_shift
from rtl.float.iteration import square
from rtl.float.number import Let, normalise
from rtl.shapes import layout
from spec.compact import (
    POSITION_BITS,
    ROOT_BASE,
    ROOT_HALF,
    ROOT_SLOPE,
    SCALE_FRACTIONS,
    SCALE_STEPS_LOG2,
    STEP_BIAS,
    compact_geometry,
    quaternion_bits,
    scale_bits,
)
from spec.config import AcceleratorConfig
from spec.formats import SmallFloat

SCALE_SHIFT = scale_bits(False) - scale_bits(True)
"""Bits by which a scale's code is shorter in coarse records."""

QUATERNION_SHIFT = quaternion_bits(False) - quaternion_bits(True)
"""Bits by which the code of a quaternion's component is shorter in coarse records."""

OPERAND = SmallFloat(sig_bits=POSITION_BITS, exp_bits=8, bias=127, signed=False)
"""The format of a coordinate relative to its chunk, which it holds exactly."""


class GeometryCodes(NamedTuple):
    """The codes of G. Those of scale and quaternion are shifted to the width of fine records.

    Attributes:
        position: POSITION_BITS bits each.
        scale: `scale_bits(False)` bits each.
        degenerate: whether a scale is zero because its code is the largest.
        largest: position of the quaternion's component that has no code.
        quaternion: signed, `quaternion_bits(False)` bits each.
        opacity: OPACITY_BITS bits.
    """

    position: list[Value]
    scale: list[Value]
    degenerate: list[Value]
    largest: Value
    quaternion: list[Value]
    opacity: Value


def geometry_codes(config: AcceleratorConfig, bits: Value, coarse: Value) -> GeometryCodes:
    """The codes in the low bits of G."""
    records = compact_geometry(config), compact_geometry(config, coarse=True)
    fine, rough = (data.View(layout(record), bits[: record.width]) for record in records)
    return GeometryCodes(
        position=[fine.position[i] for i in range(3)],  # it lies first in both records
        scale=[Mux(coarse, Cat(Const(0, SCALE_SHIFT), rough.scale[i]), fine.scale[i]) for i in range(3)],
        degenerate=[Mux(coarse, rough.scale[i].all(), fine.scale[i].all()) for i in range(3)],
        largest=Mux(coarse, rough.largest, fine.largest),
        quaternion=[Mux(coarse, rough.quaternion[i] << QUATERNION_SHIFT, fine.quaternion[i]) for i in range(3)],
        opacity=Mux(coarse, rough.opacity, fine.opacity))


def operand(let: Let, code: Value, step: Value) -> Value:
    """The bits of code * 2^(step - STEP_BIAS) in OPERAND."""
    significand, places = normalise(let, code)
    exponent = (step + (OPERAND.bias - STEP_BIAS + POSITION_BITS - 1) - places)[: OPERAND.exp_bits]
    return Cat(significand[:-1], exponent & significand[-1].replicate(OPERAND.exp_bits))


def scale_logarithm(code: Value, scale_top: Value) -> Value:
    """c, a scale's logarithm, from its code and its chunk's largest scale: a signed number."""
    return Cat(Const(0, 3), scale_top, Const(0, 1)).as_signed() - as_integer(code)


def scale_word(c: Value, degenerate: Value) -> Value:
    """The bits of a scale from its logarithm."""
    fraction = Array(Const(f, 11) for f in SCALE_FRACTIONS)[c[:SCALE_STEPS_LOG2]]
    exponent = c[SCALE_STEPS_LOG2 : SCALE_STEPS_LOG2 + 6]
    word = Cat(fraction, exponent)
    return word & (exponent.any() & ~c[-1] & ~degenerate).replicate(len(word))


def component(code: Value) -> Value:
    """A component of a quaternion in raw `quaternion`, signed; its magnitude is at most ROOT_HALF."""
    return round_shift(code * ROOT_HALF, quaternion_bits(False) - 1)[:14].as_signed()


def component_square(let: Let, q: Value) -> Value:
    """The square of a component. Where q is negative it is (m + 1)^2 = m^2 + 2m + 1 with m = ~q, which is there sooner than
    -q."""
    negative = q[-1]
    m = let("ones", q[:13] ^ negative.replicate(13))
    return square(m, Cat(negative, m & negative.replicate(13)))


def remainder(let: Let, squares: list[Value]) -> Value:
    """x >> 12, where x is the square of the largest component, at least 2^24, from those of the three others."""
    x = let("remainder", (1 << 26) - (squares[0] + squares[1] + squares[2]))
    enough = x[24:27].any() & ~x[-1]
    return Cat(x[12:24] & enough.replicate(12), x[24] | ~enough, x[25:27] & enough.replicate(2))


def root_line(x: Value) -> tuple[Value, Value]:
    """ROOT_BASE and ROOT_SLOPE of the segment of a `remainder`."""
    segment = (x[8:] - 16)[:6]
    return Array(Const(base, 17) for base in ROOT_BASE)[segment], Array(Const(slope, 7) for slope in ROOT_SLOPE)[segment]


def root(let: Let, x: Value, base: Value, slope: Value) -> Value:
    """The largest component in raw `quaternion`, signed, from a `remainder` and its `root_line`."""
    y = let("root", round_shift((base << 5) + slope * x[:8], 8))
    return Cat(y[:13] | y[13:].any().replicate(13), Const(0, 1)).as_signed()
