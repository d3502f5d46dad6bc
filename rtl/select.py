"""Choices by one-hot signals."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import or_

from amaranth.hdl import Value


def select(one_hot: Value, choices: Iterable[Value]) -> Value:
    """The choice, an unsigned value, whose bit of `one_hot` is set; 0 where none is. ValueError: not a choice for each bit."""
    return reduce(or_, (choice & bit.replicate(len(choice)) for bit, choice in zip(one_hot, choices, strict=True)))
