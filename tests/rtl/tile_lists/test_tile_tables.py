"""Readers of the tile table and of geometry, and the header maker: each beat once, in order, and errors told."""

from __future__ import annotations

import random

import pytest

from rtl.tile_lists.beats import BeatRun
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker, waiting_tiles
from rtl.tile_lists.table_loader import TableLoader
from rtl.tile_lists.tile_settings import TileSettings
from spec.config import TINY, TINY_EYES
from spec.memory import BEAT_BITS, tile_setting
from spec.records import gaussian_geometry, tile_group, tile_header, tile_level, tile_use
from tests.helpers.rtl_ports import beats_of, cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

SMALL = TINY.with_(row_width=64)  # 16 tiles


def test_headers_wait_for_a_whole_group():
    """Two rows of tiles and more are taken while memory, array and fetch unit stand still."""
    dut = HeaderMaker(TINY)
    record = tile_group(TINY)
    rows = [record.pack({"tile": t, "count": t, "group": 0, "last": 0}) for t in range(1024)]
    moves = play(dut, {"tiles": rows}, {"reads": 1.0, "headers": 1.0, "levels": 1.0}, 300,
                 setup={"tiles_base": 5, "tiles_x": 32, "tile_count": 1024})
    assert len(moves["tiles"]) == waiting_tiles(TINY) >= 2 * 32


@pytest.mark.parametrize("late", [0, 40, 100])
def test_a_header_and_a_use_a_cycle(late):
    """Two frames of different shapes behind each other, the second's table read afresh; an error is raised and lowered."""
    rng, setting, header, use = random.Random(late), tile_setting(TINY), tile_header(TINY), tile_use(TINY)
    dut, record, errors = HeaderMaker(TINY), tile_group(TINY), []
    tiles, tiles_x = 130, 11
    table = [{"plane": [rng.randrange(-2**18, 2**18) for _ in range(3)], "level": rng.randrange(4), "blend": rng.randrange(2)}
             for _ in range(tiles)]
    counts = [rng.randrange(1 << 24) for _ in range(2 * tiles)]
    rows = [record.pack({"tile": i % tiles, "count": count, "group": 0, "last": 1}) for i, count in enumerate(counts)]
    words = [setting.pack(row) for row in table]

    def each(ctx, cycle):
        errors.append(ctx.get(dut.error))
        ctx.set(dut.clear, cycle == 330 + late)

    moves = play(
        dut, {"tiles": rows, "data": [*beats_of(words, 4), *beats_of(words, 4, (3,))]},
        {"reads": 0.0, "headers": 0.0, "levels": 0.0}, 600, setup={"tiles_base": 99, "tiles_x": tiles_x, "tile_count": tiles},
        each=each, late=late)
    full = [{**table[i % tiles], "tile_y": i % tiles // tiles_x, "tile_x": i % tiles % tiles_x, "count": count,
             "outer": int(table[i % tiles]["level"] > 0)} for i, count in enumerate(counts)]
    assert words_of(moves, "headers") == [header.pack(row) for row in full]
    assert words_of(moves, "levels") == [use.pack(row) for row in full]
    assert words_of(moves, "reads") == [99 + i for i in range(33)] * 2
    for port in ("headers", "levels"):
        cycles = cycles_of(moves, port)
        assert cycles[0] <= 9 + late and cycles[-1] - cycles[0] <= 2 * tiles + late
    assert errors[329 + late] and not errors[60] and not any(errors[332 + late :])


def test_a_frames_table_is_asked_for_to_its_end():
    """Where memory takes requests late, the next frame's first tile waits for those of the one before."""
    record = tile_group(SMALL)
    rows = [record.pack({"tile": t, "count": t, "group": 0, "last": 1}) for t in range(15)] * 3
    moves = play(
        HeaderMaker(SMALL), {"tiles": rows, "data": beats_of([0] * 48, 4)}, {"reads": 0.9, "headers": 0.0, "levels": 0.0}, 400,
        setup={"tiles_base": 99, "tiles_x": 4, "tile_count": 15})
    assert words_of(moves, "reads") == [99, 100, 101, 102] * 3 and len(moves["headers"]) == 45


