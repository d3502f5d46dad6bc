"""The GSCore-like machine: its lists, its subtiles, its pipeline."""

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.msv2_ref.projection import VISIBLE
from perf import gscore
from spec.config import PAPER_SMALL
from spec.constants import ALPHA_MAX_L1, EXPONENT_SCALE, SUPPORT_SIGMA, TILE
from tests.helpers.golden_samples import map_for, random_model, view


@pytest.fixture(scope="module")
def frame():
    camera = view(70, 50)
    return pipeline.render(random_model(np.random.default_rng(3), 300), camera, config=PAPER_SMALL)


@pytest.fixture(scope="module")
def trace(frame):
    return gscore.gscore_trace(frame)


def boxes(frame):
    n = frame.config.formats
    mean, conic = n.mean2d.to_float(frame.projected.mean2d), np.ascontiguousarray(frame.projected.conic)
    return mean, conic, *gscore._boxes(frame, mean, conic)


def test_boxes_are_those_of_the_ellipse(frame):
    _, conic, shape, _ = boxes(frame)
    angle = np.linspace(0, 2 * np.pi, 100)
    for i in np.flatnonzero(frame.projected.reason == VISIBLE)[:50]:
        axis, across = shape[i, 2:4], np.array([-shape[i, 3], shape[i, 2]])
        rim = np.outer(np.cos(angle), axis) * shape[i, 4] + np.outer(np.sin(angle), across) * shape[i, 5]
        u = conic[i, 0] * rim[:, 0] + conic[i, 1] * rim[:, 1]
        assert np.hypot(u, conic[i, 2] * rim[:, 1]) / EXPONENT_SCALE == pytest.approx(SUPPORT_SIGMA, rel=1e-6)


def test_lists_hold_at_least_what_an_exact_test_finds(frame, trace):
    exact = np.diff(frame.entries.start)
    assert (trace.entries >= exact).all() and trace.entries.sum() > exact.sum() > 0
    assert (trace.subtiles <= 4 * trace.entries).all() and 0 < trace.subtiles.sum() < 3 * trace.entries.sum()


def test_light_is_that_of_the_renderer(frame):
    mean, conic, shape, _ = boxes(frame)
    r = frame.registers
    opacity = 2.0 ** frame.config.formats.log2_opacity.to_float(frame.words.geometry["log2_opacity"])[:, 0]
    light = np.empty((TILE, TILE))
    golden = frame.config.formats.transmittance.to_float(frame.pixels.transmittance)
    for tile in range(len(r.header)):
        mine = frame.entries.splat[frame.entries.start[tile] : frame.entries.start[tile + 1]].astype(np.int64)
        x, y = tile % r.tiles_x, tile // r.tiles_x
        gscore._subtiles(mine, x, y, r.width, r.height, mean, conic, opacity, ALPHA_MAX_L1, shape, light)
        inside = np.s_[: min(TILE, r.height - TILE * y), : min(TILE, r.width - TILE * x)]
        rim = np.exp(-(SUPPORT_SIGMA**2) / 2)  # what the renderer leaves out of a splat beyond its support, and this does not
        assert np.abs(light[inside] - golden[tile][inside]).max() < 2 * rim


def test_subtiles_that_have_stopped_cost_nothing(frame):
    mean, conic, shape, _ = boxes(frame)
    i = int(np.argmax(np.where(frame.projected.reason == VISIBLE, shape[:, 5], 0)))
    tile_x, tile_y = (int(v) for v in mean[i] // TILE)
    wall, opaque, light = np.full(50, i), np.full(len(mean), 128.0), np.empty((TILE, TILE))
    one = gscore._subtiles(wall[:1], tile_x, tile_y, 1000, 1000, mean, conic, opaque, ALPHA_MAX_L1, shape, light)
    many = gscore._subtiles(wall, tile_x, tile_y, 1000, 1000, mean, conic, opaque, ALPHA_MAX_L1, shape, light)
    assert one == 4 and many < 50 * one / 2


def test_foveated_frames_render_both_levels_of_a_blending_tile():
    camera = view(70, 50)
    model = random_model(np.random.default_rng(4), 200, levels=4)
    frame = pipeline.render(model, camera, config=PAPER_SMALL, foveation=map_for(camera, (0.1, 0.2), 4))
    blend = frame.registers.header[:, 1]
    assert 0 < blend.sum() < len(blend) and len(gscore.gscore_trace(frame).entries) == len(blend) + blend.sum()


def test_cycles(trace):
    published = gscore.gscore_cycles(trace)
    assert published.total == published.geometry + published.render
    fast = gscore.gscore_cycles(trace, gscore.GscoreConfig(bytes_per_cycle=1e9))
    least = [trace.subtiles.sum(), trace.entries.sum() / 2]
    assert max(least) <= fast.render <= sum(least) + 1 and fast.geometry == round(trace.points * 2)
    assert gscore.gscore_cycles(trace, gscore.GscoreConfig().scaled(2)).total <= published.total
    slow = gscore.gscore_cycles(trace, gscore.GscoreConfig(bytes_per_cycle=0.1))
    assert slow.total >= slow.dram_bytes / 0.1 * 0.99
    with pytest.raises(ValueError, match="factor must be positive, not 0"):
        gscore.GscoreConfig().scaled(0)
