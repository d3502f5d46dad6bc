"""Order of the tile lists, and merging of tiles into groups."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from golden.msv2_ref.projection import VISIBLE
from golden.msv2_ref.sort import depth_order, sort_chunks
from golden.msv2_ref.tile_merge import auto_beta, count_tiles, merge_tiles, tile_groups
from golden.msv2_ref.tile_test import tile_intersections
from golden.scenes.model import GaussianModel
from spec.config import PAPER_SMALL, TINY
from spec.records import chunk_item
from tests.helpers.golden_samples import map_for, random_model, view
from tests.helpers.paper_frames import render

CAMERA = view(150, 100)
DETERMINISTIC = settings(derandomize=True, database=None, deadline=None, max_examples=300)


def layered_model() -> GaussianModel:
    """Splats in 18 planes across the camera's axis: most share their depth with twenty others."""
    model = random_model(np.random.default_rng(5), 400, levels=4)
    return replace(model, means=np.column_stack([model.means[:, :2], np.round(2 * model.means[:, 2]) / 2]))


@pytest.fixture(scope="module", params=[None, (0.3, 0.4)], ids=["plain", "gaze"])
def foveation(request):
    return map_for(CAMERA, request.param, 4)


@pytest.fixture(scope="module")
def frame(foveation):
    return render(layered_model(), CAMERA, foveation=foveation)


def unsorted_stream(frame, order):
    """What the culling unit emits, splats in `order`: (tile, depth key, index, use) of every entry."""
    geometry = frame.words.geometry
    e = tile_intersections(frame.config, frame.projected, geometry["log2_opacity"], geometry["bound"], frame.registers, order)
    tile = np.repeat(np.arange(len(e.start) - 1), np.diff(e.start))
    return tile, frame.projected.depth_key[e.splat], e.splat, e.use


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_lists_are_the_stream_sorted_by_tile_key_and_index(frame, seed):
    """Whatever the order of arrival: equal depths go by index (hard case 36)."""
    rows = np.flatnonzero(frame.projected.reason == VISIBLE).astype(np.int32)
    arrival = rows if seed is None else np.random.default_rng(seed).permutation(rows)
    tile, key, index, use = unsorted_stream(frame, arrival)
    assert len(np.unique(key)) < 20 < len(rows)  # there are ties
    order = np.lexsort((index, key, tile))
    assert np.array_equal(index[order], frame.entries.splat) and np.array_equal(use[order], frame.entries.use)
    assert np.array_equal(np.searchsorted(tile[order], np.arange(len(frame.entries.start))), frame.entries.start)


def test_depth_order_skips_the_culled():
    keys, visible = np.array([5, 1, 5, 0, 1]), np.array([True, True, True, False, True])
    assert depth_order(keys, visible).tolist() == [1, 4, 0, 2]
    assert depth_order(keys, np.zeros(5, bool)).size == 0


frames = st.integers(1, 6).flatmap(lambda tiles_x: st.tuples(
    st.just(tiles_x), st.integers(1, 4).flatmap(lambda rows: st.lists(
        st.one_of(st.just(0), st.integers(0, 4), st.integers(0, 300)), min_size=rows * tiles_x, max_size=rows * tiles_x))))


@DETERMINISTIC
@given(frames, st.one_of(st.integers(0, 9), st.integers(0, 400), st.just(10**9)))
def test_merging_follows_its_rules(frame, beta):
    tiles_x, counts = frame
    groups = merge_tiles(np.array(counts), tiles_x, beta)
    assert len(groups) == len(counts) and groups[0] == 0
    assert set(np.diff(groups).tolist()) <= {0, 1}  # consecutive, and in tile order: no tile is split
    beta = max(beta, 1)
    for group in range(groups[-1] + 1):
        tiles = np.flatnonzero(groups == group).tolist()
        held = [counts[t] for t in tiles]
        assert tiles[0] // tiles_x == tiles[-1] // tiles_x  # the end of a row flushes
        if sum(held) >= beta:  # only a tile that is big by itself brings a group to beta: it is alone but for empty ones
            assert held[-1] >= beta and not any(held[:-1])
        after = tiles[-1] + 1
        if after < len(counts) and after % tiles_x:  # a group that ends inside a row had to
            next_one = counts[after]
            assert sum(held) >= beta or (next_one and sum(held) and sum(held) + next_one >= beta)


@DETERMINISTIC
@given(frames)
def test_extreme_betas(frame):
    tiles_x, counts = frame
    counts = np.array(counts)
    rows = np.arange(len(counts)) // tiles_x
    assert np.array_equal(merge_tiles(counts, tiles_x, 10**12), rows)  # one group a row
    single = merge_tiles(counts, tiles_x, 0)
    assert np.array_equal(single, merge_tiles(counts, tiles_x, 1))
    assert all((counts[single == g] > 0).sum() <= 1 for g in range(single[-1] + 1))


