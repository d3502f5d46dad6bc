"""Known ways in which splatting software fails, on the integer renderer; numbers as in tests/test_oracle_hard_cases.py.

17 (alpha = 1 in the backward pass) belongs to training; here alpha = 1 is part of 16 and 18.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from array_by_the_text import ArrayByTheText
from golden_samples import map_for, random_model, splats, turned_view, view

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref.culling import FAINT, NEAR, OUTSIDE, VISIBLE
from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.quantise import quantise_model
from golden.msv2_ref.sort_tmu import ENTRY_BYTES, auto_beta
from golden.oracle.render import render as oracle
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.config import DEFAULT, TINY
from spec.constants import EXPONENT_SCALE, LOG2E_HALF, LOW_PASS
from spec.errors import InputError
from spec.records import array_entry

N = DEFAULT.formats
WIDTH, HEIGHT = 64, 48


def checked(model: GaussianModel, camera: Camera, **options) -> Frame:
    """The frame, after the checks that hold for any: finite, bounded, every point accounted for, and repeatable."""
    frame = render(model, camera, **options)
    assert np.isfinite(frame.image).all() and np.isfinite(frame.projected.conic).all()
    assert (frame.image >= 0).all() and ((frame.transmittance >= 0) & (frame.transmittance < 1)).all()
    assert len(frame.projected.reason) == len(model) and (frame.projected.reason <= OUTSIDE).all()
    assert len(frame.registers.header) == len(frame.entries.start) - 1
    again = render(model, camera, **options)
    assert all(np.array_equal(a, b) for a, b in zip(frame.pixels, again.pixels, strict=True))
    return frame


def coverage(frame: Frame) -> np.ndarray:
    """1 - T, from T as it starts: the largest value of its format."""
    return N.transmittance.to_float(N.transmittance.raw_max) - frame.transmittance


def reasons(frame: Frame) -> list[int]:
    return frame.projected.reason.tolist()


# Projection


@pytest.mark.parametrize("z", [0.0, 1e-300, -1e-300, 1e-9, 0.1])
def test_01_02_at_and_near_the_camera_is_culled_before_the_division(z):
    frame = checked(splats((0, 0, z), (1e-3, 0, z)), view(), background=(0.5, 0.5, 0.5))
    assert reasons(frame) == [NEAR, NEAR] and not frame.projected.conic.any()
    assert len(np.unique(frame.image)) == 1 and not coverage(frame).any()


def test_03_near_plane_to_the_ulp():
    """At the near plane and an ulp of the `view` format in front of it: culled. An ulp behind it: drawn, with key 1."""
    near = float(N.view.round(0.2))
    ulp = 2.0 ** -(N.view.sig_bits + 2)
    frame = checked(splats((0, 0, near - ulp), (0, 0, near), (0, 0, near + ulp), scale=1e-3), view(near=near))
    assert reasons(frame) == [NEAR, NEAR, VISIBLE]
    assert frame.projected.depth_key[2] == 1


def test_04_behind_the_camera_with_a_huge_extent():
    frame = checked(splats((0, 0, -1), (0, 0, -1e6), scale=1e5), view())
    assert reasons(frame) == [NEAR, NEAR] and not coverage(frame).any()


@pytest.mark.parametrize("x", [1e3, 1e12, 1e30, 1e38])
def test_05_mean_far_outside_the_frustum(x):
    frame = checked(splats((x, 0, 1), (0, -x, 1), (0, 0, 1)), view())
    assert reasons(frame) == [OUTSIDE, OUTSIDE, VISIBLE]


@pytest.mark.parametrize("side", [1, -1])
def test_06_jacobian_clamp_is_the_identity_inside_and_a_clamp_outside(side):
    """A needle along z: what it covers in x follows the Jacobian at its own x/z, up to the margin of 1.3."""
    camera, z = view(), 2.0
    margin = 1.3 * (WIDTH / 2) / 50
    for tangent, used in ((0.5 * margin, 0.5 * margin), (0.999 * margin, 0.999 * margin), (1.5 * margin, margin)):
        frame = checked(splats((side * tangent * z, 0, z), (0, 0, 1), scale=(1e-9, 1e-9, 0.875)), camera)
        l1, l2, l3 = frame.projected.conic[0]
        assert l2 == 0 and l3 == pytest.approx(EXPONENT_SCALE / np.sqrt(LOW_PASS), rel=1e-4)
        assert (EXPONENT_SCALE / l1) ** 2 == pytest.approx((50 * used / z * 0.875) ** 2 + LOW_PASS, rel=2e-4)


def test_06_the_clamp_changes_no_bit_inside():
    """Points within the frustum project alike whether the margin lies close by or far away."""
    model = random_model(np.random.default_rng(0), 200)
    narrow, wide = (checked(model, view(width, HEIGHT, cx=20.0)).projected for width in (40, 400))
    x, _, z = model.means.T
    inside = (narrow.reason == VISIBLE) & (np.abs(x) < 1.29 * 20 / 50 * z)
    assert inside.sum() > 10
    assert np.array_equal(narrow.conic[inside], wide.conic[inside])
    assert np.array_equal(narrow.mean2d[inside], wide.mean2d[inside])


def test_07_off_centre_principal_point_moves_the_image():
    """By 16 pixels, a tile: every bit moves along. By 7 and -5: the tiles' reference points round differently."""
    model = splats((0.1, -0.1, 2), (-0.2, 0.1, 3))
    centred = checked(model, view())
    tile = checked(model, view(cx=WIDTH / 2 + 16))
    assert np.array_equal(tile.image[:, 16:], centred.image[:, :-16])
    odd = checked(model, view(cx=WIDTH / 2 + 7, cy=HEIGHT / 2 - 5))
    np.testing.assert_allclose(odd.image[3:36, 17:57], centred.image[8:41, 10:50], atol=0.5 / 255)
    assert coverage(centred)[8:41, 10:50].max() > 0.5


