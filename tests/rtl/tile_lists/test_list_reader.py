"""The list reader and what walks a tile's pages for it: groups that end, beats in their order, an entry a cycle."""

from __future__ import annotations

import random

import pytest

from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.page_walk import ListedTiles, PageWalk
from spec.config import PAPER, TINY
from spec.records import chunk_item, tile_group
from tests.helpers.rtl_ports import beats_of, cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

SMALL = TINY.with_(row_width=64)  # 16 tiles
GROUP = tile_group(SMALL)
SETTINGS = {"directory_base": 7_000_001, "entries_base": 123_457}


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
    rng, record = random.Random(3), chunk_item(SMALL)
    rows = [{"tile": 2, "count": 11, "group": 0, "last": 1}, {"tile": 3, "count": 1, "group": 1, "last": 0},
            {"tile": 4, "count": 0, "group": 1, "last": 1}]
    entries = [rng.getrandbits(record.width - 2) for _ in range(12)]
    data = [*beats_of(entries[:11], 4), *beats_of(entries[11:], 4)]
    moves = play(ListReader(SMALL), {"tiles": [GROUP.pack(row) for row in rows], "data": data}, {"reads": 0.0, "groups": 0.0},
                 60, setup=SETTINGS)
    last = 1 << record.width - 2
    assert words_of(moves, "groups") == [*entries[:10], entries[10] | last, entries[11] | last]
    assert words_of(moves, "reads") == [SETTINGS["entries_base"] + beat for beat in (16, 17, 18, 24)]
    start = moves["reads"][0][0]
    assert (start, moves["groups"][0][0] - start) == (8, 2) and cycles_of(moves, "groups") == list(range(start + 2, start + 14))


def test_bad_parameters_are_rejected():
    for make in (ListReader, ListedTiles, PageWalk):
        assert_rejected(lambda make=make: make("tiny"), TypeError, "tiny")
    assert_rejected(lambda: ListReader(PAPER.with_(row_width=8192)), ValueError, 8192)
