"""Combinational logic between operations: comparing, converting and doubling small floats."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, Value

from rtl.float.number import Let, fields, round_and_pack_early
from spec.formats import SmallFloat


def order(x: Value) -> Value:
    """An unsigned number that orders patterns of one signed format like their values. Zero must be the pattern 0."""
    negative = x[-1]
    return Cat(x[:-1] ^ negative.replicate(len(x) - 1), ~negative)


def clamp(x: Value, low: Value, high: Value) -> Value:
    """x limited to low..high, where low <= high."""
    return Mux(order(x) < order(low), low, Mux(order(x) > order(high), high, x))


def rescale(let: Let, x: Value, number: SmallFloat, to: SmallFloat, *, negate: bool = False) -> Value:
    """x, or -x, in another format: rounded HALF_EVEN; small results become zero, large ones saturate."""
    f = fields(x, number)
    exponent = f.exponent if number.bias == to.bias else f.exponent + (to.bias - number.bias)
    rounded = round_and_pack_early(let, to, f.significand, exponent, negative=f.negative ^ negate, nonzero=f.nonzero)
    return let("rescaled", rounded[: to.width])


def widen(x: Value, number: SmallFloat, to: SmallFloat) -> Value:
    """The unsigned number x in a format that holds every number of its own. Only the change of the exponent's bias needs
    logic."""
    f = fields(x, number)
    exponent = Mux(f.nonzero, f.exponent + (to.bias - number.bias), 0)[: to.exp_bits]
    return Cat(Const(0, to.sig_bits - number.sig_bits), f.significand[:-1], exponent, Const(0, to.signed))


def doubled(x: Value, number: SmallFloat) -> Value:
    """2 x, where x must lie below half of the format's largest number."""
    low = number.sig_bits - 1
    exponent = x[low : low + number.exp_bits]
    return Cat(x[:low], (exponent + exponent.any())[: number.exp_bits], x[low + number.exp_bits :])


def at_least_smallest(x: Value, number: SmallFloat) -> Value:
    """x, which must not be negative, or the format's smallest positive number where x is zero."""
    return Mux(x.any(), x, 1 << (number.sig_bits - 1))