def test_08_splat_filling_the_screen():
    frame = checked(splats((0, 0, 5), scale=100), view())
    assert (np.diff(frame.entries.start) == 1).all()
    assert np.abs(coverage(frame) - 0.8).max() < 0.5 / 255


def test_09_needles_and_giants_do_not_wrap():
    needle = checked(splats((0, 0, 2), scale=(1e4, 1e-6, 1e-6)), view())
    assert len(needle.entries.splat) == WIDTH // 16  # one row of tiles
    assert coverage(needle)[[23, 24]].min() > 0.3 and not coverage(needle)[:20].any() and not coverage(needle)[28:].any()
    giant = checked(splats((0, 0, 2), scale=1e7), view())
    assert np.abs(coverage(giant) - 0.8).max() < 0.5 / 255
    for z in (0.21, 100.0):  # flat, edge on
        edge = checked(splats((0, 0, z), scale=(1e6, 1e-9, 1e6)), view())
        assert psnr_vs(edge.image, oracle(splats((0, 0, z), scale=(1e6, 1e-9, 1e6)), view()).image) > 60


def test_10_centre_outside_footprint_inside():
    model = splats((-3, 0, 2), scale=1.0)  # its mean is 43 px left of the frame
    frame, exact = checked(model, view()), oracle(model, view())
    assert coverage(frame)[24, 0] > coverage(frame)[24, 20] > 0
    assert np.abs(frame.image - exact.image).max() < 0.5 / 255


# Covariance and alpha


@pytest.mark.parametrize("axes", [(0, 0.1, 0.1), (0, 0, 0.1), (0, 0.1, 0), (0, 0, 0)])
def test_11_degenerate_axes_leave_the_low_pass(axes):
    model = splats((0, 0, 2), scale=axes, opacity=1.0)
    frame = checked(model, view())
    assert reasons(frame) == [VISIBLE] and not frame.words.geometry["scale"][0][np.equal(axes, 0)].any()
    variances = [(25 * axis) ** 2 + LOW_PASS for axis in axes[:2]]
    l1, l2, l3 = frame.projected.conic[0]
    assert (l1, l2, l3) == pytest.approx((*[EXPONENT_SCALE / np.sqrt(v) for v in variances[:1]], 0,
                                          EXPONENT_SCALE / np.sqrt(variances[1])), rel=1e-4)


