"""Operands for the floating-point units, and the expected results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spec.formats import Fixed, SmallFloat
from tb.float.device import Operation

_EVERY = ("reciprocal", "rsqrt", "sqrt")
"""Operations that are tested with every significand, with even and odd exponents."""


def _signs(number: SmallFloat, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(0, 1 + number.signed, count) << (number.width - 1)


def _any(number: SmallFloat, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random bit patterns."""
    return rng.integers(0, 1 << number.width, count)


def _middling(number: SmallFloat, rng: np.random.Generator, count: int) -> np.ndarray:
    """Numbers within 24 binades of one, whose products and quotients are in range."""
    exponent = rng.integers(max(1, number.bias - 24), min(number.bias + 24, (1 << number.exp_bits) - 1), count)
    fraction = rng.integers(0, 1 << (number.sig_bits - 1), count)
    return (exponent << (number.sig_bits - 1)) + fraction + _signs(number, rng, count)


def _short(number: SmallFloat, rng: np.random.Generator, count: int) -> np.ndarray:
    """Numbers whose low significand bits are all zeros or all ones, which give ties and carries out of the fraction."""
    bits, fraction = _middling(number, rng, count), (1 << (number.sig_bits - 1)) - 1
    low = (1 << rng.integers(0, number.sig_bits, count)) - 1
    return np.where(rng.random(count) < 0.5, bits & ~low, bits | low & fraction)


def _edges(number: SmallFloat, rng: np.random.Generator, count: int) -> np.ndarray:
    """Numbers with the smallest and the largest exponents."""
    top = (1 << number.exp_bits) - 1
    exponent = rng.choice([0, 1, 2, top // 2, top // 2 + 1, top - 1, top], count)
    near = rng.integers(0, 3, count) * rng.choice([1, -1], count) & ((1 << (number.sig_bits - 1)) - 1)
    return (exponent << (number.sig_bits - 1)) + near + _signs(number, rng, count)


def _neighbours(number: SmallFloat, bits: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Numbers a few ulps or a few binades from the given ones, of either sign, for cancellation and every alignment
    distance."""
    count, magnitude = len(bits), (1 << (number.exp_bits + number.sig_bits - 1)) - 1
    places = rng.integers(-number.sig_bits - 3, number.sig_bits + 4, count) * (rng.random(count) < 0.7)
    near = (bits & magnitude) + (places << (number.sig_bits - 1)) + rng.integers(-3, 4, count)
    return np.clip(near, 0, magnitude) + _signs(number, rng, count)


_KINDS: tuple[Callable, ...] = (_any, _middling, _short, _edges)


def random_operands(operation: Operation, count: int, seed: int) -> dict[str, np.ndarray]:
    """(count,) raw integers or bit patterns of every operand; all kinds of numbers are mixed."""
    rng = np.random.default_rng(seed)
    found: dict[str, np.ndarray] = {}
    for port, number in operation.operands.items():
        if isinstance(number, Fixed):
            raw = number.from_bits(rng.integers(0, 1 << number.width, count))
            found[port] = raw >> rng.integers(0, number.width, count)  # magnitudes of every length
            continue
        found[port] = np.concatenate([kind(number, rng, len(part)) for kind, part in zip(
            _KINDS, np.array_split(np.arange(count), len(_KINDS)), strict=True)])
        rng.shuffle(found[port])
    if "b" in found:
        near, b = rng.random(count) < 0.4, operation.operands["b"]
        found["b"][near] = _neighbours(b, b.quantise(operation.operands["a"].to_float(found["a"][near])).astype(np.int64), rng)
    return found


def every_significand(number: SmallFloat) -> np.ndarray:
    """The bit patterns of all numbers in [1, 4)."""
    return np.arange(2 << (number.sig_bits - 1), dtype=np.int64) + (number.bias << (number.sig_bits - 1))


def operands(name: str, operation: Operation, count: int, seed: int) -> np.ndarray:
    """Rows of the operation's operand record: `count` random ones, after every significand for operations in _EVERY."""
    columns = random_operands(operation, count, seed)
    if name.split("_")[0] in _EVERY:
        columns["a"] = np.concatenate([every_significand(operation.operands["a"]), columns["a"]])
    rows = np.empty(len(next(iter(columns.values()))), operation.records(name)[0].dtype)
    for port, values in columns.items():
        rows[port] = values
    return rows


def results(name: str, operation: Operation, rows: np.ndarray) -> np.ndarray:
    """Rows of the operation's result record: one operation in float64 and one rounding."""
    with np.errstate(divide="ignore", invalid="ignore"):
        x = operation.exact(**{port: number.to_float(rows[port]) for port, number in operation.operands.items()})
    out = np.empty(len(rows), operation.records(name)[1].dtype)
    to = operation.result
    if isinstance(to, Fixed):
        out["result"] = to.quantise(x, operation.rounding)
        wide = Fixed(min(to.int_bits + 8, 53 - to.frac_bits), to.frac_bits, True).quantise(x, operation.rounding)
        out["saturated"] = out["result"] != wide
    else:
        out["result"] = to.quantise(x)
        out["saturated"] = np.abs(replace(to, exp_bits=10, bias=to.bias + 400).round(x)) > to.max
    return out
