"""Known ways in which splatting software fails, on the oracle: finite, bounded, deterministic, counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.oracle.ellipse import exponent
from golden.oracle.project import project, project_covariance
from golden.oracle.render import render
from golden.oracle.tiles import tile_lists
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.model import GaussianModel
from spec.errors import InputError
from tests.helpers.golden_samples import splats, view

SIZE = (64, 48)


def checked(model: GaussianModel, camera: Camera, **options):
    """The frame, after the checks that hold for any: finite, bounded, every point accounted for, and repeatable."""
    frame = render(model, camera, **options)
    assert np.isfinite(frame.image).all()
    assert ((frame.transmittance >= 0) & (frame.transmittance <= 1)).all()
    assert frame.visible + sum(frame.culled.values()) == len(model)
    assert np.array_equal(frame.image, render(model, camera, **options).image)
    return frame


# Projection


@pytest.mark.parametrize("z", [0.0, -0.0, 1e-300, -1e-300, 1e-9])
def test_01_02_at_and_near_the_camera_is_culled_before_the_division(z):
    frame = checked(splats((0, 0, z), (1e-3, 0, z)), view())
    assert frame.culled["near"] == 2 and frame.entries == 0


def test_03_near_plane_is_exact():
    near = 0.2
    depths = (np.nextafter(near, 0), near, np.nextafter(near, 1))
    frame = checked(splats(*((0, 0, z) for z in depths)), view())
    assert frame.culled["near"] == 2 and frame.visible == 1


def test_04_behind_the_camera_with_a_huge_extent():
    frame = checked(splats((0, 0, -1), (0, 0, -1e6), scale=1e5), view())
    assert frame.culled["near"] == 2 and not frame.coverage.any()


@pytest.mark.parametrize("x", [1e3, 1e12, 1e300])
def test_05_mean_far_outside_the_frustum(x):
    frame = checked(splats((x, 0, 1), (0, -x, 1)), view())
    assert frame.visible == 0


@pytest.mark.parametrize("side", [1, -1])
def test_06_jacobian_clamp_is_the_identity_inside_and_a_clamp_outside(side):
    """A needle along z: what it covers in x follows the Jacobian at its own x/z, up to the margin of 1.3."""
    camera, z = view(), 2.0
    margin = 1.3 * (SIZE[0] / 2) / 50
    for tangent, used in ((0.5 * margin, 0.5 * margin), (np.nextafter(margin, 0), margin), (1.5 * margin, margin)):
        point = np.array([[side * tangent * z, 0, z]])
        cov2d, _ = project_covariance(splats(point[0], scale=(1e-9, 1e-9, 0.9)), point, camera)
        assert cov2d[0, 0] == pytest.approx((50 * used / z * 0.9) ** 2 + 0.3, rel=1e-12)


def test_07_off_centre_principal_point_moves_the_image():
    model = splats((0.1, -0.1, 2), (-0.2, 0.1, 3))
    centred = checked(model, view())
    moved = checked(model, view(cx=SIZE[0] / 2 + 7, cy=SIZE[1] / 2 - 5))
    np.testing.assert_allclose(moved.image[3:36, 17:57], centred.image[8:41, 10:50], atol=1e-12)
    assert centred.coverage[8:41, 10:50].max() > 0.5


def test_08_09_10_splats_that_fill_the_screen_needles_and_centres_outside():
    full = checked(splats((0, 0, 5), scale=100), view())
    assert (full.tile_intersections == 1).all() and (full.coverage > 0.7).all()
    needle = checked(splats((0, 0, 2), scale=(1e4, 1e-6, 1e-6)), view())
    assert needle.entries == SIZE[0] // 16  # one row of tiles
    assert needle.coverage[[23, 24]].min() > 0.3 and not needle.coverage[:20].any()
    beside = checked(splats((-3, 0, 2), scale=1.0), view())  # its mean is 43 px left of the frame
    assert beside.visible == 1 and beside.coverage[24, 0] > beside.coverage[24, 20] > 0


# Covariance and alpha


@pytest.mark.parametrize("axes", [(0, 0.1, 0.1), (0, 0, 0.1), (0, 0.1, 0), (0, 0, 0)])
def test_11_12_degenerate_axes_leave_the_low_pass(axes):
    """Zero extent along axes is a log scale of -inf: the splat stays, no narrower than the low-pass filter."""
    frame = checked(splats((0, 0, 2), scale=axes, opacity=1.0), view())
    assert frame.visible == 1
    got, _ = project(splats((0, 0, 2), scale=axes), view(), 3.0)
    determinant = got.cov2d[0, 0] * got.cov2d[0, 2] - got.cov2d[0, 1] ** 2
    assert determinant == pytest.approx((0.3 + (25 * axes[0]) ** 2) * (0.3 + (25 * axes[1]) ** 2))


def test_12_determinant_of_a_long_diagonal_needle_keeps_its_minor_axis():
    """xx yy - xy^2 of this needle is lost to rounding (1e22 - 1e22); its minor axis is the low-pass all the same."""
    diagonal = (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))
    got, _ = project(splats((0, 0, 2), scale=(1.2e4, 1e-9, 1e-9), quat=diagonal), view(), 3.0)
    across = exponent(-1.0, 1.0, got.factor[0])
    assert across == pytest.approx(0.5 * 2 / 0.3, rel=1e-5)


def test_13_exponent_is_never_positive():
    rng = np.random.default_rng(1)
    n = 2000
    model = splats(
        *np.column_stack([rng.uniform(-1, 1, (n, 2)), np.full(n, 2.0)]), scale=10 ** rng.uniform(-8, 6, (n, 3))
    )
    got, _ = project(replace(model, quats=rng.normal(size=(n, 4))), view(), 3.0)
    assert min(exponent(*rng.normal(size=2), f) for f in got.factor) >= 0


def test_14_15_opacity_at_the_cut():
    """One splat centred on a pixel: at 1/255 exactly it shows in that pixel alone, below it is culled by name."""
    cut = 1 / 255
    centre = ((32.5 - 32) / 50 * 2, (24.5 - 24) / 50 * 2, 2)
    at = checked(splats(centre, opacity=cut), view())
    assert at.visible == 1 and (at.coverage > 0).sum() == 1
    assert at.coverage[24, 32] == pytest.approx(cut)
    below = checked(splats(centre, centre, opacity=[np.nextafter(cut, 0), 0.0]), view())
    assert below.culled["transparent"] == 2 and below.entries == 0


def test_16_an_opaque_splat_shows_before_the_pixel_stops():
    """3DGS would stop before an alpha of 1 and drop its colour; here it shows, and hides what follows."""
    front, back = (0, 0, 2), (0, 0, 3)
    model = splats(front, back, scale=5.0, opacity=1.0, colour=[(1, 0, 0), (0, 1, 0)])
    frame = checked(model, view(), alpha_max=(1.0,))
    red, green, _ = frame.image[24, 32]
    assert red > 0.999 and green < 1e-4
    assert checked(model, view()).image[24, 32] == pytest.approx([0.99, 0.0099, 0], abs=2e-4)  # alpha_max of level 1


def test_18_largest_amplification_saturates_the_whole_footprint():
    model = splats((0, 0, 2), scale=0.2, opacity=128.0, colour=(0.25, 0.5, 0.75), levels=2)
    frame = checked(model, view(), gaze=(0, 0))
    covered = frame.coverage > 0
    assert (frame.foveation.tile_level[1:, 2:] == 1).all()
    far = np.s_[16:, 32:]
    assert (frame.transmittance[far][covered[far]] < 1e-12).mean() > 0.95  # 128 exp(-4.5) > 1: opaque to the support's edge
    np.testing.assert_allclose(frame.image[40, 32], 0)


@pytest.mark.parametrize("quat", [(1, 0, 0, 0), (np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4))])
@pytest.mark.parametrize("scale", [(0.3, 0.05, 0.05), (0.05, 0.3, 0.05), (0.1, 0.1, 0.1)])
def test_19_axis_aligned_covariance_in_the_oriented_box(scale, quat):
    """A covariance without xy term (and a circle, without axes at all) has a box that holds the ellipse's tiles."""
    exact, box = (checked(splats((0.2, 0.1, 2), scale=scale, quat=quat), view(), tile_test=t) for t in ("exact", "obb"))
    assert np.array_equal(exact.image, box.image)
    assert (box.tile_intersections >= exact.tile_intersections).all() and box.entries < 12