def test_12_determinant_keeps_the_minor_axis_of_a_long_diagonal_needle():
    """xx yy - xy^2 of this needle cancels in any short format; its minor axis is the low-pass all the same."""
    diagonal = (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))
    for length in (1.0, 100.0, 1.2e4):
        conic = checked(splats((0, 0, 2), scale=(length, 1e-9, 1e-9), quat=diagonal), view()).projected.conic[0]
        across = (-conic[0] + conic[1]) ** 2 + conic[2] ** 2  # u^2 + v^2 at (-1, 1)
        assert across == pytest.approx(LOG2E_HALF * 2 / LOW_PASS, rel=1e-3)


def test_12_dots_far_below_a_pixel():
    frame = checked(splats((0, 0, 1e4), scale=1e-11, opacity=1.0), view())
    assert frame.projected.conic[0] == pytest.approx((1.5506, 0, 1.5506), rel=1e-4)


def test_13_no_exponent_exceeds_the_opacity():
    """The falloff is a sum of squares; only its rounding may raise the exponent, by less than 0.01 anywhere in a tile."""
    rng = np.random.default_rng(1)
    n = 300
    means = np.column_stack([rng.uniform(-1, 1, (n, 2)), np.full(n, 2.0)])
    model = replace(splats(*means, scale=10 ** rng.uniform(-8, 6, (n, 3)), opacity=1.0), quats=rng.normal(size=(n, 4)))
    frame = checked(model, view())
    record, text = array_entry(DEFAULT), ArrayByTheText(DEFAULT)
    tile = np.repeat(np.arange(len(frame.headers)), np.diff(frame.entries.start))
    x, y = np.meshgrid(np.arange(16), np.arange(16))
    highest = []
    for entry, header in zip(frame.array_entries, frame.headers[tile], strict=True):
        polynomial = text.polynomial(record.unpack(record.pack(entry)), int(header["tile_x"]), int(header["tile_y"]))
        assert polynomial is not None  # what the tile test lets through is never dropped
        corner, sx, sy, cxx, cxy, cyy = polynomial
        e = corner + x * sx + y * sy + x * (x - 1) // 2 * cxx + y * (y - 1) // 2 * cyy + x * y * cxy
        highest.append(e.max())
    assert max(highest) < 0.01 * (1 << N.exponent.frac_bits)


def test_14_15_opacity_at_the_cut():
    """One splat centred on a pixel. A hundredth of an octave above 1/255 it shows in that pixel alone; at 1/255 the exponent's
    rounding decides, there and nowhere else; an ulp below it is culled by name."""
    centre = ((32.5 - 32) / 50 * 2, (24.5 - 24) / 50 * 2, 2)
    above = checked(splats(centre, opacity=2**0.01 / 255), view())
    assert np.argwhere(coverage(above) > 0).tolist() == [[24, 32]]
    assert coverage(above)[24, 32] == pytest.approx(1 / 255, abs=1.5 * 2.0**-N.alpha.frac_bits)
    at = checked(splats(centre, opacity=1 / 255), view())
    assert reasons(at) == [VISIBLE] and np.argwhere(coverage(at) > 0).tolist() in ([], [[24, 32]])
    faint = (1 / 255) * 2 ** -(1.5 * 2.0**-N.log2_opacity.frac_bits)
    below = checked(splats(centre, centre, centre, opacity=[faint, 0.0, 1e-300]), view())
    assert reasons(below) == [FAINT] * 3 and len(below.entries.splat) == 0


def test_14_a_level_too_faint_to_show_beside_one_that_does():
    """In a blend tile the level below the cut composites nothing, at any of the tile's rows."""
    camera = view(200, 160)
    model = splats(*[((x - 100) / 25, (y - 80) / 25, 2) for x in range(5, 200, 13) for y in range(5, 160, 13)], levels=4)
    opacity = model.opacity.copy()
    opacity[:, 1:] = 1e-4
    foveation = map_for(camera, (0.5, 0.5), 4)
    dark = checked(replace(model, opacity=opacity), camera, foveation=foveation)
    exact = oracle(replace(model, opacity=opacity), camera, foveation=foveation, weights="plane")
    assert foveation.blend.any() and psnr_vs(dark.image, exact.image) > 60
    outer = np.kron(foveation.tile_level > 0, np.ones((16, 16), bool))[:160, :200]
    assert not coverage(dark)[outer].any()


