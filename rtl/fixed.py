"""Rounding, saturation and re-scaling of fixed-point values.

Values are plain Amaranth integers. Only the caller knows how many of their bits are fraction bits. Amaranth's arithmetic widens
its results, so every intermediate is exact. Rounding is HALF_UP: `rs(x, n) = (x + 2^(n-1)) >> n`, as in docs/array.md.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux, Value

from spec.formats import Fixed


def _check_shift(n: int, low: int) -> None:
    if not isinstance(n, int) or isinstance(n, bool):
        raise TypeError(f"shift must be an integer, not {n!r}")
    if n < low:
        raise ValueError(f"shift must be at least {low}, not {n!r}")


def as_integer(x: Value) -> Value:
    """x as a signed value of the same number; an unsigned x gains a zero as its top bit."""
    return x if x.shape().signed else Cat(x, Const(0, 1)).as_signed()


def round_shift(x: Value, n: int) -> Value:
    """`rs(x, n)` with all bits of the result, n >= 0; n = 0 returns x unchanged."""
    _check_shift(n, 0)
    return (x + (1 << (n - 1))).shift_right(n) if n else x


def negated_round_shift(x: Value, n: int) -> Value:
    """`-rs(x, n)`, n >= 1, in one addition: -((x + h) >> n) = (~x + h) >> n where h = 2^(n-1)."""
    _check_shift(n, 1)
    return (~as_integer(x) + (1 << (n - 1))).shift_right(n)


def fits(x: Value, number: Fixed) -> Value:
    """Whether the format holds x, a multiple of its ulp: all bits above the format must repeat its top bit (0 if unsigned)."""
    x = as_integer(x)
    above = x[min(number.width - number.signed, len(x) - 1) :]
    return ~above.any() | above.all() if number.signed else ~above.any()


def saturate(x: Value, number: Fixed) -> Value:
    """x clamped to the format's range, in the format's shape."""
    x = as_integer(x)
    return modular(Mux(fits(x, number), x, Mux(x[-1], number.raw_min, number.raw_max)), number)


def modular(x: Value, number: Fixed) -> Value:
    """The low bits of x in the format's shape. They are exact where the true value fits, even if x itself has wrapped
    around."""
    x = as_integer(x)
    if number.signed:
        return x[: number.width].as_signed()
    return Cat(x, x[-1].replicate(max(0, number.width - len(x))))[: number.width]
