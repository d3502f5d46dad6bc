"""Converts whole arrays of records to bit patterns and back, one field of all rows at a time: fast for millions of rows.

`Record.pack` and `Record.unpack` do the same for one row as Python's integers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from spec.formats import Fixed, Format
from spec.records import Record

_WORD = 64


def pattern_bytes(record: Record) -> int:
    """Bytes that hold a record."""
    return -(-record.width // 8)


def _places(record: Record) -> Iterator[tuple[str, int, Format, int, int]]:
    """For every number of a record: its field, its place in the field, its format, its word, and its lowest bit in that
    word."""
    offset = 0
    for f in record.fields:
        for number in range(f.count):
            yield f.name, number, f.format, *divmod(offset, _WORD)
            offset += f.format.width


def pack(record: Record, rows: np.ndarray | Mapping[str, np.ndarray], size: int | None = None) -> np.ndarray:
    """(N, size) uint8, little-endian bit patterns of rows; the bits above the record are 0.

    Args:
        record: the layout.
        rows: (N,) records that have its fields, or an array of N, or of N times the field's count, by field.
        size: bytes of a row; None: as few as hold the record.

    Raises:
        ValueError: a raw value does not fit its field, or the record does not fit the size.
    """
    size = pattern_bytes(record) if size is None else size
    if 8 * size < record.width:
        raise ValueError(f"size must hold {record.width} bits, not {size!r} bytes")
    words: np.ndarray | None = None
    for name, number, form, word, shift in _places(record):
        column = np.asarray(rows[name])
        column = column if column.ndim == 1 else column[:, number]
        low, high = (form.raw_min, form.raw_max) if isinstance(form, Fixed) else (0, (1 << form.width) - 1)
        if len(column) and not (low <= column.min() and column.max() <= high):
            wrong = column[(column < low) | (column > high)][0]
            raise ValueError(f"{record.name}.{name} must be in {low}..{high}, not {int(wrong)!r}")
        if words is None:
            words = np.zeros((-(-8 * size // _WORD), len(column)), "<u8")
        bits = column.astype(np.int64).astype(np.uint64) & np.uint64((1 << form.width) - 1)
        words[word] |= bits << np.uint64(shift)
        if shift + form.width > _WORD:
            words[word + 1] |= bits >> np.uint64(_WORD - shift)
    if words is None:
        raise ValueError(f"{record.name} must have a field to be packed")
    patterns = np.ascontiguousarray(words.T).view(np.uint8)
    return patterns if patterns.shape[1] == size else np.ascontiguousarray(patterns[:, :size])


def unpack(record: Record, patterns: np.ndarray) -> np.ndarray:
    """(N,) rows of `record`'s dtype from (N, bytes) uint8 little-endian bit patterns; bits above the record are ignored.

    Raises:
        ValueError: the patterns are shorter than the record.
    """
    count, size = patterns.shape
    if 8 * size < record.width:
        raise ValueError(f"patterns must hold {record.width} bits, not {size!r} bytes")
    if size % (_WORD // 8):
        patterns = np.pad(patterns, ((0, 0), (0, -size % (_WORD // 8))))
    words = np.ascontiguousarray(patterns).view("<u8")
    rows = np.empty(count, record.dtype)
    for name, number, form, word, shift in _places(record):
        bits = words[:, word] >> np.uint64(shift)
        if shift + form.width > _WORD:
            bits = bits | words[:, word + 1] << np.uint64(_WORD - shift)
        bits = bits & np.uint64((1 << form.width) - 1)
        raw = form.from_bits(bits) if isinstance(form, Fixed) else bits.astype(np.int64)
        column = rows[name]
        if column.ndim == 1:
            column[:] = raw
        else:
            column[:, number] = raw
    return rows