def test_16_an_opaque_splat_shows_before_the_pixel_stops():
    """3DGS would stop before an alpha of 1 and drop its colour; here it shows, and hides what follows."""
    model = splats((0, 0, 2), (0, 0, 3), scale=5.0, opacity=2.0, colour=[(1, 0, 0), (0, 1, 0)], levels=2)
    frame = checked(model, view(), foveation=map_for(view(), (0, 0), 2))
    assert (frame.registers.header[-1] == (1, 0, 1)).all()
    red, green, _ = frame.image[40, 56]
    assert red > 0.999 and green < 1e-3
    assert checked(model, view()).image[24, 32] == pytest.approx([0.99, 0.0099, 0], abs=5e-4)  # alpha_max of level 1


def test_18_largest_amplification_saturates_the_whole_footprint():
    model = splats((0, 0, 2), scale=0.2, opacity=128.0, colour=(0.25, 0.5, 0.75), levels=2)
    foveation = map_for(view(), (0, 0), 2)
    frame = checked(model, view(), foveation=foveation)
    exact = oracle(model, view(), foveation=foveation, weights="plane")
    assert frame.words.saturated["opacity"] == 0
    far = np.s_[16:, 32:]
    covered = exact.coverage[far] > 0
    assert (foveation.tile_level[1:, 2:] == 1).all() and covered.sum() > 100
    assert (frame.transmittance[far][covered] == 0).mean() > 0.95  # 128 exp(-4.5) > 1: opaque to the support's edge
    assert frame.image[24, 33] == pytest.approx([0.25, 0.5, 0.75], abs=1e-3)
    assert not coverage(frame)[40, 32]


@pytest.mark.parametrize("quat", [(1, 0, 0, 0), (np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4))])
@pytest.mark.parametrize("scale", [(0.3, 0.05, 0.05), (0.05, 0.3, 0.05), (0.1, 0.1, 0.1)])
def test_19_axis_aligned_covariances(scale, quat):
    """b = 0, and circles, which have no axes at all: finite, the same pixels by either tile test."""
    model = splats((0, 0, 2), scale=scale, quat=quat)
    exact, box = (checked(model, view(), obb=obb) for obb in (False, True))
    assert np.array_equal(exact.image, box.image) and len(exact.entries.splat) <= len(box.entries.splat) < 12
    l1, l2, _ = exact.projected.conic[0]
    assert abs(l2) < 5e-3 * l1  # a quarter turn is not exact in the quaternion's format
    rim = 0.8 * np.exp(-4.5)  # a pixel on the rim of the support may be on either side of it
    assert np.abs(exact.image - oracle(model, view()).image).max() < rim + 0.5 / 255


def test_20_exponential_bands_stay_below_a_third_of_a_grey_level():
    """One wide ramp of alpha from 0.8 down: table, exponent's grid and transmittance together."""
    model = splats((0, 0, 2), scale=1.0)
    frame, exact = checked(model, view(160, 120)), oracle(model, view(160, 120))
    inside = exact.coverage > 2 / 255
    assert np.abs(coverage(frame) - exact.coverage)[inside].max() < 0.33 / 255
    middle = coverage(frame)[60, 80:]
    assert (np.diff(middle) <= 0).all()


# Input and colour


def test_27_a_zero_quaternion_counts_as_no_rotation():
    """Loaders drop and count such points; one that is made by hand must still not divide by zero."""
    model = splats((0, 0, 2), scale=(0.3, 0.05, 0.1))
    assert np.array_equal(checked(replace(model, quats=model.quats * 0), view()).image, checked(model, view()).image)


