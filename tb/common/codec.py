"""Converts bit patterns to files that Verilog reads and writes, and back. `spec.packing` converts records to bit patterns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_HEX = np.frombuffer(b"0123456789abcdef", np.uint8)
_DIGIT = np.full(256, 255, np.uint8)
_DIGIT[_HEX] = np.arange(16)


def write_hex(path: Path, patterns: np.ndarray) -> None:
    """Writes (N, bytes) little-endian bit patterns as N lines of hexadecimal digits, highest digit first."""
    count, size = patterns.shape
    text = np.full((count, 2 * size + 1), ord("\n"), np.uint8)
    backward = patterns[:, ::-1]
    text[:, 0:-1:2], text[:, 1:-1:2] = _HEX[backward >> 4], _HEX[backward & 15]
    text.tofile(path)


def read_hex(path: Path, width: int) -> np.ndarray:
    """(N, bytes) uint8 little-endian bit patterns of `width` bits from lines of ceil(width / 4) hexadecimal digits.

    Raises:
        ValueError: a line of another length or with another character, such as the x of an unknown bit.
    """
    digits = (width + 3) // 4
    text = np.fromfile(path, np.uint8)
    if len(text) % (digits + 1):
        raise ValueError(f"{path}: lines must have {digits} digits, not {len(text)!r} characters in all")
    values = _DIGIT[text.reshape(-1, digits + 1)[:, :-1]]
    if (values == 255).any():
        raise ValueError(f"{path}: line {int(np.argwhere(values == 255)[0][0])} has a character that is no hexadecimal digit")
    values = values[:, ::-1]
    if digits % 2:
        values = np.pad(values, ((0, 0), (0, 1)))
    return values[:, 0::2] | values[:, 1::2] << 4
