"""Parts of the units: fields of a small float, shifts with a sticky bit, rounding and packing.

Before it is packed, a magnitude is a normalised significand, whose top bit is the leading one, and a signed exponent with the
bias of the result's exponent field. Where the exponent is below 1 the result is flushed to zero; where it is too large for the
field, the result saturates.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from amaranth.hdl import Cat, Const, Mux, Value

from rtl.fixed import as_integer
from rtl.pipeline import Pipeline, Staged
from spec.formats import SmallFloat

Let = Callable[[str, Value], Value]
"""A function that gives a value a name and thereby a wire, so that an expression with several users is built once."""


class Fields(NamedTuple):
    """The parts of a number; `significand` includes the hidden one and is 0 for zero."""

    negative: Value
    nonzero: Value
    exponent: Value
    significand: Value


def fields(bits: Value, number: SmallFloat) -> Fields:
    """The fields of a bit pattern. An exponent of 0 means zero, whatever the other bits are, as in `SmallFloat.to_float`."""
    fraction, exponent = bits[: number.sig_bits - 1], bits[number.sig_bits - 1 : number.sig_bits - 1 + number.exp_bits]
    nonzero = exponent.any()
    negative = bits[-1] if number.signed else Const(0, 1)
    return Fields(negative, nonzero, exponent, Cat(fraction & nonzero.replicate(len(fraction)), nonzero))


def widened(x: Value, width: int) -> Value:
    """x extended to `width` bits by zeros below its lowest bit."""
    return Cat(Const(0, width - len(x)), x)


def normalise(let: Let, x: Value) -> tuple[Value, Value]:
    """x shifted left until its top bit is set, and the number of places. The top bit of the result is 0 only where x is 0."""
    count: list[Value] = []
    for k in reversed(range((len(x) - 1).bit_length())):
        empty = let(f"empty_{1 << k}", ~x[-(1 << k) :].any())
        x = let(f"left_{1 << k}", Mux(empty, Cat(Const(0, 1 << k), x[: -(1 << k)]), x))
        count.insert(0, empty)
    return x, Cat(*count)


def shift_right(let: Let, x: Value, n: Value) -> Value:
    """x >> n with an additional lowest bit (sticky), which is set where any bit that was shifted out is set."""
    sticky, steps = Const(0, 1), len(x).bit_length()
    for k in range(min(steps, len(n))):
        low = min(1 << k, len(x))
        sticky = sticky | (n[k] & x[:low].any())
        x = let(f"right_{1 << k}", Mux(n[k], Cat(x[low:], Const(0, low)), x))
    if len(n) > steps:
        far = let("far", n[steps:].any())
        sticky = sticky | (far & x.any())
        x = x & (~far).replicate(len(x))
    return Cat(sticky, x)


_LONGEST_WHOLE, _LONGEST_IN_HALVES = 10, 18
"""Most bits of a factor whose product fits into a stage as a whole, and of one for which the products with its two halves do;
longer factors are cut into thirds."""


def product(p: Pipeline, let: Let, name: str, a: Staged, b: Staged) -> Staged:
    """Unsigned a * b in two stages: the products of a with all of b, or with its halves or thirds, then their sum."""
    bits, width = len(b.value), len(a.value) + len(b.value)
    names = (("whole",) if bits <= _LONGEST_WHOLE else ("low", "high") if bits <= _LONGEST_IN_HALVES else
             ("low", "middle", "high"))
    cuts = [bits * i // len(names) for i in range(len(names) + 1)]

    def times(part: str, place: slice) -> Staged:
        return p.reg(f"{name}_{part}", lambda a, b: let(f"{name}_{part}", a * b), a, b.map(lambda b: b[place]))

    def add(lowest: Value, *others: Value) -> Value:
        top = lowest[cuts[1]:]
        for cut, other in zip(cuts[1:-1], others, strict=True):
            top = top + (other << (cut - cuts[1]))
        return Cat(lowest[:cuts[1]], let(f"{name}_top", top[: width - cuts[1]]))

    return p.reg(name, add, *(times(part, slice(*cuts[i:i + 2])) for i, part in enumerate(names)))


def nearest_even(x: Value, number: SmallFloat) -> tuple[Value, Value]:
    """(fraction, whether to round it up) of a normalised significand; where that is inexact, its lowest bit is sticky."""
    x = widened(x, max(len(x), number.sig_bits + 1))
    drop = len(x) - number.sig_bits
    kept, half, rest = x[drop:-1], x[drop - 1], x[: drop - 1]
    return kept, half & (rest.any() | x[drop])


def pack(
    let: Let, number: SmallFloat, total: Value, *, negative: Value, nonzero: Value, infinite: Value | None = None,
) -> Value:
    """The bit pattern of a rounded magnitude, and above it one bit: whether it saturated.

    `total` is fraction and exponent as one signed integer, so that rounding the significand up to 2 has already carried into
    the exponent. `infinite` magnitudes saturate whatever `total` is. Numbers too small for the format become zero and do not
    count as saturated.
    """
    total = let("rounded", total)
    total = Cat(total, total[-1].replicate(max(0, number.sig_bits + number.exp_bits + 1 - len(total))))
    exponent = total[number.sig_bits - 1 :]
    above = exponent[number.exp_bits : -1].any() & ~exponent[-1]
    small = exponent[-1] | ~exponent.any()
    if infinite is not None:
        above, small = above | infinite, small & ~infinite
    return _bits(number, total, let("above", above), let("present", nonzero & ~small), negative)


def _bits(number: SmallFloat, total: Value, above: Value, present: Value, negative: Value) -> Value:
    """The result of `pack`. `above`: the magnitude is too large for the format; `present`: it is not zero."""
    largest = above.replicate(number.width - number.signed)
    magnitude = (total[: len(largest)] | largest) & present.replicate(len(largest))
    if number.signed:
        return Cat(magnitude, negative & present, above & present)
    return Cat(magnitude & (~negative).replicate(len(magnitude)), (above | negative) & present)


def round_and_pack(
    let: Let, number: SmallFloat, significand: Value, exponent: Value, *, negative: Value, nonzero: Value,
) -> Value:
    """Rounds a normalised significand, HALF_EVEN, and packs it as `pack` does."""
    fraction, up = nearest_even(significand, number)
    total = Cat(fraction, as_integer(exponent)).as_signed() + up
    return pack(let, number, total, negative=negative, nonzero=nonzero)


def round_and_pack_early(
    let: Let, number: SmallFloat, significand: Value, exponent: Value, *, negative: Value, nonzero: Value,
    one_more: Value | None = None,
) -> Value:
    """Like `round_and_pack`, but faster where the exponent is available before the significand; the bit `one_more` is added to
    the exponent.

    Whether the magnitude is in range is found in parallel with the sum, not after it. It follows from the exponent before the
    sum and from the two carries into it: `one_more`, and the carry of a fraction of ones that is rounded up.
    """
    fraction, up = nearest_even(significand, number)
    up = let("up", up)
    one_more = Const(0, 1) if one_more is None else one_more
    e = as_integer(exponent)
    e = Cat(e, e[-1].replicate(max(0, number.exp_bits + 1 - len(e))))
    field, beyond, below = e[: number.exp_bits], e[number.exp_bits : -1], e[-1]
    carry = up & fraction.all()
    either, both = let("either", one_more | carry), let("both", one_more & carry)
    above = ~below & (beyond.any() | field.all() & either | field[1:].all() & both)
    present = ~below & (e.any() | either) | e.all() & both
    total = let("rounded", Cat(fraction, e).as_signed() + Cat(up, Const(0, len(fraction) - 1), one_more))
    return _bits(number, total, let("above", above), let("present", nonzero & present), negative)
