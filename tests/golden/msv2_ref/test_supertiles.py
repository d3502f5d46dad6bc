"""Super-tiles of the integer renderer against `spec.supertiles` in plain Python: pairs, lists, batches and visits, with ==."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import supertiles
from golden.msv2_ref.array import render_visits
from golden.msv2_ref.batches import FrameBatches, cut_batches
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.levels import smfr_levels
from spec.config import TINY, TINY_V3, V3, V3_RECORDS
from spec.constants import SUPER_X, SUPER_Y
from spec.supertiles import CHUNK_RUN, CHUNK_STREAMS, HEADER_WAYS, SEQUENCE_BITS
from tests.helpers.golden_samples import map_for, random_model, splats, turned_view, view

SMALL = TINY_V3.with_(batch_places=16)
"""Batches of 13 to 16 places."""

TILES = TINY.with_(name="tiles", order="spatial", chunks=True, records="compact")
"""TINY_V3 with lists by tile."""


def random_frame(seed: int, config=SMALL, **options) -> Frame:
    """A frame whose right and lower super-tiles are cut, with blend tiles and, by seed, few or many splats."""
    rng = np.random.default_rng(seed)
    camera = turned_view(*((300, 90), (140, 70), (64, 48))[seed % 3])
    model = random_model(rng, (1500, 60, 900)[seed % 3], levels=4, sh=seed % 2, wild=seed == 2)
    return render(model, camera, config=config, foveation=map_for(camera, (0.2, 0.6), 4), background=(0.1, 0.5, 0.9), **options)


@pytest.fixture(scope="module", params=range(4))
def frame(request) -> Frame:
    return random_frame(request.param)


def lists_of(frame: Frame) -> dict[int, list[tuple[int, int, int, int]]]:
    """By super-tile, its pairs in rendering order: (key, index word, row of the Gaussian, mask)."""
    r, e, masks = frame.registers, frame.entries, defaultdict(int)
    columns = -(-r.tiles_x // SUPER_X)
    for tile in range(len(r.header)):
        y, x = divmod(tile, r.tiles_x)
        number, place = y // SUPER_Y * columns + x // SUPER_X, y % SUPER_Y * SUPER_X + x % SUPER_X
        for splat in e.splat[e.start[tile] : e.start[tile + 1]].tolist():
            masks[number, splat] |= 1 << place
    words, lists = {}, {s: [] for s in range(columns * -(-r.tiles_y // SUPER_Y))}
    for chunk, header in enumerate(frame.words.chunks):
        for place in range(header["count"]):
            words[int(header["first"]) + place] = chunk * 64 + place
    for (number, splat), mask in masks.items():
        lists[number].append((int(frame.projected.depth_key[splat]), words[splat], splat, mask))
    return {number: sorted(pairs) for number, pairs in lists.items()}


def test_pairs_are_those_of_the_text(frame):
    wanted, pairs = lists_of(frame), frame.pairs
    got = np.column_stack([pairs.depth_key, pairs.index, pairs.splat, pairs.mask]).tolist()
    assert got == [list(pair) for number in sorted(wanted) for pair in wanted[number]]
    assert np.diff(pairs.start).tolist() == [len(wanted[number]) for number in sorted(wanted)]
    grid, header = supertiles.super_grid(frame.registers), frame.registers.header
    for number, mask, levels in zip(pairs.supertile.tolist(), pairs.mask.tolist(), pairs.levels.tolist(), strict=True):
        tiles = [int(grid.tile[number, place]) for place in range(16) if mask >> place & 1]
        assert levels == sum(1 << level for level in {int(header[tile, 0]) for tile in tiles})
    assert np.array_equal(pairs.splat[pairs.intersection], frame.entries.splat)


def test_index_words_order_gaussians_as_memory_does(frame):
    words = supertiles.index_words(frame.words.chunks)
    assert len(words) == len(frame.words.geometry) and (np.diff(words) > 0).all()
    first = frame.words.chunks["first"][words >> 6].astype(np.int64)
    assert np.array_equal(first + (words & 63), np.arange(len(words)))


def test_pairs_leave_the_tile_test_by_splat_and_super_tile(frame):
    rows = supertiles.binned_pairs(frame.config, frame.pairs)
    order = rows[:-1][["index", "supertile"]].tolist()
    assert order == sorted(order) and rows["end"].tolist() == [0] * len(order) + [1]
    assert sorted(rows[:-1][["supertile", "depth_key", "index"]].tolist()) == list(zip(
        frame.pairs.supertile.tolist(), frame.pairs.depth_key.tolist(), frame.pairs.index.tolist(), strict=True))


def batches_of(counts: list[list[int]], most: int) -> list[tuple[int, int, bool]]:
    """(super-tile, pairs, final) of each batch, pair by pair."""
    out = []
    for number, places in enumerate(counts):
        used = pairs = 0
        for n, count in enumerate(places):
            used, pairs = used + count, pairs + 1
            if most - used < 4 and n + 1 < len(places):
                out.append((number, pairs, False))
                used = pairs = 0
        out.append((number, pairs, True))
    return out


@pytest.mark.parametrize("seed", range(30))
def test_batches_end_where_few_places_are_free(seed):
    rng = np.random.default_rng(seed)
    most = int(rng.choice([16, 64]))
    counts = [rng.integers(1, rng.choice([2, 5]), rng.choice([0, 1, 12, 13, 60, 61, 122, int(rng.integers(400))])).tolist()
              for _ in range(int(rng.integers(1, 9)))]
    start = np.concatenate(([0], np.cumsum([len(c) for c in counts])))
    batches = cut_batches(start, np.concatenate([np.array(c, np.int64) for c in counts]), most)
    got = list(zip(batches.supertile.tolist(), np.diff(batches.start).tolist(), batches.final.tolist(), strict=True))
    assert got == batches_of(counts, most)


def test_places_and_visits_are_those_of_the_text(frame):
    """Places, visits and their entries, one after the other, from the pairs of each super-tile."""
    b, r, lists = FrameBatches(frame), frame.registers, lists_of(frame)
    levels, columns, visited = r.header[:, 0].tolist(), -(-r.tiles_x // SUPER_X), set()
    places, visits, entries = [], [], []
    counts = []
    for number in sorted(lists):
        y, x = number // columns * SUPER_Y, number % columns * SUPER_X
        tile_at = {p: (y + p // SUPER_X) * r.tiles_x + x + p % SUPER_X for p in range(16)
                   if y + p // SUPER_X < r.tiles_y and x + p % SUPER_X < r.tiles_x}
        of_pairs = [sorted({levels[t] for p, t in tile_at.items() if mask >> p & 1}) for *_, mask in lists[number]]
        counts.append([len(found) for found in of_pairs])
        places += [(splat, level, mask, level == found[-1])
                   for (*_, splat, mask), found in zip(lists[number], of_pairs, strict=True) for level in found]
        done = 0
        for _, size, final in batches_of([counts[-1]], frame.config.batch_places):
            part, done = lists[number][done : done + size], done + size
            for place, tile in tile_at.items():
                mine = [splat for *_, splat, mask in part if mask >> place & 1]
                if mine or final:
                    visits.append((tile, place, number % (1 << SEQUENCE_BITS), tile not in visited, final))
                    entries.append(mine)
                    visited.add(tile)
    p, v = b.places, b.visits
    assert list(zip(b.pairs.splat[p.pair].tolist(), p.level.tolist(), b.pairs.mask[p.pair].tolist(), p.last.tolist(),
                    strict=True)) == places
    assert list(zip(v.tile.tolist(), v.place.tolist(), (b.batches.supertile[v.batch] % 8).tolist(), v.fresh.tolist(),
                    v.final.tolist(), strict=True)) == visits
    assert [part.tolist() for part in np.split(frame.entries.splat[v.order], v.start[1:-1])] == entries
    assert p.slot.max(initial=0) < frame.config.batch_places and (np.bincount(p.batch) <= frame.config.batch_places).all()


def test_records_of_batches(frame):
    b, r = FrameBatches(frame), frame.registers
    tiles = b.supertile_records
    assert tiles["pairs"].tolist() == np.diff(frame.pairs.start).tolist()
    grid = b.grid
    for number in range(len(tiles)):
        for place in range(16):
            tile, row = grid.tile[number, place], tiles[number]
            inside = (row["y"] + place // SUPER_X < r.tiles_y) and (row["x"] + place % SUPER_X < r.tiles_x)
            assert (row["inside"] >> place & 1) == inside == (tile >= 0)
            level, blend = (r.header[tile, 0], r.header[tile, 1]) if inside else (0, 0)
            assert (row["level"][place], row["blend"] >> place & 1) == (level, blend)
            assert row["plane"].reshape(16, 3)[place].tolist() == (r.plane[tile].tolist() if inside else [0, 0, 0])
    places, visits, entries = b.place_records, b.visit_records, b.entry_records
    assert entries["end"].sum() == len(visits) and len(entries) == len(visits) + len(frame.entries.splat)
    # Each entry is the place of its pair at the level of the visited tile.
    ends = np.flatnonzero(entries["end"])
    table = {of: n for n, of in enumerate(zip(b.places.pair.tolist(), b.places.level.tolist(), strict=True))}
    rows = iter(b.visits.order.tolist())
    for n, end in enumerate(ends.tolist()):
        tile = b.visits.tile[n]
        for entry in entries[ends[n - 1] + 1 if n else 0 : end]:
            place = places[table[int(b.pairs.intersection[next(rows)]), int(r.header[tile, 0])]]
            assert all(np.array_equal(place[f], entry[f]) for f in ("mean2d", "conic", "log2_opacity", "colour", "depth"))
            assert place["mask"] >> visits["place"][n] & 1
            assert entry["use"].tolist() == [1, int(r.header[tile, 1] and place["bound"] > r.header[tile, 0])]


def assert_visits_give_the_pixels(frame: Frame) -> None:
    b = FrameBatches(frame)
    pixels = render_visits(frame.config, b.visit_records, b.entry_records, frame.registers.background)
    tile = b.visits.tile[b.visits.final]
    assert sorted(tile.tolist()) == list(range(len(frame.registers.header)))
    for name, got in pixels._asdict().items():
        assert np.array_equal(got, getattr(frame.pixels, name)[tile]), name


def test_visits_give_the_pixels(frame):
    assert_visits_give_the_pixels(frame)
    if len(frame.pairs.splat) > 1000:
        assert np.bincount(FrameBatches(frame).visits.tile).max() > 10


@pytest.mark.parametrize("seed", range(3))
def test_pixels_are_those_of_lists_by_tile(seed):
    frame, other = random_frame(seed), random_frame(seed, TILES)
    assert np.array_equal(frame.words.chunks, other.words.chunks)
    for got, wanted in zip(frame.pixels, other.pixels, strict=True):
        assert np.array_equal(got, wanted)
    assert frame.entries.filtered == other.entries.filtered and np.array_equal(frame.entries.splat, other.entries.splat)


@pytest.mark.parametrize("gaze", [None, (0.5, 0.5), (0.1, 0.9)])
def test_the_embedded_scene(gaze):
    model, camera = smfr_levels(cached_embedded_model()), embedded_cameras(240, 136)[2]
    foveation = map_for(camera, gaze, 4)
    by_tile, frame = (render(model, camera, config=config, foveation=foveation) for config in (V3_RECORDS, V3))
    assert np.array_equal(by_tile.image, frame.image) and np.array_equal(by_tile.depth, frame.depth, equal_nan=True)
    assert_visits_give_the_pixels(frame)
    assert len(frame.pairs.splat) < len(frame.entries.splat)


def test_lists_merge_as_tiles_of_one_row():
    """A group may end in the middle of a super-tile, and goes on over the ends of rows of super-tiles."""
    rng = np.random.default_rng(0)
    frame = render(random_model(rng, 200), view(128, 160), config=TINY_V3, beta=1 << 20)
    assert len(frame.pairs.start) - 1 == 5 and frame.groups.tolist() == [0] * 5
    counts = np.diff(frame.pairs.start)
    again = render(random_model(np.random.default_rng(0), 200), view(128, 160), config=TINY_V3)
    beta = round(2 * counts[counts > 0].mean())
    assert np.array_equal(again.groups, supertiles.merge_lists(TINY_V3, counts, beta))


def test_frames_without_splats():
    frame = render(random_model(np.random.default_rng(0), 0), view(200, 40), config=SMALL)
    b = FrameBatches(frame)
    assert b.batches.supertile.tolist() == [0, 1, 2, 3] and b.batches.final.all() and len(b.places.pair) == 0
    assert len(b.visits.tile) == 13 * 3 and (b.visits.fresh & b.visits.final).all()
    assert_visits_give_the_pixels(frame)


@pytest.mark.parametrize("size", [(5, 7), (16, 16), (17, 16), (16, 17)])
def test_frames_of_a_tile_or_two(size):
    frame = render(random_model(np.random.default_rng(0), 50), view(*size), config=SMALL)
    assert len(frame.entries.splat) and FrameBatches(frame).supertile_records["inside"].tolist() == [
        {(17, 16): 3, (16, 17): 1 | 1 << SUPER_X}.get(size, 1)]
    assert_visits_give_the_pixels(frame)


@pytest.mark.parametrize("first", [0, 1, (1 << SEQUENCE_BITS) - 1])
def test_visits_name_their_super_tile_by_its_last_bits(frame, first):
    b = FrameBatches(frame)
    wanted = [(first + int(number)) % (1 << SEQUENCE_BITS) for number in b.batches.supertile[b.visits.batch]]
    assert b.visit_records_from(first)["sequence"].tolist() == wanted


def test_frames_of_other_machines_have_no_batches():
    with pytest.raises(ValueError, match=r"^frame must be one of a machine with super-tiles, not of 'tiles'$"):
        FrameBatches(random_frame(1, TILES))


def misses_one_by_one(chunks: list[int], lines: int) -> int:
    """Headers that are read, by the text: a cache of HEADER_WAYS ways, of which the line that was loaded first is replaced."""
    sets, missed = [[] for _ in range(lines // HEADER_WAYS)], 0
    for chunk in chunks:
        held = sets[chunk % len(sets)]
        if chunk not in held:
            missed += 1
            held.append(chunk)
            del held[:-HEADER_WAYS]
    return missed


@pytest.mark.parametrize("lines", [4, 8, 16])
def test_counts_of_a_frame(frame, lines):
    b = FrameBatches(replace(frame, config=frame.config.with_(header_lines=lines)))
    missed = misses_one_by_one((frame.pairs.index >> 6).tolist(), lines)
    assert b.events == {"pairs": len(frame.pairs.splat), "header_hits": len(frame.pairs.splat) - missed,
                        "header_misses": missed, "batches": len(b.batches.supertile)}
    assert expected_events(frame)["pairs"] == len(frame.pairs.splat)
    assert expected_events(frame)["survivors"] == len(np.unique(frame.pairs.splat))


def test_saturated_colours_count_once_for_each_place():
    """A splat far brighter than colours can be, over several super-tiles and levels."""
    model = splats((0, 0, 2), scale=3.0, colour=(9, 0, 0), levels=4)
    camera = view(300, 90)
    frame = render(model, camera, config=TINY_V3, foveation=map_for(camera, (0.2, 0.6), 4))
    places = FrameBatches(frame).places
    assert len(places.pair) > len(frame.pairs.splat) > 3
    assert expected_events(frame)["saturated_colours"] == len(places.pair)


@pytest.mark.parametrize("count", [0, 1, 4, 31, 32, 33, 100, 1983])
def test_chunks_come_in_runs_of_every_part_by_turns(count):
    """The order that the text of `spec.supertiles` gives, chunk by chunk."""
    part = CHUNK_RUN * -(-count // (CHUNK_RUN * CHUNK_STREAMS))
    expected = [chunk for run in range(0, part, CHUNK_RUN) for begin in range(0, CHUNK_STREAMS * part, part or 1)
                for chunk in range(begin + run, begin + run + CHUNK_RUN) if chunk < count]
    assert supertiles.chunk_order(count).tolist() == expected
    assert sorted(expected) == list(range(count))
