"""Comparison of long words as a tree of gates; synthesis turns a long `<` into a chain from bit to bit."""

from __future__ import annotations

from amaranth.hdl import Value


def less(a: Value, b: Value) -> Value:
    """Whether a < b, for two unsigned numbers of the same width, in about log2(width) levels of gates.

    Raises:
        ValueError: the widths are not the same, or 0.
    """
    if len(a) != len(b) or not len(a):
        raise ValueError(f"words must be of one width of at least 1 bit, not {len(a)!r} and {len(b)!r}")
    # Each part holds (less, not greater) for some bits; the second bit is used only where the first is 0.
    parts = [(~a[i] & b[i], ~a[i] | b[i]) for i in range(len(a))]
    while len(parts) > 1:
        pairs = [(high[0] | high[1] & low[0], high[1] & low[1]) for low, high in zip(parts[::2], parts[1::2], strict=False)]
        parts = pairs + parts[len(parts) & ~1:]
    return parts[0][0]