@pytest.mark.parametrize(("tiles", "bad"), [(1, ()), (4, ()), (5, (1,)), (16, (0,))])
def test_the_table_is_loaded_once_a_start(tiles, bad):
    rng, record, setting = random.Random(tiles), tile_level(SMALL), tile_setting(SMALL)
    table = [{"plane": [rng.randrange(-2**18, 2**18) for _ in range(3)], "level": rng.randrange(4), "blend": rng.randrange(2)}
             for _ in range(tiles)]
    dut, seen = TableLoader(SMALL), []

    def each(ctx, cycle):
        ctx.set(dut.start, cycle in (2, 60))
        seen.append((ctx.get(dut.busy), ctx.get(dut.done), ctx.get(dut.error)))

    data = beats_of([setting.pack(row) for row in table], 4, bad)
    good = beats_of([setting.pack(row) for row in table], 4)
    moves = play(dut, {"data": [*data, *good]}, {"reads": 0.0, "levels": 0.2}, 120, each=each,
                 setup={"tiles_base": 77, "tile_count": tiles}, seed=tiles)
    expected = [record.pack({"tile": t, "level": row["level"], "blend": row["blend"]}) for t, row in enumerate(table)]
    assert words_of(moves, "levels") == expected * 2
    assert words_of(moves, "reads") == [77 + i for i in range(len(good))] * 2
    assert [cycle for cycle, (_, done, _) in enumerate(seen) if done] == [
        moves["levels"][tiles - 1][0] + 1, moves["levels"][-1][0] + 1]
    assert seen[59][2] == bool(bad) and not seen[-1][2] and not seen[-1][0] and seen[3][0]


@pytest.mark.parametrize(("tiles", "joint"), [(1, 1), (4, 1), (5, 1), (16, 1), (5, 0)])
def test_the_targets_table_follows_the_sources_in_joint_frames(tiles, joint):
    """Two frames: the first item of the target's comes after the last of the source's, and `done` after the last of all."""
    config = TINY_EYES.with_(row_width=64)
    rng, record, setting = random.Random(tiles), tile_level(config), tile_setting(config)
    tables = [[{"plane": [0] * 3, "level": rng.randrange(4), "blend": rng.randrange(2)} for _ in range(tiles)]
              for _ in range(1 + joint)]
    dut, done = TableLoader(config), []

    def each(ctx, cycle):
        ctx.set(dut.start, cycle in (2, 150))
        if ctx.get(dut.done):
            done.append(cycle)

    data = [beat for table in tables for beat in beats_of([setting.pack(row) for row in table], 4)]
    moves = play(dut, {"data": data * 2}, {"reads": 0.1, "levels": 0.2}, 300, each=each, seed=tiles,
                 setup={"tiles_base": 77, "target_tiles_base": 900, "joint": joint, "tile_count": tiles})
    expected = [record.pack({"tile": t, "level": row["level"], "blend": row["blend"], "eye": eye})
                for eye, table in enumerate(tables) for t, row in enumerate(table)]
    assert words_of(moves, "levels") == expected * 2
    assert words_of(moves, "reads") == [base + i for base in (77, 900)[: 1 + joint] for i in range(-(-tiles // 4))] * 2
    assert done == [moves["levels"][len(expected) - 1][0] + 1, moves["levels"][-1][0] + 1]


@pytest.mark.parametrize("points", [0, 1, 40])
def test_points_come_as_fast_as_their_beats(points):
    rng, record = random.Random(points), gaussian_geometry(SMALL)
    rows = [rng.getrandbits(record.width) for _ in range(points)]
    dut = GeometryReader(SMALL)
    junk = [row | rng.getrandbits(256 - record.width) << record.width for row in rows]
    moves = play(dut, {"data": beats_of(junk, 1)}, {"reads": 0.0, "points": 0.0}, 100,
                 setup={"geometry_base": (1 << BEAT_BITS) - 3, "gaussians": points},
                 each=lambda ctx, cycle: ctx.set(dut.start, cycle == 1))
    expected = [row | i << record.width for i, row in enumerate(rows)]
    assert words_of(moves, "points") == [*expected, points << record.width | 1 << record.width + 24]
    assert words_of(moves, "reads") == [((1 << BEAT_BITS) - 3 + i) % (1 << BEAT_BITS) for i in range(points)]
    assert cycles_of(moves, "points") == ([*range(3, points + 4)] if points else [2])


def test_bad_parameters_are_rejected():
    for make in (HeaderMaker, TableLoader, GeometryReader, TileSettings):
        assert_rejected(lambda make=make: make("tiny"), TypeError, "tiny")
    assert_rejected(lambda: BeatRun("tiny", 3), TypeError, "tiny")