@pytest.mark.parametrize("length", [1e-30, 0.5, 8.0, 1e30])
def test_28_quaternions_of_any_length_are_normalised(length):
    model = random_model(np.random.default_rng(2), 100)
    unit = replace(model, quats=model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True))
    expected = quantise_model(DEFAULT, unit).geometry["quat"]
    got = quantise_model(DEFAULT, replace(unit, quats=unit.quats * length)).geometry["quat"]
    assert np.abs(got - expected).max() <= 1 and (got != expected).mean() < 0.01  # ties of the rounding
    assert np.isfinite(checked(replace(unit, quats=unit.quats * length), view()).image).all()


def test_32_33_colours_clamp_below_after_the_sum_and_above_at_the_format():
    """DC alone would be negative; the view-dependent part brings it back. Clamping before the sum would give 1.25."""
    model = splats((0, 0, 2), scale=1.0, opacity=1.0, colour=(-0.5, -3, 40))
    rest = np.zeros((1, 3, 3))
    rest[0, 1, :2] = 1.25 / 0.4886025119029199  # along z
    frame = checked(replace(model, sh_rest=rest), view())
    colour = N.colour.to_float(frame.splats.colour[0, 0])
    # sh_rest holds up to 2 only: the red sum is -0.5 + 0.4886 * 2
    assert colour[:2] == pytest.approx([-0.5 + 0.4886 * N.sh_rest.to_float(N.sh_rest.raw_max), 0], abs=2e-3)
    assert colour[2] == N.colour.to_float(N.colour.raw_max)
    assert frame.words.saturated["dc"] == 1 and frame.words.saturated["rest"] == 2
    assert frame.image[24, 32] / coverage(frame)[24, 32] == pytest.approx(colour, abs=2e-3)


def test_34_thin_axes_survive_the_short_formats():
    """Discs a millionth thick, seen from the side and from the front."""
    rng = np.random.default_rng(5)
    n = 60
    means = np.column_stack([rng.uniform(-0.8, 0.8, (n, 2)), rng.uniform(1.5, 4, n)])
    model = splats(*means, scale=(0.2, 0.2, 1e-7), colour=rng.uniform(0, 1, (n, 3)), opacity=0.6)
    model = replace(model, quats=rng.normal(size=(n, 4)))
    assert psnr_vs(checked(model, view()).image, oracle(model, view()).image) > 60


@pytest.mark.parametrize("far", [(6.4e6, -1.2e6, 3.3e6), (1e9, 1e9, -1e9)])
def test_35_planetary_coordinates(far):
    model = splats((0, 0, 2), (0.2, 0.1, 3), (-0.1, 0.2, 2.5), scale=0.3, colour=[(1, 0, 0), (0, 1, 0), (0, 0, 1)])
    moved = replace(model, means=model.means + far)
    camera = view(translation=-np.array(far))
    frame = checked(moved, camera)
    assert psnr_vs(frame.image, checked(model, view()).image) > 60
    assert psnr_vs(frame.image, oracle(moved, camera).image) > 60


# Sorting, tiles and frames


def test_36_equal_depths_go_by_index():
    """Which of two equal depths comes first is the model's order, and only that; see test_golden_sort_tmu for arrival."""
    n = 30
    rng = np.random.default_rng(2)
    means = np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), np.full(n, 2.0)])
    frame = checked(splats(*means, scale=0.2, colour=rng.uniform(0, 1, (n, 3))), view())
    assert len(set(frame.projected.depth_key.tolist())) == 1
    for a, b in zip(frame.entries.start[:-1], frame.entries.start[1:], strict=True):
        assert (np.diff(frame.entries.splat[a:b]) > 0).all()


def test_36_the_order_of_the_input_does_not_matter_when_keys_differ_or_splats_are_apart():
    rng = np.random.default_rng(3)
    model = splats(*rng.uniform((-0.5, -0.5, 1), (0.5, 0.5, 4), (40, 3)), colour=rng.uniform(0, 1, (40, 3)))
    expected = checked(model, view())
    assert len(set(expected.projected.depth_key.tolist())) == 40
    apart = splats(*[(x, y, 2.0) for x in (-1, -0.5, 0, 0.5) for y in (-0.6, 0, 0.6)], scale=0.02, colour=(0.2, 0.9, 0.5))
    for some in (model, apart):
        for _ in range(3):
            shuffled = checked(some.select(rng.permutation(len(some))), view())
            assert np.array_equal(shuffled.image, checked(some, view()).image)


