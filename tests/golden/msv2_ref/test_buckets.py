"""Depth buckets: each rule in plain Python, and frames with none, good, bad and adversarial bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.quantise import quantise_model
from golden.msv2_ref import batches, supertiles
from golden.msv2_ref.buckets import Bounds, check_bounds, list_numbers, next_bounds, no_bounds
from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.tile_merge import tile_groups
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.levels import smfr_levels
from spec.config import TINY_V3, V3
from spec.records import frame_lists
from spec.supertiles import BUCKET_PAIRS, BUCKETS
from tests.helpers.golden_samples import map_for, random_model, view

KEYS = TINY_V3.formats.depth_key
EVERY = 16
"""Pairs between two bounds here, so that small frames have many."""


def random_pairs(rng: np.random.Generator, supertiles: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(start, depth keys in order) of super-tiles with up to `most` pairs, many of equal keys."""
    counts = rng.integers(0, most, supertiles) * (rng.random(supertiles) < 0.8)
    keys = [np.sort(rng.integers(0, rng.choice([3, 100, KEYS.raw_max]), count)) for count in counts]
    return np.concatenate(([0], np.cumsum(counts))), np.concatenate([np.zeros(0, np.int64), *keys])


def bounds_by_the_text(start, keys, lists: int, every: int) -> list[list[int]]:
    """The next frame's bounds of each super-tile, pair by pair as they leave the sorter."""
    supertiles = len(start) - 1
    bounds, left = [], lists - supertiles
    for begin, end in zip(start[:-1].tolist(), start[1:].tolist(), strict=True):
        mine = []
        for number, key in enumerate(keys[begin:end].tolist()):
            if number and number % every == 0 and len(mine) < BUCKETS - 1 and left:
                mine.append(key)
                left -= 1
        bounds.append(mine)
    return bounds


def as_lists(bounds: Bounds) -> list[list[int]]:
    return [bounds.key[bounds.supertile == s].tolist() for s in range(bounds.supertiles)]


@pytest.mark.parametrize("seed", range(20))
def test_the_next_bounds_are_those_of_the_text(seed):
    rng = np.random.default_rng(seed)
    start, keys = random_pairs(rng, int(rng.integers(1, 30)), 400)
    config = TINY_V3.with_(list_heads=int(rng.choice([30, 64, 128])))
    every = int(rng.choice([1, 5, EVERY, 2048]))
    bounds = next_bounds(config, start, keys, every)
    assert as_lists(bounds) == bounds_by_the_text(start, keys, frame_lists(config), every)
    check_bounds(config, bounds, len(start) - 1)


def test_the_first_key_is_never_a_bound():
    keys = np.arange(5000)
    n = BUCKET_PAIRS
    for count, wanted in ((0, []), (1, []), (n, []), (n + 1, [n]), (2 * n, [n]), (2 * n + 1, [n, 2 * n])):
        assert as_lists(next_bounds(V3, np.array([0, count]), keys[:count])) == [wanted]
    many = np.arange((BUCKETS + 8) * BUCKET_PAIRS)
    assert as_lists(next_bounds(V3, np.array([0, len(many)]), many)) == [[BUCKET_PAIRS * n for n in range(1, BUCKETS)]]


def test_machines_without_buckets_make_no_bounds():
    config = TINY_V3.with_(buckets=False)
    assert next_bounds(config, np.array([0, 100]), np.arange(100), 10).lists == 1
    with pytest.raises(ValueError, match=r"^bounds must be none in a machine without buckets, not 1$"):
        check_bounds(config, Bounds(1, np.array([0]), np.array([5])), 1)


@pytest.mark.parametrize(("supertile", "key", "message"), [
    ([0] * BUCKETS, [1] * BUCKETS, f"at most {BUCKETS - 1} for each"),
    ([2], [1], f"at most {BUCKETS - 1} for each"), ([1, 0], [1, 1], "must not decrease"),
    ([0, 0], [5, 4], "must not decrease"),
    ([0] * (BUCKETS - 1) + [1] * 12, [1] * (BUCKETS + 11), "must leave at most 44 lists, not 45"),
])
def test_bounds_that_no_machine_has_are_refused(supertile, key, message):
    config = TINY_V3.with_(list_heads=BUCKETS + 12)
    with pytest.raises(ValueError, match=message):
        check_bounds(config, Bounds(2, np.array(supertile), np.array(key)), 2)