# Input and colour


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "opacity", "sh_dc"])
def test_21_22_23_non_finite_points_are_culled_and_counted(field, bad):
    model = splats((0, 0, 2), (0.1, 0, 2))
    values = getattr(model, field).copy()
    values[1].flat[0] = bad
    frame = checked(replace(model, **{field: values}), view())
    assert frame.culled["non_finite"] == 1 and frame.visible == 1


def test_27_28_quaternions_are_normalised_and_zero_is_culled():
    model = splats((0, 0, 2), scale=(0.3, 0.1, 0.05), quat=(0.9, 0.1, 0.3, 0.2))
    unit, long = checked(model, view()), checked(replace(model, quats=model.quats * 37), view())
    np.testing.assert_allclose(long.image, unit.image, atol=1e-12)
    assert checked(replace(model, quats=model.quats * 0), view()).culled["non_finite"] == 1


def test_23_extent_beyond_float64_is_culled_and_counted():
    frame = checked(replace(splats((0, 0, 2), (0, 0, 3)), log_scales=np.array([[400.0] * 3, [-2.0] * 3])), view())
    assert frame.culled["overflow"] == 1 and frame.visible == 1


def test_32_33_colours_clamp_below_after_the_sum_and_not_above():
    """DC alone would be negative; the view-dependent part brings it back. Clamping before the sum would give 1.25."""
    model = splats((0, 0, 2), scale=1.0, opacity=1.0, colour=(-0.5, -3, 40))
    rest = np.zeros((1, 3, 3))
    rest[0, 1, :2] = 1.25 / 0.4886025119029199  # along z
    frame = checked(replace(model, sh_rest=rest), view())
    np.testing.assert_allclose(frame.image[24, 32] / frame.coverage[24, 32], [0.75, 0, 40], atol=1e-9)


