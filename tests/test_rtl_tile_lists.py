"""The units of tile lists alone: what a memory around all of them does not show."""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from amaranth.hdl import ResetInserter, Signal, Value
from amaranth.lib import stream
from amaranth.sim import Simulator
from rtl_streams import assert_rejected

from golden.msv2_ref.tile_lists import entry_words, tile_lists
from rtl.emit import to_rtlil
from rtl.shapes import layout
from rtl.stream import Fork
from rtl.tile_lists.beats import BeatRun
from rtl.tile_lists.entry_writer import EntryWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker, waiting_tiles
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.page_walk import ListedTiles, PageWalk
from rtl.tile_lists.table_loader import TableLoader
from rtl.tile_lists.tile_settings import TileSettings
from spec.config import PAPER, TINY
from spec.memory import BEAT_BITS, BEAT_ENTRIES, DIRECTORY_BEATS, WORDS, read_data, tile_setting, write_request
from spec.records import (
    chunk_entry,
    entry_item,
    gaussian_geometry,
    tile_group,
    tile_header,
    tile_hit,
    tile_level,
    tile_use,
)

SMALL = TINY.with_(row_width=64)  # 16 tiles
ITEM, HIT, WRITE, GROUP = entry_item(SMALL), tile_hit(SMALL), write_request(SMALL), tile_group(SMALL)
Moves = dict[str, list[tuple[int, int]]]
"""By port: the cycle of each transfer, and what moved."""