def test_bounds_of_another_frame_size_are_refused():
    with pytest.raises(ValueError, match=r"^bounds must be those of 2 super-tiles, not of 3$"):
        render(random_model(np.random.default_rng(0), 9), view(200, 20), config=TINY_V3, bounds=no_bounds(3))


@pytest.mark.parametrize("seed", range(20))
def test_lists_are_those_of_the_text(seed):
    rng = np.random.default_rng(seed)
    count, high = int(rng.integers(1, 12)), int(rng.choice([4, 1000, KEYS.raw_max + 1]))
    sizes = rng.integers(0, BUCKETS, count)
    keys = [np.sort(rng.integers(0, high, size)) for size in sizes]
    bounds = Bounds(count, np.repeat(np.arange(count), sizes), np.concatenate([np.zeros(0, np.int64), *keys]))
    supertile, depth_key = rng.integers(0, count, 500), rng.integers(0, high, 500)
    first = [s + int(sizes[:s].sum()) for s in range(count + 1)]
    assert bounds.first.tolist() == first and bounds.lists == first[-1]
    wanted = [first[s] + sum(b <= k for b in keys[s].tolist())
              for s, k in zip(supertile.tolist(), depth_key.tolist(), strict=True)]
    assert list_numbers(bounds, supertile, depth_key).tolist() == wanted


