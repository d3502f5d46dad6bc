"""Records: pack, unpack, widths, and values that do not fit."""

from __future__ import annotations

import numpy as np
import pytest

from spec.chunks import CHUNK
from spec.config import CONFIGS, DEFAULT, PAPER, TINY_EYES, TINY_V3
from spec.constants import MAX_LEVELS, SUPER_X, SUPER_Y, TILE
from spec.formats import SQ, UQ, SmallFloat
from spec.records import (
    INDEX_BITS,
    RECORDS,
    TILE_BITS,
    Field,
    Record,
    array_splat,
    frame_supertiles,
    gaussian_colour,
    gaussian_geometry,
    pixel_op,
    pixel_row,
    splat2d,
    tile_header,
    uint,
)
from spec.supertiles import CHUNK_BITS, batch_tiles

ALL = [make(config) for make in RECORDS for config in CONFIGS.values()] + [gaussian_colour(PAPER, d) for d in range(3)]
SAMPLE = Record("Sample", "", (
    Field("a", SQ(2, 1), ""), Field("b", UQ(3, 0), "", 2), Field("c", SmallFloat(3, 2, 1), ""), Field("d", uint(1), "")))


def random_row(record: Record, rng: np.random.Generator) -> np.void:
    row = np.zeros((), record.dtype)
    for f in record.fields:
        row[f.name] = rng.integers(*f.raw_range, size=f.count if f.count > 1 else None, endpoint=True)
    return row[()]


@pytest.mark.parametrize("record", ALL, ids=lambda r: f"{r.name}-{r.width}")
def test_random_rows_round_trip(record):
    rng = np.random.default_rng(3)
    for _ in range(20):
        row = random_row(record, rng)
        bits = record.pack(row)
        assert 0 <= bits < 1 << record.width
        back = record.unpack(bits)
        assert all(np.array_equal(back[f.name], row[f.name]) for f in record.fields)
        assert record.pack(back) == bits


@pytest.mark.parametrize("record", ALL, ids=lambda r: f"{r.name}-{r.width}")
def test_extremes_round_trip_and_one_beyond_is_refused(record):
    for f in record.fields:
        low, high = f.raw_range
        for value in (low, high):
            row = record.unpack(0) | {f.name: [value] * f.count}
            assert np.array_equal(record.unpack(record.pack(row))[f.name], [value] * f.count if f.count > 1 else value)
        for value in (low - 1, high + 1):
            with pytest.raises(ValueError, match=rf"^{record.name}\.{f.name} must be in .*, not {value}$"):
                record.pack(record.unpack(0) | {f.name: [low] * (f.count - 1) + [value]})


def test_layout_by_hand():
    """a = -1.5 is 1101, b = 5, 2, c = 0b10110, d = 1; field 0 in the lowest bits."""
    assert SAMPLE.width == 4 + 6 + 5 + 1
    assert SAMPLE.pack({"a": -3, "b": [5, 2], "c": 0b10110, "d": 1}) == 0b1_10110_010_101_1101
    assert SAMPLE.unpack(0b1_10110_010_101_1101) == {"a": -3, "b": [5, 2], "c": 0b10110, "d": 1}


@pytest.mark.parametrize("record", ALL, ids=lambda r: f"{r.name}-{r.width}")
def test_dtype_holds_every_value(record):
    assert len({f.name for f in record.fields}) == len(record.fields)
    for f in record.fields:
        info = np.iinfo(record.dtype[f.name].base)
        assert info.min <= f.raw_range[0] and f.raw_range[1] <= info.max


def test_wrong_count_of_numbers_is_refused():
    with pytest.raises(ValueError, match=r"Sample\.b must hold 2 numbers, not 3$"):
        SAMPLE.pack({"a": 0, "b": [1, 2, 3], "c": 0, "d": 0})


def test_geometry_is_one_dram_burst():
    assert all(gaussian_geometry(c).width <= 256 for c in CONFIGS.values())


def test_widths_follow_parameters():
    n = DEFAULT.formats
    for degree in range(4):
        coefficients = 3 * ((degree + 1) ** 2 - 1)
        assert gaussian_colour(DEFAULT, degree).width == 12 * n.sh_dc.width + coefficients * n.sh_rest.width
    assert {f.name: f.count for f in splat2d(DEFAULT).fields}["log2_opacity"] == MAX_LEVELS
    per_pixel = 3 * n.accumulator.width + n.depth_accumulator.width + n.transmittance.width
    for cores in (2, 4, 8, 16):
        assert pixel_row(DEFAULT.with_(cores_x=cores)).width == 2 * TILE_BITS + 8 + cores * per_pixel


def test_fields_reach_as_far_as_frames_do():
    """The widest and tallest frame a configuration may ask for has tiles that a header can name."""
    assert 8192 // TILE <= 1 << TILE_BITS
    names = [f.name for f in tile_header(DEFAULT).fields]
    assert names[:2] == ["tile_x", "tile_y"]
    assert all(f.doc for make in RECORDS for f in make(DEFAULT).fields)
    assert {f.name for f in pixel_op(DEFAULT).fields} >= {"exponent", "slope_x", "slope_y", "curve_xx", "curve_xy", "curve_yy"}


@pytest.mark.parametrize("width", [16, 100, 128, 130, 512])
@pytest.mark.parametrize("joint", [False, True])
def test_super_tiles_of_the_largest_frame(width: int, joint: bool):
    """They are counted pixel by pixel; a joint frame has one column more."""
    config = (TINY_EYES if joint else TINY_V3).with_(row_width=width)
    columns, rows = ({pixel // TILE // size for pixel in range(width)} for size in (SUPER_X, SUPER_Y))
    assert frame_supertiles(config) == (len(columns) + joint) * len(rows)


def test_numbers_have_the_bits_of_what_they_count():
    """An index word is a chunk's number and a place in it; an array with joint frames has the tiles of both eyes; an op has
    the colour of one level of the two that come with a splat."""
    assert CHUNK << CHUNK_BITS == 1 << INDEX_BITS
    assert batch_tiles(TINY_V3) == SUPER_X * SUPER_Y and batch_tiles(TINY_EYES) == 2 * SUPER_X * SUPER_Y
    colours = [{f.name: f.count for f in record(DEFAULT).fields}["colour"] for record in (pixel_op, array_splat)]
    assert colours == [3, 6]
