"""Whole arrays of records to bit patterns and back, against the packing of single rows."""

from __future__ import annotations

import numpy as np
import pytest

from spec.chunks import CHUNK_RECORDS
from spec.compact import COMPACT_RECORDS
from spec.config import TINY
from spec.memory import MEMORY_RECORDS, tile_setting
from spec.packing import pack, pattern_bytes, unpack
from spec.records import RECORDS, Record, chunk_item, intersection


def random_rows(record: Record, count: int, seed: int = 0) -> np.ndarray:
    """Rows with any values; the first two have the smallest and the largest of every field."""
    rng, rows = np.random.default_rng(seed), np.zeros(count, record.dtype)
    for f in record.fields:
        rows[f.name] = rng.integers(*f.raw_range, rows[f.name].shape, endpoint=True)
        rows[f.name][:2] = np.array(f.raw_range).reshape(2, *(1,) * (rows[f.name].ndim - 1))
    return rows


@pytest.mark.parametrize("make", [*RECORDS, *MEMORY_RECORDS, *CHUNK_RECORDS, *COMPACT_RECORDS], ids=lambda make: make.__name__)
def test_packing_is_that_of_the_record(make):
    record = make(TINY)
    rows, size = random_rows(record, 40), 8 * (-(-record.width // 64) + 1)
    patterns = pack(record, rows, size)
    assert [int.from_bytes(row.tobytes(), "little") for row in patterns] == [record.pack(row) for row in rows]
    assert (unpack(record, patterns) == rows).all()


def test_packing_refuses_what_does_not_fit():
    record = tile_setting(TINY)
    rows = np.zeros(3, record.dtype)
    rows["level"][1] = 4
    with pytest.raises(ValueError, match=r"TileSetting\.level must be in 0\.\.3, not 4"):
        pack(record, rows, 8)
    for size in (4, 7, 0):
        with pytest.raises(ValueError, match=f"not {size}"):
            pack(record, rows[:1], size)


@pytest.mark.parametrize("make", [*RECORDS, *MEMORY_RECORDS, *CHUNK_RECORDS, *COMPACT_RECORDS], ids=lambda make: make.__name__)
def test_patterns_are_as_short_as_the_record(make):
    record = make(TINY)
    rows = random_rows(record, 9)
    patterns = pack(record, rows)
    assert patterns.shape == (9, pattern_bytes(record)) and patterns.flags.c_contiguous
    assert (unpack(record, patterns) == rows).all()


def test_no_rows_give_no_patterns():
    record = intersection(TINY)
    patterns = pack(record, np.zeros(0, record.dtype))
    assert patterns.shape == (0, pattern_bytes(record)) and len(unpack(record, patterns)) == 0


def test_records_that_begin_as_another_pack_as_it():
    rows = random_rows(chunk_item(TINY), 20)
    record = intersection(TINY)
    alone = np.zeros(20, record.dtype)
    for f in record.fields:
        alone[f.name] = rows[f.name]
    assert (pack(record, rows, 8) == pack(record, alone, 8)).all()


def test_patterns_that_are_too_short_are_refused():
    with pytest.raises(ValueError, match="patterns must hold 60 bits, not 7 bytes"):
        unpack(tile_setting(TINY), np.zeros((1, 7), np.uint8))
