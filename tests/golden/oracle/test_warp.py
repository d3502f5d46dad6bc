"""The oracle's warp against its definition, read from the target's side: which source pixels could be seen here?"""

from __future__ import annotations

import numpy as np
import pytest

from golden.oracle.warp import BACKGROUND, FILLED, HOLE, WARPED, signed_disparity, warp

SOLID, VEILED, EMPTY = 1.0, 0.3, 0.001
"""Coverages of a pixel with a depth, of one without, of background."""


def seen_at(x: int, row: np.ndarray, coverage: np.ndarray) -> int | None:
    """Column of the source pixel that column x of the target shows, given a row's signed disparities."""
    landing = [s for s in range(len(row)) if np.isfinite(row[s]) and np.floor(s + row[s] + 0.5) == x]
    solid = [s for s in landing if coverage[s] >= 1 / 255]
    if solid:
        nearest = max(abs(row[s]) for s in solid)
        return min(s for s in solid if abs(row[s]) == nearest)
    return min(landing, default=None)


def by_definition(image, depth, coverage, baseline_px, sign, majority):
    """Image, origin and unfilled tiles."""
    height, width = coverage.shape
    moved = signed_disparity(depth, coverage, baseline_px, sign)
    source = np.array([[-1 if (s := seen_at(x, moved[y], coverage[y])) is None else s for x in range(width)]
                       for y in range(height)])
    valid = source >= 0
    out = np.where(valid[..., None], np.take_along_axis(image, np.maximum(source, 0)[..., None], 1), 0.0)
    from_background = np.take_along_axis(coverage, np.maximum(source, 0), 1) < 1 / 255
    origin = np.where(valid, np.where(from_background, BACKGROUND, WARPED), HOLE)
    result = out.copy()
    for y, x in zip(*np.nonzero(~valid), strict=True):
        around = [(y + dy, x + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
        exist = [(r, c) for r, c in around if 0 <= r < height and 0 <= c < width and r // 16 == y // 16]
        around = [at for at in exist if valid[at]]
        if len(around) >= ({8: 5, 5: 3, 3: 2, 2: 2, 1: 1, 0: 1}[len(exist)] if majority else 5):
            colours = np.array([out[at] for at in around])
            result[y, x] = [sorted(channel)[(len(around) - 1) // 2] for channel in colours.T]
            origin[y, x] = FILLED
    tiles = np.array([[(origin[y : y + 16, x : x + 16] == HOLE).any() for x in range(0, width, 16)]
                      for y in range(0, height, 16)])
    return result, origin, tiles


def random_frame(rng, height, width, coverages=(SOLID, VEILED, EMPTY)):
    """Image, depth, coverage: patches of few depths, so that pixels meet and ties occur."""
    depth = rng.choice([0.5, 1.0, 2.0, 4.0, 1e9], (height, -(-width // 4))).repeat(4, 1)[:, :width]
    coverage = rng.choice(coverages, (height, width), p=[0.9, 0.06, 0.04] if len(coverages) == 3 else None)
    return rng.random((height, width, 3)), np.where(coverage >= 0.5, depth, np.nan), coverage


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (17, 5), (33, 37), (16, 16)])
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("majority", [True, False], ids=["majority", "interior"])
def test_the_definition_from_the_targets_side(size, sign, majority):
    for seed in range(4):
        image, depth, coverage = random_frame(np.random.default_rng(seed), *size)
        found = warp(image, depth, coverage, 3.3, sign, majority=majority)
        wanted, origin, tiles = by_definition(image, depth, coverage, 3.3, sign, majority)
        assert np.array_equal(found.origin, origin) and np.array_equal(found.image, wanted)
        assert np.array_equal(found.tiles, tiles)


def test_the_source_pixel_is_named_and_out_of_range_is_dropped():
    image, depth = np.arange(24.0).reshape(1, 8, 3) / 24, np.full((1, 8), 2.0)
    found = warp(image, depth, np.ones((1, 8)), 4.0, -1)  # two columns to the left
    assert found.source_x.tolist() == [[2, 3, 4, 5, 6, 7, -1, -1]]
    assert np.array_equal(found.image[0, :6], image[0, 2:]) and found.tiles.all()
    assert warp(image, depth, np.ones((1, 8)), 1e9, 1).origin.tolist() == [[HOLE] * 8]


def test_zero_depth_and_no_depth_and_infinity():
    image = np.ones((1, 5, 3))
    depth, coverage = np.array([[0.0, 1.0, np.inf, np.nan, np.nan]]), np.array([[1.0, 1.0, 1.0, 0.3, 0.0]])
    found = warp(image, depth, coverage, 0.4, 1, majority=False)
    assert found.origin.tolist() == [[HOLE, WARPED, WARPED, HOLE, BACKGROUND]]  # infinite disparity leaves the frame


def test_veiled_pixels_are_warped_where_that_is_wanted():
    depth, coverage = np.full((1, 6), 2.0), np.array([[VEILED, SOLID, SOLID, VEILED, 0.01, 0.0]])
    assert signed_disparity(depth, coverage, 4.0, 1, True).tolist() == [[2.0, 2.0, 2.0, 2.0, 2.0, 0.0]]
    found = warp(np.ones((1, 6, 3)), depth, coverage, 4.0, -1, veiled=True)
    assert found.source_x.tolist() == [[2, 3, 4, -1, -1, 5]]  # the background stays


def test_fills_feed_no_fills():
    depth = np.full((3, 6), 1.0)
    coverage = np.ones((3, 6))
    coverage[1, 2:5] = VEILED  # three holes in a row: the outer two have six and the inner one six neighbours
    coverage[0, 3] = coverage[2, 3] = VEILED  # now the inner one has four: it stays, whatever is filled beside it
    found = warp(np.ones((3, 6, 3)), depth, coverage, 1e-9, 1)
    assert found.origin[1].tolist() == [WARPED, WARPED, FILLED, HOLE, FILLED, WARPED]
