"""Quantisation, registers, projection and colour of the integer renderer, each stage against float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.quantise import quantise_model
from golden.host.registers import depth_far, frame_registers
from golden.msv2_ref.projection import VISIBLE, culling_constants, projected_splats
from golden.oracle.harmonics import colour_per_level
from golden.oracle.project import project
from golden.scenes.gaze import Display, no_foveation
from spec.config import PAPER_SMALL
from spec.constants import EXPONENT_SCALE, FRUSTUM_MARGIN, LOW_PASS
from tests.helpers.golden_samples import SH_C0, map_for, random_model, splats, turned_view, view
from tests.helpers.paper_frames import render

N = PAPER_SMALL.formats


@pytest.fixture(scope="module", params=[False, True], ids=["tame", "wild"])
def scene(request):
    """(model, camera, frame, the oracle's splats, their rows in the frame) of what both see."""
    model = random_model(np.random.default_rng(21), 2000, levels=4, sh=3, wild=request.param)
    camera = turned_view(320, 240)
    frame = render(model, camera)
    exact, _ = project(model, camera, PAPER_SMALL.support_sigma)
    both = frame.projected.reason[exact.index] == VISIBLE
    assert both.mean() > 0.99
    exact = type(exact)(**{name: values[both] for name, values in vars(exact).items()})
    return model, camera, frame, exact, exact.index


def test_words_hold_the_model_to_half_an_ulp():
    model = random_model(np.random.default_rng(1), 300, levels=3, sh=2)
    words = quantise_model(PAPER_SMALL, model)
    g, colour = words.geometry, words.colour
    assert np.array_equal(words.origin, np.median(model.means, axis=0))
    relative = model.means - words.origin
    assert (np.abs(N.position.to_float(g["mean"]) - relative) <= np.abs(relative) * 2.0**-N.position.sig_bits).all()
    scale = np.exp(model.log_scales)
    assert (np.abs(N.scale.to_float(g["scale"]) - scale) <= scale * 2.0**-N.scale.sig_bits).all()
    unit = model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)
    assert np.abs(N.quaternion.to_float(g["quat"]) - unit).max() <= 2.0 ** -(N.quaternion.frac_bits + 1)
    log2 = np.log2(np.maximum(model.opacity, 2.0**-16))
    got = N.log2_opacity.to_float(g["log2_opacity"])
    assert np.abs(got[:, :3] - log2).max() <= 2.0 ** -(N.log2_opacity.frac_bits + 1)
    assert np.array_equal(got[:, 3], got[:, 2]) and np.array_equal(g["bound"], model.quality_bound - 1)
    dc = N.sh_dc.to_float(colour["dc"]).reshape(-1, 4, 3)
    assert np.abs(dc[:, :3] - (SH_C0 * model.sh_dc + 0.5))[np.abs(dc[:, :3]) < 3.9].max() <= 2.0 ** -(N.sh_dc.frac_bits + 1)
    rest = N.sh_rest.to_float(colour["rest"]).reshape(-1, 8, 3)
    assert np.abs(rest - model.sh_rest).max() <= 2.0 ** -(N.sh_rest.frac_bits + 1)


@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest"])
def test_nan_never_gets_into_the_words(field):
    """Loaders drop such points (hard cases 21, 22); a model made by hand is refused."""
    model = random_model(np.random.default_rng(1), 5, sh=1)
    values = getattr(model, field).copy()
    values.flat[3] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        quantise_model(PAPER_SMALL, replace(model, **{field: values}))


