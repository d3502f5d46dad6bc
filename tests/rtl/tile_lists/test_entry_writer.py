"""The entry writer alone: pages in every order, a frame behind another, no room, and memory that is late."""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Sequence

import numpy as np
import pytest
from amaranth.hdl import ResetInserter, Signal

from golden.msv2_ref.tile_lists import entry_words, tile_lists
from rtl.emit import to_rtlil
from rtl.tile_lists.entry_writer import IntersectionWriter
from spec.config import PAPER, TINY
from spec.memory import BEAT_ENTRIES, DIRECTORY_BEATS, WORDS, write_request
from spec.records import intersection_item, intersection_tile
from tests.helpers.rtl_ports import Moves, cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

SMALL = TINY.with_(row_width=64)  # 16 tiles
ITEM, HIT, WRITE = intersection_item(SMALL), intersection_tile(SMALL), write_request(SMALL)
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
    return play(IntersectionWriter(SMALL, slots=slots), {"entries": items}, takes, cycles, setup=SETTINGS, **options)


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
    passes = taken[1] - 1  # the first entry waits while places are cleared, and the next is taken when it has passed
    assert taken[-1] - passes == 300 + opened
    assert moves["hits"][0][0] - passes == 3 and moves["writes"][0][0] - passes == 7
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
    behind = [end + 1 for end in ends[:-1] if end + 1 < len(taken)]  # the first item of the next frame may wait in the writer
    assert behind and all(taken[place] - taken[place - 2] >= 16 for place in behind)


@pytest.mark.parametrize("slots", [1, 2, 16])
def test_a_tile_without_slots_is_full_for_all(slots):
    items = frame_items([4] * 120 + [5] * 10)
    full = []
    dut = IntersectionWriter(SMALL, slots=slots)
    moves = play(dut, {"entries": [*items, *frame_items([1, 2])]}, {"hits": 0.0, "writes": 0.0}, 250, setup=SETTINGS,
                 each=lambda ctx, cycle: full.append(ctx.get(dut.full)))
    hits, writes = wanted(items, slots=slots)
    more_hits, more_writes = wanted(frame_items([1, 2]))
    assert words_of(moves, "hits") == [*hits, *more_hits] and words_of(moves, "writes") == [*writes, *more_writes]
    assert (len(hits) == 97) == (slots == 1) == any(full)
    assert not full[-1]  # of the last frame


@pytest.mark.parametrize("beats", [127, 128, 128 + 15, 128 + 16, 128 + 16 + 31, 128 + 16 + 32])
def test_pages_end_where_the_room_does(beats):
    items, dut = frame_items([4] * 100), IntersectionWriter(SMALL)
    moves = play(dut, {"entries": items}, {"hits": 0.0, "writes": 0.0}, 150, setup=SETTINGS | {"entries_beats": beats})
    assert (words_of(moves, "hits"), words_of(moves, "writes")) == wanted(items, beats=beats)
    assert len(moves["hits"]) - 1 == {127: 0, 128: 32, 143: 32, 144: 96, 175: 96, 176: 100}[beats]


def test_the_end_waits_for_memory():
    dut = IntersectionWriter(SMALL)
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
    dut, reset, items = IntersectionWriter(SMALL), Signal(), frame_items([6] * 60 + [7] * 40)
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


def test_sizes():
    memories = re.findall(r"memory width (\d+) size (\d+)", to_rtlil(IntersectionWriter(PAPER), "writer"))
    assert sorted(memories) == [("23", "14400"), ("24", "14400")]


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: IntersectionWriter("tiny"), TypeError, "tiny")
    for slots, error in ((0, ValueError), (17, ValueError), (True, TypeError), (2.0, TypeError)):
        assert_rejected(lambda slots=slots: IntersectionWriter(SMALL, slots=slots), error, slots)
    assert_rejected(lambda: IntersectionWriter(PAPER.with_(row_width=8192)), ValueError, 8192)