def all_bounds(frame: Frame) -> dict[str, Bounds]:
    """Bounds of every kind for a frame: good ones, those of noise, and some that no frame would leave."""
    rng, supertiles, most = np.random.default_rng(3), len(frame.pairs.start) - 1, KEYS.raw_max
    per = min(BUCKETS - 1, (frame_lists(frame.config) - supertiles) // supertiles)
    where = np.repeat(np.arange(supertiles), per)
    held = frame.pairs.depth_key[rng.integers(0, len(frame.pairs.depth_key), len(where))]
    uneven = np.sort(rng.integers(0, supertiles, len(where)))
    uneven = uneven[np.arange(len(uneven)) - np.searchsorted(uneven, uneven) < BUCKETS - 1]
    kinds = {
        "good": next_bounds(frame.config, frame.pairs.start, frame.pairs.depth_key, EVERY),
        "noise": Bounds(supertiles, where, np.sort(rng.integers(0, most + 1, (supertiles, per)), axis=1).reshape(-1)),
        "uneven": Bounds(supertiles, uneven, np.sort(rng.integers(0, most + 1, len(uneven)))),
        "equal to keys": Bounds(supertiles, where, np.sort(held.reshape(supertiles, per), axis=1).reshape(-1)),
        "all at one key": Bounds(supertiles, where, np.full(len(where), int(np.median(frame.pairs.depth_key)))),
        "all 0": Bounds(supertiles, where, np.zeros(len(where), np.int64)),
        "beyond all keys": Bounds(supertiles, where, np.full(len(where), most)),
    }
    return {"none": no_bounds(supertiles)} | kinds


@pytest.mark.parametrize("beta", [None, 0, 1 << 20])
def test_bounds_change_the_order_of_nothing(beta):
    """What leaves the sorter, list by list and group by group, is the same sequence whatever the bounds are: and so are
    batches, visits and pixels."""
    camera = embedded_cameras(240, 136)[2]
    words = quantise_model(TINY_V3, smfr_levels(cached_embedded_model()))
    options = {"config": TINY_V3, "foveation": map_for(camera, (0.4, 0.6), 4), "beta": beta}
    frame = render(words, camera, **options)
    wanted, grouped = frame.pairs, set()
    for name, bounds in all_bounds(frame).items():
        again = render(words, camera, bounds=bounds, **options)
        binned = supertiles.binned_pairs(frame.config, again.pairs)[:-1]
        lists = list_numbers(bounds, binned["supertile"], binned["depth_key"])
        groups = supertiles.list_groups(frame.config, again.pairs, bounds, beta)
        assert np.array_equal(np.bincount(lists, minlength=bounds.lists), groups["count"]), name
        group = groups["group"][lists]
        order = np.lexsort((binned["index"], binned["depth_key"], lists, group))  # group by group, as the sorter does
        for got, by in ((binned["index"], wanted.index), (binned["depth_key"], wanted.depth_key),
                        (binned["supertile"], wanted.supertile)):
            assert np.array_equal(got[order], by), name
        assert np.array_equal(np.cumsum(groups["ends"])[lists[order]] - groups["ends"][lists[order]], wanted.supertile), name
        rows = supertiles.sorted_pairs(frame.config, again.pairs, bounds)
        assert np.array_equal(rows["tile"], lists[order]) and np.array_equal(rows["index"], wanted.index)
        for part, of in zip(again.pixels, frame.pixels, strict=True):
            assert np.array_equal(part, of), name
        assert np.array_equal(batches.FrameBatches(again).visit_records, batches.FrameBatches(frame).visit_records), name
        grouped.add(tuple(again.groups.tolist()))
    assert len(grouped) > 3 or beta == 1 << 20  # the bounds did change lists and groups


def test_lists_of_a_super_tile_follow_each_other_and_the_last_one_ends_it():
    frame = render(random_model(np.random.default_rng(1), 600), view(128, 64), config=TINY_V3)
    bounds = all_bounds(frame)["good"]
    groups = supertiles.list_groups(frame.config, frame.pairs, bounds, 1)
    assert np.array_equal(np.flatnonzero(groups["ends"]), bounds.first[1:] - 1)
    totals = np.add.reduceat(groups["count"], bounds.first[:-1])
    assert np.array_equal(totals, np.diff(frame.pairs.start)) and bounds.lists > bounds.supertiles
    tiles = tile_groups(frame.config, groups["count"], bounds.lists, 1)  # as tiles of one row
    assert all(np.array_equal(tiles[name], groups[name]) for name in tiles.dtype.names)


def test_good_bounds_leave_lists_of_about_equal_length():
    """But for pairs of equal keys, and the last list, which has what is left."""
    frame = render(random_model(np.random.default_rng(1), 1500), view(128, 64), config=TINY_V3)
    bounds = next_bounds(frame.config, frame.pairs.start, frame.pairs.depth_key, 64)
    counts = supertiles.list_counts(frame.pairs, bounds)
    assert np.bincount(bounds.supertile).max() > 5 and counts.max() <= 2 * 64 < np.diff(frame.pairs.start).max()


def test_a_frame_follows_another(monkeypatch):
    """It has the bounds of the frame before, unless that had another number of super-tiles."""
    monkeypatch.setattr(batches, "next_bounds", lambda config, start, key: next_bounds(config, start, key, EVERY))
    words = quantise_model(TINY_V3, random_model(np.random.default_rng(1), 600))
    camera = view(128, 64)
    first, second = (render(words, c, config=TINY_V3) for c in (camera, replace(camera, fx=45.0)))
    after = batches.following(second, first, None)
    bounds = next_bounds(TINY_V3, first.pairs.start, first.pairs.depth_key, EVERY)
    wanted = render(words, replace(camera, fx=45.0), config=TINY_V3, bounds=bounds)
    assert len(after.bounds.key) > 5 and np.array_equal(after.bounds.key, wanted.bounds.key)
    assert np.array_equal(after.groups, wanted.groups) and len(after.groups) > len(second.groups)
    other = render(words, view(300, 64), config=TINY_V3)
    assert batches.following(other, first, None).bounds.lists == len(other.pairs.start) - 1
    assert batches.following(second, after, None).bounds.lists == second.bounds.lists + len(
        next_bounds(TINY_V3, second.pairs.start, second.pairs.depth_key, EVERY).key)
