"""Known ways in which splatting software fails, on the integer renderer; numbers as in tests/golden/oracle/test_hard_cases.py.

17 (alpha = 1 in the backward pass) belongs to training; here alpha = 1 is part of 16 and 18.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.quantise import quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.projection import FAINT, NEAR, OUTSIDE, VISIBLE
from golden.msv2_ref.saturations import misplaced
from golden.oracle.render import render as oracle
from spec.config import PAPER_SMALL
from spec.constants import EXPONENT_SCALE, LOG2E_HALF, LOW_PASS
from spec.formats import SQ
from spec.guard_band import UNBOUNDED, mean_range
from spec.records import array_splat
from tests.helpers.array_by_the_text import ArrayByTheText
from tests.helpers.checked_frames import N, checked, coverage
from tests.helpers.golden_samples import map_for, random_model, splats, view

WIDTH, HEIGHT = 64, 48


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


@pytest.mark.parametrize("bits", [14, 12])
@pytest.mark.parametrize("axis", [0, 1])
def test_74_giants_at_both_ends_of_the_guard_band(bits, axis):
    """Three pixels inside its end they are drawn, as the oracle draws them; three pixels outside they are culled."""
    config, end = PAPER_SMALL.with_(name="other", formats=replace(N, mean2d=SQ(bits, 10))), 1 << bits
    pixels = np.array([end - 3, 3 - end, end + 3, -end - 3])
    means = np.full((4, 3), 0.25)
    means[:, axis], means[:, 1 - axis] = (pixels - (WIDTH, HEIGHT)[axis] / 2) * 0.25 / 50, 0.0
    model, camera = splats(*means, scale=0.25 / 50 * end, opacity=0.4), view()
    frame = render(model, camera, config=config)
    assert reasons(frame) == [VISIBLE, VISIBLE, OUTSIDE, OUTSIDE]
    assert misplaced(frame.projected).tolist() == [False, False, True, True]
    exact = oracle(model, camera, mean_range=mean_range(config.formats))
    assert exact.culled["outside"] == 2 and psnr_vs(frame.image, exact.image) > 60
    assert psnr_vs(frame.image, oracle(model, camera, mean_range=UNBOUNDED).image) < 40


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
    record, text = array_splat(PAPER_SMALL), ArrayByTheText(PAPER_SMALL)
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
    expected = quantise_model(PAPER_SMALL, unit).geometry["quat"]
    got = quantise_model(PAPER_SMALL, replace(unit, quats=unit.quats * length)).geometry["quat"]
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
