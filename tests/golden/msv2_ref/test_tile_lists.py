"""Pages of tile entries: each rule by hand, against a list of pages kept entry by entry."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref.tile_lists import entry_words, grouped_entries, memory_image, rank_in_tile, tile_lists
from spec.config import PAPER, TINY
from spec.memory import BEAT_ENTRIES, DIRECTORY_SLOTS, FIRST_PAGE_ENTRIES, WORDS
from spec.records import intersection, tile_group


def entries_of(config, rng, tile) -> np.ndarray:
    rows = np.zeros(len(tile), intersection(config).dtype)
    rows["tile"], rows["index"] = tile, np.arange(len(tile))
    rows["depth_key"] = rng.integers(0, 1 << 24, len(tile))
    return rows


def one_by_one(tile, tiles: int, beats: int, slots: int):
    """The pages as a program would keep them: places of the written entries, pages in order, whether one found no room."""
    pages, used, places, handed, free = [[8 * t] for t in range(tiles)], [0] * tiles, {}, [], 8 * tiles
    for number, t in enumerate(tile):
        if t >= tiles:
            continue
        k, inside = len(pages[t]) - 1, used[t] - sum(FIRST_PAGE_ENTRIES << j for j in range(len(pages[t]) - 1))
        if inside == FIRST_PAGE_ENTRIES << k:
            k, inside = k + 1, 0
            if k > slots or free + (8 << k) > beats:
                return places, handed, True
            pages[t].append(free)
            handed.append((t, k - 1, free))
            free += 8 << k
        if 8 * tiles > beats:
            return places, handed, True
        places[number] = pages[t][k] * BEAT_ENTRIES + inside
        used[t] += 1
    return places, handed, False


@pytest.mark.parametrize("seed", range(40))
def test_places_are_those_of_pages_kept_entry_by_entry(seed):
    rng = np.random.default_rng(seed)
    tiles, slots = int(rng.integers(1, 9)), int(rng.choice([1, 2, 3, DIRECTORY_SLOTS]))
    tile = rng.integers(0, tiles + (seed % 3 == 0), int(rng.integers(0, 1500)))
    beats = int(rng.choice([8 * tiles - 1, 8 * tiles, 8 * tiles + 16, 8 * tiles + 200, 10_000]))
    places, handed, full = one_by_one(tile.tolist(), tiles, beats, slots)
    lists = tile_lists(tile, tiles, beats, slots)
    assert dict(zip(np.flatnonzero(lists.written).tolist(), lists.number[lists.written].tolist(), strict=True)) == places
    assert list(zip(lists.page_tile.tolist(), lists.page_slot.tolist(), lists.page_beat.tolist(), strict=True)) == handed
    assert lists.full == full and lists.beats == 8 * tiles + sum(16 << slot for _, slot, _ in handed)
    assert len(lists.hits) == len(places) + int((tile >= tiles).sum())


@pytest.mark.parametrize(("count", "pages"), [(32, 0), (33, 1), (96, 1), (97, 2), (224, 2), (225, 3), (32 * 255, 7)])
def test_pages_double(count, pages):
    lists = tile_lists(np.zeros(count, int), 1, 1 << 20)
    assert lists.page_slot.tolist() == list(range(pages))
    assert lists.page_beat.tolist() == [8 * ((1 << k + 1) - 1) for k in range(pages)]
    assert np.array_equal(lists.number, np.arange(count))  # one tile's pages lie behind each other


def test_a_tile_holds_what_the_map_says():
    lists = tile_lists(np.zeros(4_194_273, int), 1, 1 << 26)
    assert lists.full and lists.written.sum() == 4_194_272 and len(lists.page_beat) == DIRECTORY_SLOTS


@pytest.mark.parametrize("config", [TINY, PAPER], ids=lambda config: config.name)
def test_the_image_read_by_its_directory_gives_every_tile_its_entries_in_order(config):
    rng = np.random.default_rng(5)
    tile = rng.choice(12, 3000, p=np.array([0, 1, 1, 2, 3, 5, 8, 90, 300, 1, 1, 1]) / 413)
    entries = entries_of(config, rng, tile)
    lists = tile_lists(tile, 12, 100_000)
    pages, directory = memory_image(config, lists, entries)
    for t in range(12):
        rows, k, beat = np.flatnonzero(tile == t), 0, 8 * t
        while len(rows):
            here = rows[: FIRST_PAGE_ENTRIES << k]
            words = pages[beat : beat + -(-len(here) // BEAT_ENTRIES)].reshape(-1, 2)[: len(here)].tolist()
            assert [low | high << 32 for low, high in words] == [intersection(config).pack(entries[row]) for row in here]
            rows, k = rows[len(here) :], k + 1
            beat = int(directory.reshape(12, -1)[t, k - 1])
        assert not directory.reshape(12, -1)[t, max(k - 1, 0) :].any()
    assert directory.shape[1] == WORDS


def test_words_are_packed_records():
    rng = np.random.default_rng(1)
    entries = entries_of(PAPER, rng, rng.integers(0, 14_400, 50))
    packed = [int(low) | int(high) << 32 for low, high in entry_words(PAPER, entries)]
    assert packed == [intersection(PAPER).pack(row) for row in entries]


def test_rank_counts_what_came_before():
    tile = np.array([3, 1, 3, 3, 0, 1])
    assert rank_in_tile(tile).tolist() == [0, 0, 1, 2, 0, 1] and len(rank_in_tile(tile[:0])) == 0


def test_groups_end_with_their_last_entry_even_where_empty_tiles_follow():
    rng = np.random.default_rng(2)
    entries = entries_of(TINY, rng, np.array([4, 0, 2, 4, 0]))
    groups = np.zeros(6, tile_group(TINY).dtype)
    groups["tile"], groups["count"], groups["last"] = np.arange(6), [2, 0, 1, 0, 2, 0], [0, 1, 0, 1, 0, 1]
    rows = grouped_entries(TINY, entries, groups)
    assert rows["index"].tolist() == [1, 4, 2, 0, 3] and rows["last"].tolist() == [0, 1, 1, 0, 1]
    groups["last"] = [1, 1, 1, 1, 1, 1]
    assert grouped_entries(TINY, entries, groups)["last"].tolist() == [0, 1, 1, 0, 1]
    groups["count"] = 0
    assert len(grouped_entries(TINY, entries[:0], groups)) == 0
