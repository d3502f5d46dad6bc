"""The tile test: no tile is missed in which a pixel would change, and neither test changes a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import array
from golden.msv2_ref.colour import splat_colours
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import OUTSIDE, VISIBLE
from golden.msv2_ref.sort import depth_order
from golden.msv2_ref.tile_test import tile_test
from spec import tables
from spec.config import PAPER, PAPER_SMALL, AcceleratorConfig
from spec.constants import TILE
from spec.records import projected_splat
from tb.culling.tile_test_stimuli import SHAPES, random_splats, splats_of, whole_frame
from tests.helpers.golden_samples import map_for, random_model, splats, turned_view, view
from tests.helpers.paper_frames import render

SIZES = [(64, 48), (100, 37), (17, 33), (1, 1), (16, 1), (250, 5)]


def with_every_pair(frame: Frame) -> Frame:
    """The frame rendered again with every splat that any level uses in every tile, those off the frame too."""
    drawable = np.isin(frame.projected.reason, (VISIBLE, OUTSIDE))
    order = depth_order(frame.projected.depth_key, drawable)
    colour = frame.splats.colour.copy()
    colour[order] = splat_colours(frame.config, frame.words, frame.registers, order)
    bound = frame.words.geometry["bound"][order]
    order_of, use_of = [], []
    for level, blend, _ in frame.registers.header:
        use = (bound >= level) + 2 * ((bound > level) & (blend == 1))
        order_of.append(order[use > 0])
        use_of.append(use[use > 0].astype(np.uint8))
    tile_y, tile_x = np.divmod(np.arange(len(order_of)), frame.registers.tiles_x)
    work = array.TileWork(
        np.column_stack([tile_x, tile_y, frame.registers.header[:, [0, 2, 1]]]), frame.registers.plane,
        np.concatenate([[0], np.cumsum([len(o) for o in order_of])]), np.concatenate(order_of), np.concatenate(use_of))
    pixels = array.render(frame.config, frame.splats._replace(colour=colour), work, frame.registers.background)
    return replace(frame, pixels=pixels)


def assert_same_picture(a: Frame, b: Frame) -> None:
    """Equal in every pixel of the frame; pixels beyond its edges, which exist in the last tiles, do not matter."""
    assert np.array_equal(a.image, b.image)
    assert np.array_equal(a.transmittance, b.transmittance)
    assert np.array_equal(a.depth, b.depth, equal_nan=True)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", SIZES)
def test_no_tile_is_missed(size, seed):
    camera = turned_view(*size)
    model = random_model(np.random.default_rng(seed), 300, levels=4, wild=seed % 2 == 0)
    frame = render(model, camera, foveation=map_for(camera, None if seed < 1 else (0.2, 0.7), 4))
    assert (frame.projected.reason == OUTSIDE).any()
    assert_same_picture(frame, with_every_pair(frame))


@pytest.mark.parametrize("seed", range(8))
def test_no_tile_is_missed_by_needles_giants_and_centres_outside(seed):
    """Footprints that graze tiles: long needles at every angle, wide splats whose centres lie off the frame, dots at edges."""
    rng = np.random.default_rng(seed)
    n = 400
    camera = view(90, 70)
    means = np.column_stack([rng.uniform(-4, 4, (n, 2)), rng.uniform(0.5, 4, n)])
    kinds = np.array([(1.0, 1e-4, 1e-4), (3.0, 0.05, 0.05), (2.0, 2.0, 1e-3), (1e-4, 1e-4, 1e-4)])[rng.integers(0, 4, n)]
    model = splats(*means, scale=kinds * rng.uniform(0.3, 3, (n, 1)), opacity=2 ** rng.uniform(-8, 7, n), levels=2,
                   colour=rng.uniform(0, 1, (n, 3)))
    model = replace(model, quats=rng.normal(size=(n, 4)), quality_bound=rng.integers(1, 3, n).astype(np.uint8))
    frame = render(model, camera, foveation=map_for(camera, (rng.random(), rng.random()), 2))
    assert_same_picture(frame, with_every_pair(frame))


@pytest.mark.parametrize("support_sigma", [None, 1.0, 5.0])
def test_no_tile_is_missed_at_other_supports(support_sigma):
    camera = turned_view(100, 60)
    model = random_model(np.random.default_rng(3), 300, levels=2, wild=True)
    config = PAPER_SMALL.with_(support_sigma=support_sigma)
    frame = render(model, camera, config=config, foveation=map_for(camera, (0.5, 0.5), 2))
    assert_same_picture(frame, with_every_pair(frame))


def test_every_pair_would_show_a_missed_tile():
    """The comparison above can fail: without the entries of one tile the picture differs."""
    frame = render(random_model(np.random.default_rng(0), 300), turned_view(64, 48))
    start = frame.entries.start
    crowded = int(np.argmax(np.diff(start)))
    keep = np.r_[0 : start[crowded], start[crowded + 1] : start[-1]]
    shorter = start - (np.arange(len(start)) > crowded) * (start[crowded + 1] - start[crowded])
    tile_y, tile_x = np.divmod(np.arange(len(start) - 1), frame.registers.tiles_x)
    work = array.TileWork(
        np.column_stack([tile_x, tile_y, frame.registers.header[:, [0, 2, 1]]]), frame.registers.plane, shorter,
        frame.entries.splat[keep], frame.entries.use[keep])
    broken = replace(frame, pixels=array.render(frame.config, frame.splats, work, frame.registers.background))
    assert not np.array_equal(broken.image, with_every_pair(frame).image)


@pytest.mark.parametrize("gaze", [None, (0.4, 0.6)])
def test_boxes_give_the_same_picture_and_longer_lists(gaze):
    camera = turned_view(100, 70)
    model = random_model(np.random.default_rng(9), 500, levels=4, wild=True)
    exact, box = (render(model, camera, foveation=map_for(camera, gaze, 4), obb=obb) for obb in (False, True))
    assert_same_picture(exact, box)
    counts, box_counts = np.diff(exact.entries.start), np.diff(box.entries.start)
    assert (box_counts >= counts).all() and box_counts.sum() > counts.sum()


def test_lists_hold_no_splat_twice_and_only_what_the_levels_use():
    camera = turned_view(130, 90)
    frame = render(random_model(np.random.default_rng(4), 600, levels=4), camera, foveation=map_for(camera, (0.3, 0.3), 4))
    level, blend, _ = np.repeat(frame.registers.header, np.diff(frame.entries.start), axis=0).T
    bound = frame.words.geometry["bound"][frame.entries.splat]
    assert (bound >= level).all() and frame.entries.filtered > 0
    assert np.array_equal(frame.entries.use, np.where((blend == 1) & (bound > level), 3, 1))
    for a, b in zip(frame.entries.start[:-1], frame.entries.start[1:], strict=True):
        assert len(set(frame.entries.splat[a:b])) == b - a


def test_exact_lists_are_hardly_longer_than_the_oracles():
    """The margins of the integer test cost next to nothing: under 2 % more entries than exact float64 tests list."""
    from golden.oracle.render import render as oracle

    camera, model = turned_view(160, 120), random_model(np.random.default_rng(6), 800)
    ours, exact = render(model, camera), oracle(model, camera)
    assert len(ours.entries.splat) == pytest.approx(exact.entries, rel=0.02)


def touched_exactly(config: AcceleratorConfig, splats: np.ndarray, width: int, height: int) -> set[tuple[int, int]]:
    """(splat, tile) pairs with a pixel centre on or inside the splat's ellipse, in float64 without margins; one level."""
    n, found, columns = config.formats, set(), -(-width // TILE)
    support = tables.support_exponent(config)
    limit = np.minimum(splats["log2_opacity"][:, 0] - tables.log2_alpha_min(n), np.inf if support is None else support)
    mean, conic = splats["mean2d"] / 2.0**n.mean2d.frac_bits, n.conic.to_float(splats["conic"])
    y = np.arange(height) + 0.5
    for i in np.flatnonzero(limit >= 0):
        dy, (l1, l2, l3) = y - mean[i, 1], conic[i]
        square = limit[i] / 2.0**n.cut.frac_bits - (l3 * dy) ** 2
        half = np.sqrt(np.maximum(square, 0))
        first = np.maximum(np.ceil(mean[i, 0] - (l2 * dy + half) / l1 - 0.5), 0)
        last = np.minimum(np.floor(mean[i, 0] - (l2 * dy - half) / l1 - 0.5), width - 1)
        for row in np.flatnonzero((square >= 0) & (first <= last)):
            tile = row // TILE * columns
            found |= {(i, tile + column) for column in range(int(first[row]) // TILE, int(last[row]) // TILE + 1)}
    return found


def pairs_of(config: AcceleratorConfig, splats: np.ndarray, width: int, height: int) -> set[tuple[int, int]]:
    """What the tile test gives, all tiles at one level."""
    levels = np.zeros((-(-width // TILE) * -(-height // TILE), 2), np.int64)
    entries = tile_test(config, splats, levels, width, height).entries[:-1]
    return set(zip(np.searchsorted(splats["index"], entries["index"]).tolist(), entries["tile"].tolist(), strict=True))


@pytest.mark.parametrize("size", [(640, 200), (1920, 70), (60, 1900), (4096, 40), (33, 17)])
@pytest.mark.parametrize("shape", SHAPES)
def test_no_pixel_inside_an_ellipse_is_missed(shape, size):
    """Footprints of every shape, centres up to 16,384 pixels off, frames up to 4,096 wide: every row, every column."""
    config, rng = PAPER.with_(row_width=4096), np.random.default_rng(size[0])
    splats = whole_frame(random_splats(config, rng, 150, *size, shape), *size)
    exact, ours = touched_exactly(config, splats, *size), pairs_of(config, splats, *size)
    assert exact - ours == set()
    assert len(ours) <= 1.1 * len(exact) + 10  # dots, whose margins show, are most of the difference


def test_the_comparison_with_exact_ellipses_can_fail():
    size, rng = (640, 200), np.random.default_rng(0)
    splats = whole_frame(random_splats(PAPER, rng, 150, *size, "needles"), *size)
    smaller = splats.copy()
    smaller["log2_opacity"][:, 0] -= 100  # of 1,024
    assert touched_exactly(PAPER, splats, *size) - pairs_of(PAPER, smaller, *size)


@pytest.mark.parametrize("obb", [False, True])
def test_the_units_streams_are_the_frames_entries(obb):
    camera = turned_view(130, 90)
    model = random_model(np.random.default_rng(4), 600, levels=4)
    frame = render(model, camera, foveation=map_for(camera, (0.3, 0.3), 4), obb=obb)
    splats, (level, blend, _) = splats_of(frame), frame.registers.header.T
    found = tile_test(frame.config, splats, np.stack([level, blend], 1), camera.width, camera.height, obb=obb)
    tile = np.repeat(np.arange(len(level)), np.diff(frame.entries.start))
    order = np.lexsort((tile, frame.entries.splat))
    entries, survivors = found.entries[:-1], found.survivors[:-1]
    assert np.array_equal(entries["tile"], tile[order]) and np.array_equal(entries["index"], frame.entries.splat[order])
    assert np.array_equal(entries["depth_key"], frame.projected.depth_key[entries["index"]])
    assert (found.touched, found.filtered) == (len(tile) + frame.entries.filtered, frame.entries.filtered)
    assert np.array_equal(survivors["index"], np.unique(frame.entries.splat))
    levels = [{*level[tile[frame.entries.splat == i]].tolist()} for i in survivors["index"]]
    assert survivors["levels"].tolist() == [sum(1 << k for k in each) for each in levels]
    assert np.array_equal(survivors["mean2d"], frame.projected.mean2d[survivors["index"]])
    ends = found.entries["end"], found.survivors["end"]
    assert all(end[-1] == 1 and end[:-1].sum() == 0 for end in ends)


def test_a_splat_is_tested_at_the_stronger_of_a_blend_tiles_levels_if_both_use_it():
    config, splats = PAPER_SMALL, np.zeros(3, projected_splat(PAPER_SMALL).dtype)
    splats["index"], splats["bound"], splats["mean2d"] = range(3), (0, 1, 1), 8 << config.formats.mean2d.frac_bits
    splats["conic"] = config.formats.conic.quantise(np.array([0.2, 0, 0.2]))
    faint, strong = tables.log2_alpha_min(config.formats) - 1, 0
    splats["log2_opacity"] = [[faint, strong, faint, faint]] * 2 + [[faint] * 4]
    for blend, passing in ((0, []), (1, [1])):
        found = tile_test(config, splats, np.array([[0, blend]]), 16, 16)
        assert found.entries["index"][:-1].tolist() == passing == found.survivors["index"][:-1].tolist()
        assert found.touched == len(passing) and found.filtered == 0