def test_registers_are_the_camera_rounded():
    camera, model = turned_view(200, 100), random_model(np.random.default_rng(2), 100, levels=4)
    words, foveation = quantise_model(PAPER_SMALL, model), map_for(turned_view(200, 100), (0.4, 0.4), 4)
    r = frame_registers(PAPER_SMALL, camera, words, foveation, (0.1, 0.5, 1.0))
    half = 2.0**-N.view.sig_bits
    in_pixels = camera.rotation * np.array([[160], [180], [1]])
    assert r.rotation == pytest.approx(in_pixels, rel=half, abs=0)
    assert r.turn == pytest.approx(in_pixels / EXPONENT_SCALE, rel=2.0**-N.work.sig_bits, abs=0)
    assert r.position + words.origin == pytest.approx(camera.position, abs=1e-6)
    assert N.mean2d.to_float(r.centre) == pytest.approx((110, 40), abs=2.0**-11)
    edges = -110, 200 - 110, -40, 100 - 40
    assert r.limits == pytest.approx(np.multiply(FRUSTUM_MARGIN, edges), rel=half)
    assert (r.tiles_x, r.tiles_y) == (13, 7) and len(r.header) == 91
    assert np.array_equal(r.header[:, 0].reshape(7, 13), foveation.tile_level)
    assert np.array_equal(r.header[:, 1].reshape(7, 13), foveation.blend)
    assert np.array_equal(r.header[:, 2] == 0, r.header[:, 0] == 0)
    assert np.abs(N.plane.to_float(r.plane) - foveation.plane.reshape(-1, 3)).max() <= 2.0 ** -(N.plane.frac_bits + 1)
    assert N.colour.to_float(r.background) == pytest.approx((0.1, 0.5, 1.0), abs=2.0**-10)


def test_depth_scale_covers_what_is_seen_but_no_outlier():
    camera = view(64, 48)
    seen = np.column_stack([np.zeros((500, 2)), np.linspace(1, 20, 500)])
    assert depth_far(seen, np.zeros(3), camera) == 20
    behind_or_beside = np.array([[0, 0, -50.0], [500, 0, 100]])
    assert depth_far(np.concatenate([seen, behind_or_beside]), np.zeros(3), camera) == 20
    assert 70 < depth_far(np.concatenate([seen, [[0, 0, 1e6]]]), np.zeros(3), camera) < 90  # four times the 99th percentile
    assert depth_far(seen - [0, 0, 5], np.array([0.0, 0, 5]), camera) == pytest.approx(20)
    assert depth_far(np.zeros((0, 3)), np.zeros(3), camera) > camera.near


def test_means_are_within_a_hundredth_of_a_pixel(scene):
    _, camera, frame, exact, rows = scene
    error = np.abs(N.mean2d.to_float(frame.projected.mean2d[rows]) - exact.mean2d)
    near = (np.abs(exact.mean2d - 160) < 400).all(axis=1)
    assert near.sum() > 100 and error[near].max() < 0.01 and np.median(error) < 0.001
    assert camera.width == frame.registers.width


def test_conics_are_the_covariances_inverse(scene):
    """Relative errors: the memory's 12 bits of scale and 13 of rotation dominate; they weigh most in the thinnest ellipses."""
    _, _, frame, exact, rows = scene
    got, expected = frame.projected.conic[rows], EXPONENT_SCALE * exact.factor
    error = np.abs(got - expected)[:, [0, 2]] / expected[:, [0, 2]]
    assert (np.median(error, axis=0) < 3e-4).all() and (np.percentile(error, 99, axis=0) < 5e-3).all()
    assert (got[:, [0, 2]] > 0).all() and got.max() <= EXPONENT_SCALE / np.sqrt(LOW_PASS) * (1 + 1e-4)


def test_boxes_hold_every_list(scene):
    _, _, frame, _, _ = scene
    e, tiles_x = frame.entries, frame.registers.tiles_x
    y, x = np.divmod(np.repeat(np.arange(len(e.start) - 1), np.diff(e.start)), tiles_x)
    x0, x1, y0, y1 = frame.projected.box[e.splat].T
    assert ((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)).all()


def test_boxes_hold_the_ellipse_and_little_more(scene):
    """The tiles of pixel centres that the factors' own ellipse reaches, from its exact extents; a pixel and 1 % more."""
    _, _, frame, _, _ = scene
    p, k, r = frame.projected, culling_constants(PAPER_SMALL), frame.registers
    rows = np.flatnonzero(p.reason == VISIBLE)
    l1, l2, l3 = p.conic[rows].T
    limit = np.minimum(frame.words.decoded.opacity[rows] - k.faintest, k.widest) * k.cut_ulp
    reach = np.sqrt(limit)[:, None] * np.stack([np.hypot(1 / l1, l2 / (l1 * l3)), 1 / l3], axis=1)
    mean, size = N.mean2d.to_float(p.mean2d[rows]), np.array([r.width, r.height])
    for reached, holds in ((reach, True), (reach * 1.01 + 1 + np.sqrt(2.0**-5) * reach / np.sqrt(limit)[:, None], False)):
        first = np.clip(np.ceil(mean - reached - 0.5), 0, size) // 16
        last = np.clip(np.floor(mean + reached - 0.5), -1, size - 1) // 16
        some = (first <= last).all(axis=1)
        inner, outer = (p.box[rows][:, [0, 2]] <= first), (p.box[rows][:, [1, 3]] >= last)
        if holds:
            assert some.sum() > 100 and inner[some].all() and outer[some].all()
        else:
            assert (p.box[rows][:, [0, 2]] >= first).all() and (p.box[rows][:, [1, 3]] <= last).all()


