"""The join of the rows of four arrays: what leaves are the rows of one array, in its order, under any timing."""

from __future__ import annotations

import numpy as np
import pytest
from amaranth.sim import Simulator

from rtl.supertiles.row_join import RowJoin
from spec.config import TINY_STREAMS, V3, V3_STREAMS
from spec.constants import TILE
from spec.packing import pack
from spec.records import pixel_row
from spec.supertiles import frame_rows

TILES = 3
CONFIGS = (TINY_STREAMS, V3_STREAMS, V3_STREAMS.with_(cores_y=8))


def rows_of(config, rng, first_row=0, rows=TILE, first_column=0, columns=TILE):
    """The rows that an array gives of a part of TILES tiles, in its order, and where they lie: (tile, row, column)."""
    places = [(tile, first_row + band + y, first_column + x) for tile in range(TILES) for band in range(0, rows, config.array_y)
              for x in range(0, columns, config.array_x) for y in range(config.array_y)]
    items = np.zeros(len(places), pixel_row(config).dtype)
    items["tile_x"], items["row"], items["column"] = np.array(places).T
    for name in ("colour", "transmittance", "depth"):
        items[name] = rng.integers(0, 1 << 12, items[name].shape)
    return places, items


def patterns(config, rows):
    """The rows' bits, an integer for each."""
    return [int.from_bytes(row.tobytes(), "little") for row in pack(pixel_row(config), rows)]


def expected(config, of_stream):
    """The rows of the joined array, put together from those of the streams by their places."""
    whole = frame_rows(config)
    places, items = rows_of(whole, np.random.default_rng(0))
    known = {place: item for places_, rows in of_stream for place, item in zip(places_, rows, strict=True)}
    for place, item in zip(places, items, strict=True):
        parts = [known[place[0], place[1], place[2] + x] for x in range(0, whole.cores_x, config.array_x)]
        for name in ("colour", "transmittance", "depth"):
            item[name] = np.concatenate([np.atleast_1d(part[name]) for part in parts])
    return items


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: f"{config.array_x}x{config.array_y}")
@pytest.mark.parametrize("pace", [(1.0, 1.0), (0.5, 0.7), (0.2, 1.0), (1.0, 0.3)])
def test_rows_are_those_of_one_array(config, pace):
    rng, side = np.random.default_rng(5), config.region
    streams = [rows_of(config, rng, q // 2 * side, side, q % 2 * side, side) for q in range(config.streams)]
    wanted = expected(config, streams)
    unit, got, cycles = RowJoin(config), [], 0
    words = [patterns(config, rows) for _, rows in streams]

    async def play(ctx):
        nonlocal cycles
        at, offered = [0] * 4, [False] * 4
        while len(got) < len(wanted):
            assert cycles < 40 * len(wanted)
            cycles += 1
            for q in range(4):  # a row that is offered stays offered
                offered[q] = at[q] < len(words[q]) and (offered[q] or rng.random() < pace[0])
                ctx.set(unit.rows[q].valid, offered[q])
                if offered[q]:
                    ctx.set(unit.rows[q].payload.as_value(), words[q][at[q]])
            ctx.set(unit.joined.ready, rng.random() < pace[1])
            if ctx.get(unit.joined.valid) and ctx.get(unit.joined.ready):
                got.append(ctx.get(unit.joined.payload.as_value()))
            for q in range(4):
                if offered[q] and ctx.get(unit.rows[q].ready):
                    at[q], offered[q] = at[q] + 1, False
            await ctx.tick()
        assert at == [len(rows) for rows in words]

    simulator = Simulator(unit)
    simulator.add_clock(1e-9)
    simulator.add_testbench(play)
    simulator.run()
    assert got == patterns(frame_rows(config), wanted)
    assert pace != (1.0, 1.0) or cycles == len(wanted)  # a row a cycle


def test_the_rows_are_those_of_an_array_as_wide_as_a_tile_where_two_regions_are():
    assert (frame_rows(V3_STREAMS).cores_x, frame_rows(V3_STREAMS).cores_y) == (16, 8)
    assert (frame_rows(TINY_STREAMS).cores_x, frame_rows(TINY_STREAMS).streams) == (4, 1)
    assert frame_rows(V3) is V3


def test_one_stream_is_refused():
    with pytest.raises(ValueError, match=r"^streams must be more than 1 for this unit, not 1$"):
        RowJoin(V3)
    with pytest.raises(TypeError, match=r"^config must be an AcceleratorConfig, not 3$"):
        RowJoin(3)
