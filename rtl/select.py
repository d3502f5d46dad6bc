"""Multiplexers with one-hot select signals."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import or_

from amaranth.hdl import Value


def select(one_hot: Value, choices: Iterable[Value]) -> Value:
    """The choice, an unsigned value, whose bit of `one_hot` is set, or 0 where no bit is set. Raises ValueError where the
    numbers of bits and choices differ."""
    return reduce(or_, (choice & bit.replicate(len(choice)) for bit, choice in zip(one_hot, choices, strict=True)))