def play(
    dut, feeds: Mapping[str, Sequence[int]], takes: Mapping[str, float], cycles: int, *, seed: int = 0, pauses: float = 0.0,
    setup: Mapping[str, int] | None = None, each: Callable | None = None, design=None, late: int = 0,
) -> Moves:
    """Words into streams of `dut` and out of others, each output held back in a share of the cycles: what moved when.

    `each(ctx, cycle)` is called in every cycle, before it. Words of `data` answer one transfer of `reads` each, at least
    `late` cycles after it. Checks that what is offered stays as it is.
    """
    rng, moves, left = random.Random(seed), {name: [] for name in (*feeds, *takes)}, {n: list(w) for n, w in feeds.items()}

    async def bench(ctx):
        for name, value in (setup or {}).items():
            ctx.set(getattr(dut, name), value)
        offered, held = dict.fromkeys(feeds, False), {}
        for cycle in range(cycles):
            if each:
                each(ctx, cycle)
            for name, words in left.items():
                port = getattr(dut, name)
                asked = name != "data" or (
                    len(moves["reads"]) > len(moves["data"]) and moves["reads"][len(moves["data"])][0] + late < cycle)
                offered[name] = bool(words) and asked and (offered[name] or rng.random() >= pauses)
                ctx.set(port.valid, offered[name])
                if offered[name]:
                    ctx.set(Value.cast(port.payload), words[0])
            for name, share in takes.items():
                ctx.set(getattr(dut, name).ready, rng.random() >= share)
            await ctx.delay(1e-10)
            for name in moves:
                port: stream.Interface = getattr(dut, name)
                valid, ready, word = ctx.get(port.valid), ctx.get(port.ready), ctx.get(Value.cast(port.payload))
                if name in takes and name in held:
                    assert valid and held[name] == word, f"{name} must stay until it is taken"
                held.pop(name, None)
                if name in takes and valid and not ready:
                    held[name] = word
                if valid and ready:
                    moves[name].append((cycle, word))
                    if name in left:
                        left[name].pop(0)
                        offered[name] = False
            await ctx.tick()

    simulator = Simulator(design or dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return moves


def words_of(moves: Moves, port: str) -> list[int]:
    return [word for _, word in moves[port]]


def cycles_of(moves: Moves, port: str) -> list[int]:
    return [cycle for cycle, _ in moves[port]]


SETTINGS = {"directory_base": 7_000_001, "entries_base": 123_457, "entries_beats": 100_000, "tile_count": 16, "writes_idle": 1}
CLEARED = 17
"""Cycles from a reset on after which a small writer takes entries."""


def frame_items(tile: Sequence[int], seed: int = 0) -> list[int]:
    """Entries of these tiles and the frame's end."""
    rng = random.Random(seed)
    drawn = [{"index": rng.randrange(1 << 24), "depth_key": rng.randrange(1 << 24), "tile": t, "end": 0} for t in tile]
    return [*map(ITEM.pack, drawn), ITEM.pack({"index": 0, "depth_key": 0, "tile": 0, "end": 1})]


def wanted(items: Sequence[int], *, tiles: int = 16, beats: int = 100_000, slots: int = 16) -> tuple[list[int], list[int]]:
    """Hits and writes of one frame's items."""
    rows = np.zeros(len(items) - 1, ITEM.dtype)
    for row, word in zip(rows, items, strict=False):
        for name, value in ITEM.unpack(word).items():
            row[name] = value
    lists = tile_lists(rows["tile"], tiles, beats, slots)
    hits = [HIT.pack({"tile": int(t), "end": 0}) for t in lists.hits]
    pages = {int(beat): (int(t), int(slot)) for t, slot, beat in zip(
        lists.page_tile, lists.page_slot, lists.page_beat, strict=True)}
    writes = []
    inside = lists.written
    for number, pair in zip(lists.number[inside].tolist(), entry_words(SMALL, rows)[inside].tolist(), strict=True):
        beat, place = divmod(number, BEAT_ENTRIES)
        if place == 0 and beat in pages:
            t, slot = pages[beat]
            writes.append(WRITE.pack({"beat": SETTINGS["directory_base"] + t * DIRECTORY_BEATS + slot // WORDS,
                                      "word": [beat] * WORDS, "strobe": 1 << slot % WORDS}))
        writes.append(WRITE.pack({
            "beat": SETTINGS["entries_base"] + beat, "word": pair * BEAT_ENTRIES, "strobe": 3 << 2 * place}))
    return [*hits, HIT.pack({"tile": 0, "end": 1})], writes


def written(items: list[int], cycles: int, *, slots: int = 16, **options) -> Moves:
    takes = options.pop("takes", {"hits": 0.0, "writes": 0.0})
    return play(EntryWriter(SMALL, slots=slots), {"entries": items}, takes, cycles, setup=SETTINGS, **options)


@pytest.mark.parametrize(("before", "length"), [(30, 5), (94, 3)])
def test_every_order_of_neighbouring_entries_at_a_pages_end(before, length):
    """Place and origin that are read may be a cycle old: all sequences of entries of two tiles about to open a page."""
    for sequence in itertools.product(range(2), repeat=length):
        items = frame_items([*[0, 1] * before, 0, *sequence])
        moves = written(items, CLEARED + len(items) + 30)
        assert (words_of(moves, "hits"), words_of(moves, "writes")) == wanted(items), sequence


def test_a_writer_takes_an_entry_a_cycle_and_one_more_for_a_page():
    items = frame_items([3] * 300)
    moves = written(items, CLEARED + 340)
    taken, opened = cycles_of(moves, "entries"), 3
    assert taken[-1] - taken[0] == 300 + opened
    assert moves["hits"][0][0] - taken[0] == 3 and moves["writes"][0][0] - taken[0] == 7
    writes = cycles_of(moves, "writes")
    assert writes[-1] - writes[0] == 300 + opened - 1


@pytest.mark.parametrize("pauses", [0.0, 0.3, 0.7])
def test_frames_follow_each_other_behind_their_clearing(pauses):
    rng, frames = random.Random(1), []
    for _ in range(4):
        frames.append(frame_items([rng.choice([0, 5, 5, 5, 15]) for _ in range(rng.choice([0, 1, 90, 200]))], rng.random()))
    expected = [wanted(items) for items in frames]
    moves = written([item for items in frames for item in items], 4000, pauses=pauses, takes={"hits": pauses, "writes": pauses})
    assert words_of(moves, "hits") == [hit for hits, _ in expected for hit in hits]
    assert words_of(moves, "writes") == [write for _, writes in expected for write in writes]
    ends = np.cumsum([len(items) for items in frames])
    taken = cycles_of(moves, "entries")
    assert all(taken[end] - taken[end - 1] >= 16 for end in ends[:-1])


@pytest.mark.parametrize("slots", [1, 2, 16])
def test_a_tile_without_slots_is_full_for_all(slots):
    items = frame_items([4] * 120 + [5] * 10)
    full = []
    dut = EntryWriter(SMALL, slots=slots)
    moves = play(dut, {"entries": [*items, *frame_items([1, 2])]}, {"hits": 0.0, "writes": 0.0}, 250, setup=SETTINGS,
                 each=lambda ctx, cycle: full.append(ctx.get(dut.full)))
    hits, writes = wanted(items, slots=slots)
    more_hits, more_writes = wanted(frame_items([1, 2]))
    assert words_of(moves, "hits") == [*hits, *more_hits] and words_of(moves, "writes") == [*writes, *more_writes]
    assert (len(hits) == 97) == (slots == 1) == any(full)
    assert not full[-1]  # of the last frame


@pytest.mark.parametrize("beats", [127, 128, 128 + 15, 128 + 16, 128 + 16 + 31, 128 + 16 + 32])
def test_pages_end_where_the_room_does(beats):
    items, dut = frame_items([4] * 100), EntryWriter(SMALL)
    moves = play(dut, {"entries": items}, {"hits": 0.0, "writes": 0.0}, 150, setup=SETTINGS | {"entries_beats": beats})
    assert (words_of(moves, "hits"), words_of(moves, "writes")) == wanted(items, beats=beats)
    assert len(moves["hits"]) - 1 == {127: 0, 128: 32, 143: 32, 144: 96, 175: 96, 176: 100}[beats]


def test_the_end_waits_for_memory():
    dut = EntryWriter(SMALL)
    items = frame_items([1, 2, 3])

    def each(ctx, cycle):
        ctx.set(dut.writes_idle, cycle >= 80)

    moves = play(dut, {"entries": items}, {"hits": 0.0, "writes": 0.0}, 120, setup=SETTINGS | {"writes_idle": 0}, each=each)
    assert cycles_of(moves, "hits")[:3][-1] < 40 and 80 <= moves["hits"][3][0] <= 82
    late = play(dut, {"entries": items}, {"hits": 0.0, "writes": 0.9}, 200, setup=SETTINGS, seed=3)
    assert late["hits"][3][0] > late["writes"][-1][0]


@pytest.mark.parametrize("after", [3, 10, 18, 25, 60, 90, 105, 112, 118, 130])
def test_reset_in_mid_frame_leaves_nothing_behind(after):
    """While clearing, taking, at pages' ends, waiting for the end, clearing again."""
    dut, reset, items = EntryWriter(SMALL), Signal(), frame_items([6] * 60 + [7] * 40)
    second = frame_items([6] * 70 + [1, 2, 6, 6])
    moves = play(
        dut, {"entries": [*items, *second]}, {"hits": 0.0, "writes": 0.0}, 400, setup=SETTINGS,
        each=lambda ctx, cycle: ctx.set(reset, cycle == after), design=ResetInserter(reset)(dut))
    taken = [word for cycle, word in moves["entries"] if cycle > after]
    ends = [i for i, word in enumerate(taken) if ITEM.unpack(word)["end"]]
    expected = [wanted(taken[a:b]) for a, b in itertools.pairwise([0, *(end + 1 for end in ends)])]
    assert len(expected) == 2 - (after >= 118)  # the end of the first frame is taken in cycle 118
    assert [word for cycle, word in moves["hits"] if cycle > after] == [hit for hits, _ in expected for hit in hits]
    assert [word for cycle, word in moves["writes"] if cycle > after] == [w for _, writes in expected for w in writes]


def groups_of(rng: random.Random, tiles: int) -> list[dict]:
    rows = [{"tile": t, "count": rng.choice([0, 0, 1, 5]), "group": 0, "last": int(rng.random() < 0.3)} for t in range(tiles)]
    rows[-1]["last"] = 1
    return rows


@pytest.mark.parametrize("pauses", [0.0, 0.3, 0.8])
def test_tiles_without_entries_go_and_their_groups_still_end(pauses):
    rng = random.Random(pauses)
    rows = [row for _ in range(12) for row in groups_of(rng, 16)]
    expected, pending = [], None
    for row in rows:
        if row["count"]:
            pending = [row["tile"], row["count"], 0]
            expected.append(pending)
        if row["last"] and pending:
            pending[2], pending = 1, None
    dut = ListedTiles(SMALL)
    shape = dut.listed.payload.shape()
    moves = play(dut, {"tiles": [GROUP.pack(row) for row in rows]}, {"listed": pauses}, 3000, pauses=pauses, seed=4)
    got = [shape.from_bits(word) for word in words_of(moves, "listed")]
    assert [[item.tile, item.count, item.last] for item in got] == expected
    if not pauses:
        assert cycles_of(moves, "tiles") == list(range(len(rows)))


def test_a_tiles_beats_and_pointers_are_those_of_its_pages():
    """Beats of a tile with pages, one cycle each; directory beats ahead of those of the tiles before."""
    dut = PageWalk(SMALL)
    listed, wants = dut.listed.payload.shape(), dut.wanted.payload.shape()
    tiles = [(1, 2, 0), (2, 40, 1), (3, 20_000, 1)]
    pointers = [1000, *(2000 + 10 * k for k in range(9))]
    moves = play(
        dut, {"listed": [listed.const({"tile": t, "count": c, "last": last}).as_bits() for t, c, last in tiles],
              "pointers": pointers}, {"wanted": 0.0}, 6000)
    got = [wants.from_bits(word) for word in words_of(moves, "wanted")]
    assert [(w.beat, w.more) for w in got if w.directory] == [(4, 0), (6, 7), (7, 0)]
    beats = [8, *range(16, 24), *(8000 + i for i in range(2)), *range(24, 32)]
    for k, pointer in enumerate(pointers[1:], 1):
        beats += [8 * pointer + i for i in range(8 << k)]
    pages = [w for w in got if not w.directory]
    assert [w.beat for w in pages] == beats[: len(pages)]
    assert [w.more + 1 for w in pages] == [2, *[4] * 10, *[4] * 5000]
    assert [i for i, w in enumerate(pages) if w.last] == [10, 5010]
    assert max(i for i, w in enumerate(got) if w.directory) < 8  # long before their tile's turn
    cycles = cycles_of(moves, "wanted")
    assert cycles[-1] - cycles[0] <= len(got) + 12


def test_latency_of_a_list():
    """A first page's first entry, and one that the group's next tile lets go; then an entry a cycle."""
    rng, record = random.Random(3), chunk_entry(SMALL)
    rows = [{"tile": 2, "count": 11, "group": 0, "last": 1}, {"tile": 3, "count": 1, "group": 1, "last": 0},
            {"tile": 4, "count": 0, "group": 1, "last": 1}]
    entries = [rng.getrandbits(record.width - 2) for _ in range(12)]
    data = [*beats_of(entries[:11], 4), *beats_of(entries[11:], 4)]
    moves = play(ListReader(SMALL), {"tiles": [GROUP.pack(row) for row in rows], "data": data}, {"reads": 0.0, "groups": 0.0},
                 60, setup={key: SETTINGS[key] for key in ("directory_base", "entries_base")})
    last = 1 << record.width - 2
    assert words_of(moves, "groups") == [*entries[:10], entries[10] | last, entries[11] | last]
    assert words_of(moves, "reads") == [SETTINGS["entries_base"] + beat for beat in (16, 17, 18, 24)]
    start = moves["reads"][0][0]
    assert (start, moves["groups"][0][0] - start) == (8, 2) and cycles_of(moves, "groups") == list(range(start + 2, start + 14))


@pytest.mark.parametrize("pauses", [0.0, 0.5])
def test_a_fork_gives_every_item_to_each_at_its_pace(pauses):
    dut, got = Fork(8, 3), [[], [], []]

    async def bench(ctx):
        rng, words = random.Random(2), list(range(200))
        for cycle in range(1000):
            ctx.set(dut.sink.valid, bool(words))
            ctx.set(dut.sink.payload, words[0] if words else 0)
            for source, share in zip(dut.sources, (0.0, pauses, pauses / 2), strict=True):
                ctx.set(source.ready, rng.random() >= share)
            await ctx.delay(1e-10)
            for source, found in zip(dut.sources, got, strict=True):
                if ctx.get(source.valid) and ctx.get(source.ready):
                    found.append((cycle, ctx.get(source.payload)))
            if words and ctx.get(dut.sink.ready):
                words.pop(0)
            assert max(map(len, got)) - min(map(len, got)) <= 2
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert all([word for _, word in found] == list(range(200)) for found in got)
    if not pauses:
        assert [cycle for cycle, _ in got[0]] == list(range(1, 201))


def test_a_fork_holds_back_no_consumer_for_another_beyond_two_items():
    dut = Fork(8)

    async def bench(ctx):
        ctx.set(dut.sink.valid, 1)
        ctx.set(dut.sources[0].ready, 1)
        taken = 0
        for _ in range(20):
            taken += ctx.get(dut.sources[0].valid)
            await ctx.tick()
        assert taken == 2

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


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


def beats_of(words: Sequence[int], per_beat: int, error: Sequence[int] = ()) -> list[int]:
    """ReadData with several words of the same size each."""
    record, size = read_data(SMALL), 256 // per_beat
    found = []
    for start in range(0, len(words), per_beat):
        bits = sum(word << size * i for i, word in enumerate(words[start : start + per_beat]))
        words_32 = [bits >> 32 * i & 0xFFFFFFFF for i in range(WORDS)]
        found.append(record.pack({"word": words_32, "error": start // per_beat in error}))
    return found


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


def test_sizes():
    memories = re.findall(r"memory width (\d+) size (\d+)", to_rtlil(EntryWriter(PAPER), "writer"))
    assert sorted(memories) == [("23", "14400"), ("24", "14400")]


def test_bad_parameters_are_rejected():
    for make in (EntryWriter, ListReader, HeaderMaker, TableLoader, GeometryReader, ListedTiles, PageWalk, TileSettings):
        assert_rejected(lambda make=make: make("tiny"), TypeError, "tiny")
    assert_rejected(lambda: BeatRun("tiny", 3), TypeError, "tiny")
    for slots, error in ((0, ValueError), (17, ValueError), (True, TypeError), (2.0, TypeError)):
        assert_rejected(lambda slots=slots: EntryWriter(SMALL, slots=slots), error, slots)
    for count, error in ((0, ValueError), (True, TypeError), ("2", TypeError)):
        assert_rejected(lambda count=count: Fork(layout(GROUP), count), error, count)
    for make in (EntryWriter, ListReader):
        assert_rejected(lambda make=make: make(PAPER.with_(row_width=8192)), ValueError, 8192)
