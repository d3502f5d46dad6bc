"""Converts whole arrays of records to words of memory and back, one field of all rows at a time, which is fast for millions
of rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from spec.formats import Fixed, Format
from spec.records import Record

_WORD = 64


def _places(record: Record) -> Iterator[tuple[str, int, Format, int, int]]:
    """For every number of a record: its field, its place in the field, its format, its word, and its lowest bit in that
    word."""
    offset = 0
    for f in record.fields:
        for number in range(f.count):
            yield f.name, number, f.format, *divmod(offset, _WORD)
            offset += f.format.width


def pack(record: Record, rows: np.ndarray | Mapping[str, np.ndarray], size: int) -> np.ndarray:
    """(N, size) uint8, little-endian bit patterns of N rows of `record`; the bits above the record are 0.

    Args:
        record: the layout.
        rows: (N,) records of the record's dtype, or a mapping from field to an array of N rows.
        size: number of bytes of a row, a multiple of 8 that holds the record.

    Raises:
        ValueError: a raw value does not fit its field, or the size is no such number.
    """
    if size % (_WORD // 8) or 8 * size < record.width:
        raise ValueError(f"size must be a multiple of 8 bytes and hold {record.width} bits, not {size!r}")
    words: np.ndarray | None = None
    for name, number, form, word, shift in _places(record):
        column = np.asarray(rows[name])
        column = column if column.ndim == 1 else column[:, number]
        low, high = (form.raw_min, form.raw_max) if isinstance(form, Fixed) else (0, (1 << form.width) - 1)
        if len(column) and not (low <= column.min() and column.max() <= high):
            wrong = column[(column < low) | (column > high)][0]
            raise ValueError(f"{record.name}.{name} must be in {low}..{high}, not {int(wrong)!r}")
        if words is None:
            words = np.zeros((size * 8 // _WORD, len(column)), "<u8")
        bits = column.astype(np.int64).astype(np.uint64) & np.uint64((1 << form.width) - 1)
        words[word] |= bits << np.uint64(shift)
        if shift + form.width > _WORD:
            words[word + 1] |= bits >> np.uint64(_WORD - shift)
    return np.ascontiguousarray(words.T).view(np.uint8)


def unpack(record: Record, patterns: np.ndarray) -> np.ndarray:
    """(N,) rows of `record`'s dtype from (N, size) uint8 little-endian bit patterns; `size` must be a multiple of 8."""
    words = np.ascontiguousarray(patterns).view("<u8")
    rows = np.empty(len(patterns), record.dtype)
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