def test_depths_and_keys(scene):
    model, camera, frame, exact, rows = scene
    far = frame.registers.depth_far
    depth = N.depth.to_float(frame.projected.depth[rows])
    expected = np.minimum(exact.depth / far, N.depth.to_float(N.depth.raw_max))
    assert np.abs(depth - expected).max() < 2.0**-N.depth.frac_bits
    order, key_order = np.argsort(exact.depth, kind="stable"), frame.projected.depth_key[rows]
    assert (np.diff(key_order[order].astype(np.int64)) >= -8).all()  # an inversion is a matter of ulps
    z = (model.means @ camera.rotation.T + camera.translation)[rows, 2]
    assert z == pytest.approx(exact.depth)


def test_projected_splats_are_the_visible_in_order(scene):
    model, camera, frame, _, _ = scene
    splats = projected_splats(PAPER_SMALL, frame.words, frame.registers)
    rows = np.flatnonzero(frame.projected.reason == VISIBLE)
    assert np.array_equal(splats["index"][:-1], rows) and splats["end"].tolist() == [0] * len(rows) + [1]
    assert np.array_equal(splats["mean2d"][:-1], frame.projected.mean2d[rows])
    assert np.array_equal(N.conic.to_float(splats["conic"][:-1]), frame.projected.conic[rows])
    offset = N.view.to_float(splats["offset"][:-1])
    assert offset == pytest.approx(model.means[rows] - camera.position, abs=1e-4)
    assert np.array_equal(np.stack([splats[name][:-1] for name in ("first_x", "last_x", "first_y", "last_y")], 1),
                          frame.projected.box[rows])


@pytest.mark.parametrize("sh", range(4))
def test_colours_follow_the_harmonics(sh):
    """Every basis function and its sign: each coefficient alone, then all together."""
    camera = turned_view(200, 150)
    base = random_model(np.random.default_rng(30 + sh), 300, levels=2, sh=sh)
    terms = base.sh_rest.shape[1]
    for alone in [None, *range(terms)]:
        rest = base.sh_rest * (1 if alone is None else np.eye(terms)[alone][:, None])
        model = replace(base, sh_dc=np.clip(base.sh_dc, -1, 1), sh_rest=np.clip(rest, -0.9, 0.9))
        frame = render(model, camera)
        rows = np.flatnonzero(frame.projected.reason == VISIBLE)
        expected = np.minimum(colour_per_level(model, rows, camera.position), N.colour.to_float(N.colour.raw_max))
        error = np.abs(N.colour.to_float(frame.splats.colour[rows]) - expected)
        assert error.max() < 2.5e-3 and np.sqrt(np.mean(error**2)) < 1e-3
    assert terms == (sh + 1) ** 2 - 1 and len(rows) > 30


def test_colour_of_levels_differs_in_its_base_only():
    model = splats((0, 0, 2), levels=3)
    dc = model.sh_dc.copy()
    dc[0, :, 0] = (np.array([0.2, 0.4, 0.6]) - 0.5) / SH_C0
    frame = render(replace(model, sh_dc=dc), view())
    got = N.colour.to_float(frame.splats.colour[0])
    assert got[:, 0] == pytest.approx([0.2, 0.4, 0.6], abs=2e-3) and (got[:, 1:] == got[0, 1:]).all()


def test_no_foveation_is_level_one_everywhere():
    camera = view(40, 40)
    frame = render(splats((0, 0, 2)), camera, foveation=no_foveation(Display(40, 40)))
    assert not frame.registers.header.any() and (frame.entries.use == 1).all()