def test_35_planetary_coordinates():
    model = splats((0, 0, 2), (0.2, 0.1, 3), scale=0.3)
    far = np.array([6.4e6, -1.2e6, 3.3e6])
    moved = checked(replace(model, means=model.means + far), view(translation=-far))
    np.testing.assert_allclose(moved.image, checked(model, view()).image, atol=1e-6)


# Sorting, tiles and frames


def test_36_equal_depths_go_by_index_whatever_the_order_of_arrival():
    n = 30
    rng = np.random.default_rng(2)
    model = splats(*np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), np.full(n, 2.0)]), colour=rng.uniform(0, 1, (n, 3)))
    got, _ = project(model, view(), 3.0)
    foveation = no_foveation(Display(*SIZE))
    expected = tile_lists(got, foveation)
    for _ in range(5):
        shuffle = rng.permutation(n)
        shuffled = type(got)(**{name: values[shuffle] for name, values in vars(got).items()})
        lists = tile_lists(shuffled, foveation)
        assert np.array_equal(lists.start, expected.start)
        assert np.array_equal(shuffled.index[lists.entries], got.index[expected.entries])
    assert all((np.diff(expected.entries[a:b]) > 0).all() for a, b in zip(expected.start, expected.start[1:], strict=False))


def test_36_the_order_of_the_input_does_not_matter_when_depths_differ():
    rng = np.random.default_rng(3)
    model = splats(*rng.uniform((-0.5, -0.5, 1), (0.5, 0.5, 4), (40, 3)), colour=rng.uniform(0, 1, (40, 3)))
    assert np.array_equal(checked(model.select(rng.permutation(40)), view()).image, checked(model, view()).image)


def test_40_45_nothing_visible_shows_the_background_and_no_depth():
    frame = checked(splats((0, 0, -1)), view(), background=(0.1, 0.2, 0.3))
    assert (frame.image == (0.1, 0.2, 0.3)).all()
    assert (frame.transmittance == 1).all() and np.isnan(frame.depth).all()
    assert frame.entries == frame.visible == 0
    empty = splats((0, 0, 1)).select(np.zeros(1, bool))
    assert (checked(empty, view()).image == 0).all()