def test_37_a_far_outlier_costs_neither_order_nor_depth():
    model, camera = random_model(np.random.default_rng(4), 300), turned_view(96, 72)
    more = replace(model, **{name: np.concatenate([getattr(model, name), getattr(model, name)[:1]]) for name in (
        "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")},
        means=np.concatenate([model.means, [[0.3, 0.2, 1e7]]]))
    without, with_it = checked(model, camera), checked(more, camera)
    moved = np.abs(with_it.projected.depth_key[:-1] - without.projected.depth_key)  # the words' origin is another median
    assert moved.max() <= 4
    assert with_it.registers.depth_far < 5 * without.registers.depth_far
    exact = oracle(more, camera)
    valid = ~np.isnan(exact.depth) & ~np.isnan(with_it.depth)
    assert np.percentile(np.abs(with_it.depth / exact.depth - 1)[valid], 95) < 0.004
    assert psnr_vs(with_it.image, exact.image) > 60


def test_38_keys_invert_only_what_differs_by_ulps():
    """Every pair whose keys disagree with float64's order lies within rounding of each other; there are few."""
    rng = np.random.default_rng(6)
    camera, model = turned_view(64, 48), random_model(rng, 2000)
    frame = render(model, camera)
    seen = np.flatnonzero(frame.projected.reason == VISIBLE)
    z = (model.means @ camera.rotation.T + camera.translation)[seen, 2]
    key = frame.projected.depth_key[seen].astype(np.int64)
    inverted = (key[:, None] < key[None, :]) & (z[:, None] > z[None, :])
    first, second = np.nonzero(inverted)
    assert (z[first] / z[second] - 1 < 2.0 ** -(N.view.sig_bits - 4)).all()
    assert inverted.sum() < 1e-4 * len(seen) ** 2
    assert key.min() > 0 and key.max() < N.depth_key.raw_max


def test_38_keys_saturate_and_never_wrap():
    depths = [0.3, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 1e3, 1e6, 1e8, 1e12, 1e15, 1e30]
    frame = checked(splats(*[(0, 0, z) for z in depths], scale=[[z / 100] * 3 for z in depths]), view())
    key = frame.projected.depth_key
    assert (np.diff(key)[:10] > 0).all() and (key[10:] == N.depth_key.raw_max).all()


def test_39_small_rotations_pop_no_more_than_the_oracles():
    model, last = random_model(np.random.default_rng(7), 300), None
    for step in range(5):
        angle = np.deg2rad(12 + 0.02 * step)
        rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        camera = replace(turned_view(96, 72), rotation=rotation)
        ours, exact = render(model, camera).image, oracle(model, camera).image
        if last is not None:
            assert max_abs_error(ours, last[0]) < max_abs_error(exact, last[1]) + 4 / 255
            change = np.abs(np.clip(ours, 0, 1) - np.clip(last[0], 0, 1)).mean()
            assert change < np.abs(np.clip(exact, 0, 1) - np.clip(last[1], 0, 1)).mean() * 1.1 + 1e-4
        last = ours, exact


def test_40_45_nothing_visible_shows_the_background_and_no_depth():
    frame = checked(splats((0, 0, -1)), view(), background=(0.1, 0.2, 0.3))
    assert np.abs(frame.image - (0.1, 0.2, 0.3)).max() < 1.5 / 512 and len(np.unique(frame.image)) == 3
    assert not coverage(frame).any() and np.isnan(frame.depth).all() and len(frame.entries.splat) == 0
    empty = splats((0, 0, 1)).select(np.zeros(1, bool))
    assert (checked(empty, view()).image == 0).all()


def test_41_more_entries_in_a_tile_than_the_sorters_buffer_holds():
    """TINY's half buffer holds 256 entries: the big tile is a group of its own, and no entry is lost."""
    n, rng = 1500, np.random.default_rng(8)
    means = rng.uniform((-1.1, -0.8, 2.0), (-0.8, -0.5, 2.5), (n, 3))
    model = splats(*means, scale=1e-3, opacity=0.05, colour=rng.uniform(0, 1, (n, 3)))
    frame = checked(model, view(), config=TINY)
    counts = np.diff(frame.entries.start)
    assert counts[0] == n > TINY.sort_buffer_bytes // 2 // ENTRY_BYTES >= auto_beta(counts, TINY)
    assert (frame.groups == frame.groups[0]).sum() == 1
    assert psnr_vs(frame.image, oracle(model, view()).image) > 60