@pytest.mark.parametrize(("counts", "tiles_x", "beta", "groups"), [
    ([3, 3, 3, 3], 4, 7, [0, 0, 1, 1]),  # 6 + 3 would reach 7
    ([3, 4, 3, 4], 4, 7, [0, 1, 2, 3]),  # reaching beta exactly closes, too
    ([9, 0, 1, 0], 4, 7, [0, 1, 1, 1]),  # a big tile at once; then an empty one opens a group
    ([0, 0, 9, 1], 4, 7, [0, 0, 0, 1]),  # empty tiles before a big one are in its group
    ([1, 0, 9, 1], 4, 7, [0, 0, 1, 2]),
    ([1, 1, 1, 1], 2, 100, [0, 0, 1, 1]),
    ([1, 1, 2, 1], 4, 0, [0, 1, 2, 3]), ([1, 1, 0, 1], 4, 1, [0, 1, 2, 2]), ([1, 1, 0, 1], 4, 2, [0, 1, 1, 2]),
    ([0, 0, 0, 0], 2, 5, [0, 0, 1, 1]),
])
def test_merging_by_hand(counts, tiles_x, beta, groups):
    assert merge_tiles(np.array(counts), tiles_x, beta).tolist() == groups


def test_negative_beta_is_refused():
    with pytest.raises(ValueError, match=r"not -1$"):
        merge_tiles(np.zeros(4, int), 2, -1)


def test_automatic_beta_is_twice_the_mean_capped_by_the_buffer():
    assert auto_beta(np.array([0, 10, 0, 30]), PAPER_SMALL) == 40
    assert auto_beta(np.zeros(4, int), PAPER_SMALL) == 1
    assert auto_beta(np.array([10**6]), TINY) == TINY.sort_chunk


@pytest.mark.parametrize("beta", [None, 0, 1, 50, 10**9])
def test_merging_changes_no_pixel(frame, foveation, beta):
    again = render(layered_model(), CAMERA, foveation=foveation, beta=beta)
    assert all(np.array_equal(a, b) for a, b in zip(again.pixels, frame.pixels, strict=True))
    assert np.array_equal(again.entries.splat, frame.entries.splat)
    counts = np.diff(frame.entries.start)
    chosen = auto_beta(counts, PAPER_SMALL) if beta is None else beta
    assert np.array_equal(again.groups, merge_tiles(counts, frame.registers.tiles_x, chosen))


@pytest.mark.parametrize("beta", [None, 30])
def test_counted_and_grouped_records_are_the_frames(frame, beta):
    rows = np.flatnonzero(frame.projected.reason == VISIBLE).astype(np.int32)
    tile, *_ = unsorted_stream(frame, rows)
    counts, saturated, outside = count_tiles(np.random.default_rng(0).permutation(tile), len(frame.groups))
    assert np.array_equal(counts, np.diff(frame.entries.start)) and not saturated and not outside
    groups = tile_groups(PAPER_SMALL, counts, frame.registers.tiles_x, beta)
    assert np.array_equal(groups["count"], counts) and np.array_equal(groups["tile"], np.arange(len(counts)))
    if beta is None:
        assert np.array_equal(groups["group"], frame.groups)
    ends = [np.flatnonzero(groups["group"] == group)[-1] for group in range(groups["group"][-1] + 1)]
    assert np.array_equal(np.flatnonzero(groups["last"]), ends)


def test_counters_saturate_and_leave_out_what_lies_outside():
    hits = np.array([0] * 3 + [1] * 4 + [3])
    for (tiles, bits), expected in {(4, 2): ([3, 3, 0, 1], True, False), (3, 3): ([3, 4, 0], False, True)}.items():
        counts, *flags = count_tiles(hits, tiles, bits)
        assert (counts.tolist(), *flags) == expected
    assert count_tiles(np.empty(0, int), 2)[0].tolist() == [0, 0]


def chunk_items(*chunks):
    rows = [(index, key, tile, i == len(chunk), 0) for chunk in chunks for i, (tile, key, index) in enumerate(chunk, 1)]
    return np.array(rows, chunk_item(TINY).dtype)


def test_chunks_are_sorted_each_by_itself():
    one, two = [(1, 5, 9), (0, 7, 1), (1, 5, 2), (1, 4, 30)], [(0, 0, 0)]
    assert np.array_equal(sort_chunks(chunk_items(one, two, one)), chunk_items(sorted(one), two, sorted(one)))
    empty = np.array([(0, 0, 0, 1, 1)], chunk_item(TINY).dtype)
    items = np.concatenate([empty, chunk_items(one), empty, empty, chunk_items(two), empty])
    assert np.array_equal(sort_chunks(items)[[0, 5, 6, 8]], np.concatenate([empty] * 4))


def test_sorted_groups_behind_each_other_are_the_frames_lists(frame):
    rows = np.flatnonzero(frame.projected.reason == VISIBLE).astype(np.int32)
    tile, key, index, _ = unsorted_stream(frame, rows)
    arrival = np.lexsort((index, frame.groups[tile]))
    items = np.zeros(len(tile), chunk_item(PAPER_SMALL).dtype)
    items["tile"], items["depth_key"], items["index"] = tile[arrival], key[arrival], index[arrival]
    items["last"] = np.append(np.diff(frame.groups[items["tile"]]) > 0, True)
    assert np.array_equal(sort_chunks(items)["index"], frame.entries.splat)