@pytest.mark.parametrize("offset_px", [-1e-3, 0.0, 1e-3])
def test_42_ellipse_on_a_tile_edge(offset_px):
    """A circle whose 3-sigma edge passes by the first pixel column of the next tile: listed there iff it reaches it.

    The circle has a variance of exactly 4 px^2, hence a radius of 6 px; column 16's centre is at 16.5.
    """
    sigma = np.sqrt(4 - 0.3) / 50 * 2
    x, y = 10.5 + offset_px, 8.5
    mean = ((x - 32) / 50 * 2, (y - 24) / 50 * 2, 2)
    frame = checked(splats(mean, scale=(sigma, sigma, 0), opacity=1.0), view())
    reaches = offset_px >= 0
    if offset_px != 0:
        assert (frame.tile_intersections[0, 1] == 1) == reaches and (frame.coverage[8, 16] > 0) == reaches
    assert frame.tile_intersections[0, 1] >= (frame.coverage[:16, 16:32] > 0).any()
    assert frame.coverage[8, 15] > 0.004


@pytest.mark.parametrize("tile_test", ["exact", "obb"])
def test_42_56_a_tile_reaches_no_farther_than_the_frame(tile_test):
    """A circle of 6 px radius centred below a frame of 40x20 pixels enters tile 1 of the last row; of tile 2 it would only
    enter what lies below the frame: at x = 32.5 it reaches up to y = 19.6, and the last pixel centre is at 19.5."""
    sigma = np.sqrt(4 - 0.3) / 50 * 2
    mean = ((29.5 - 20) / 50 * 2, (24.8 - 10) / 50 * 2, 2)
    frame = checked(splats(mean, scale=(sigma, sigma, 1e-9), opacity=1.0), view(40, 20, cx=20, cy=10), tile_test=tile_test)
    exact = tile_test == "exact"  # the box of a circle is a square, and enters both
    assert frame.tile_intersections[1].tolist() == ([0, 1, 0] if exact else [0, 1, 1])
    assert (frame.coverage[19] > 0).any()


def test_43_every_splat_in_one_tile():
    n = 3000
    rng = np.random.default_rng(4)
    means = rng.uniform((-1.1, -0.8, 2.0), (-0.8, -0.5, 2.001), (n, 3))  # 4..12 px from the frame's corner
    frame = checked(splats(*means, scale=1e-3, opacity=0.05), view())
    assert frame.tile_intersections[0, 0] == frame.entries == n


def test_46_depth_is_the_alpha_weighted_mean():
    model = splats((0, 0, 2), (0, 0, 4), scale=3.0, opacity=[0.5, 0.9])
    frame = checked(model, view())
    front = frame.depth[24, 32]
    a, b = 0.5, 0.5 * 0.9
    assert front == pytest.approx((a * 2 + b * 4) / (a + b), rel=1e-3)
    thin = checked(splats((0, 0, 2), scale=3.0, opacity=0.45), view())
    assert np.isnan(thin.depth).all() and thin.coverage.max() > 0.4


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 1), (100, 16), (1920, 3)])
def test_56_frame_sizes(size):
    frame = checked(splats((0, 0, 2), scale=2.0), view(*size), background=(0.5, 0.5, 0.5))
    assert frame.image.shape == (size[1], size[0], 3)
    assert frame.tile_intersections.shape == (-(-size[1] // 16), -(-size[0] // 16))
    assert frame.coverage[size[1] // 2, size[0] // 2] > 0.5


def test_what_does_not_fit_is_refused():
    model, camera = splats((0, 0, 2), levels=2), view()
    with pytest.raises(InputError, match="off the display"):
        render(model, camera, gaze=(65, 0))
    with pytest.raises(InputError, match="frame has 64x48"):
        render(model, camera, display=Display(64, 47), gaze=(1, 1))
    with pytest.raises(ValueError, match="not 'aabb'"):
        render(model, camera, tile_test="aabb")
    with pytest.raises(ValueError, match="not 'table'"):
        render(model, camera, weights="table")
    with pytest.raises(ValueError, match="each of 2 levels, not "):
        render(model, camera, alpha_max=(0.99,))