def test_41_more_points_than_an_index_holds_are_refused(monkeypatch):
    """With an index of 4 bits in place of 24: 15 points pass, and a tile's count holds them all; 16 do not."""
    monkeypatch.setattr("golden.msv2_ref.quantise.INDEX_BITS", 4)
    assert len(checked(splats(*[(0, 0, 2)] * 15), view()).words.geometry) == 15
    with pytest.raises(InputError, match=r"^16 Gaussians are not accepted"):
        render(splats(*[(0, 0, 2)] * 16), view())


@pytest.mark.parametrize("obb", [False, True])
@pytest.mark.parametrize("offset_px", [-0.05, -1e-3, 0.0, 1e-3, 0.05])
def test_42_ellipse_on_a_tile_edge(offset_px, obb):
    """A circle whose 3-sigma edge passes by the first pixel column of the next tile: drawn there iff it reaches it, and listed
    there at the least if it is drawn.

    The circle has a variance of 4 px^2, hence a radius of 6 px; column 16's centre is at 16.5.
    """
    sigma = np.sqrt(4 - LOW_PASS) / 50 * 2
    x, y = 10.5 + offset_px, 8.5
    frame = checked(splats(((x - 32) / 50 * 2, (y - 24) / 50 * 2, 2), scale=(sigma, sigma, 0), opacity=1.0), view(), obb=obb)
    drawn, listed = coverage(frame)[8, 16] > 0, np.diff(frame.entries.start)[1] == 1
    assert listed or not drawn
    if abs(offset_px) > 0.01:  # nearer, the circle's own rounding decides
        assert drawn == (offset_px > 0)
    assert coverage(frame)[8, 15] > 0 and not coverage(frame)[:, 17:].any()


def test_43_every_splat_in_one_tile():
    n, rng = 3000, np.random.default_rng(4)
    means = rng.uniform((-1.1, -0.8, 2.0), (-0.8, -0.5, 2.001), (n, 3))  # 4..12 px from the frame's corner
    frame = checked(splats(*means, scale=1e-3, opacity=0.05), view())
    assert np.diff(frame.entries.start)[0] == len(frame.entries.splat) == n


@pytest.mark.parametrize("beta", [0, 1, 7, 10**12])
def test_44_no_beta_changes_a_pixel(beta):
    model, camera = random_model(np.random.default_rng(9), 200), turned_view(96, 72)
    merged = checked(model, camera, beta=beta)
    assert np.array_equal(merged.image, render(model, camera).image)
    assert len(np.unique(merged.groups)) == merged.groups[-1] + 1


def test_46_depth_is_the_alpha_weighted_mean():
    frame = checked(splats((0, 0, 2), (0, 0, 4), scale=3.0, opacity=[0.5, 0.9]), view())
    a, b = 0.5, 0.5 * 0.9
    assert frame.depth[24, 32] == pytest.approx((a * 2 + b * 4) / (a + b), rel=2e-3)
    thin = checked(splats((0, 0, 2), scale=3.0, opacity=0.45), view())
    assert np.isnan(thin.depth).all() and coverage(thin).max() > 0.4


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 1), (100, 16), (1280, 3), (3, 500)])
def test_56_frame_sizes(size):
    model = splats((0, 0, 2), scale=2.0, opacity=0.9)
    camera = view(*size)
    frame = checked(model, camera, background=(0.5, 0.5, 0.5))
    assert frame.image.shape == (size[1], size[0], 3) and frame.depth.shape == (size[1], size[0])
    assert len(frame.groups) == -(-size[0] // 16) * -(-size[1] // 16)
    assert coverage(frame)[size[1] // 2, size[0] // 2] > 0.5
    assert np.abs(frame.image - oracle(model, camera, background=(0.5, 0.5, 0.5)).image).max() < 1 / 255
