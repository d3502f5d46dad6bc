"""Foveation geometry against hand-made values, against the paper's shares, and at its edges."""

import math

import numpy as np
import pytest

from golden.scenes.gaze import (
    Display,
    blend_parameter,
    foveation_map,
    no_foveation,
    region_level,
    smoothstep,
)
from spec.errors import InputError

PAPER_SIZE = (1237, 822)


def test_eccentricity_of_known_directions():
    display = Display(201, 101, fov_deg=90)  # pixel centres hit the axis exactly
    from_centre = display.eccentricity((100.5, 50.5))
    assert from_centre[50, 100] == 0
    assert from_centre[50, 200] == pytest.approx(math.degrees(math.atan(100 / 100.5)))
    assert from_centre[0, 100] == pytest.approx(math.degrees(math.atan(50 / 100.5)))
    from_edge = display.eccentricity((201, 50.5))  # 45 degrees to the right of the axis
    assert from_edge[50, 100] == pytest.approx(45)
    assert from_edge[50, 0] == pytest.approx(45 + math.degrees(math.atan(100 / 100.5)))


def test_width_of_the_display_is_a_parameter():
    wide, narrow = (Display(64, 64, fov).eccentricity((0, 32)).max() for fov in (120, 20))
    assert wide > 90 and narrow < 30


def test_shares_of_the_paper():
    """The paper: 13/17/21/49 % of pixels per region, about 25 % blended; its frame size is not stated exactly."""
    display = Display(*PAPER_SIZE)
    gaze = (PAPER_SIZE[0] / 2, PAPER_SIZE[1] / 2)
    share = np.bincount(region_level(display.eccentricity(gaze)).ravel()) / (PAPER_SIZE[0] * PAPER_SIZE[1])
    np.testing.assert_allclose(100 * share, [12.5, 18.2, 19.2, 50.2], atol=0.06)
    weight = foveation_map(display, gaze).blend_weights_exact
    assert 100 * ((weight > 0) & (weight < 1)).mean() == pytest.approx(23.9, abs=0.1)


@pytest.mark.parametrize(("size", "percent"), [(PAPER_SIZE, 33.3), ((256, 144), 59.7)])
def test_share_of_blend_tiles(size, percent):
    foveation = foveation_map(Display(*size), (size[0] / 2, size[1] / 2))
    assert 100 * foveation.blend.mean() == pytest.approx(percent, abs=0.1)


def test_bands_lie_before_their_boundaries():
    degrees = np.array([13.99, 14, 16, 18, 20])
    np.testing.assert_allclose(smoothstep(blend_parameter(degrees, np.zeros(5, int))), [0, 0, 0.5, 1, 1])
    assert region_level(np.array([0, 17.999, 18, 26.999, 27, 33, 120])).tolist() == [0, 0, 1, 1, 2, 3, 3]


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_levels_beyond_the_last_collapse(levels):
    foveation = foveation_map(Display(200, 120), (20, 30), levels)
    full = foveation_map(Display(200, 120), (20, 30))
    assert np.array_equal(foveation.tile_level, np.minimum(full.tile_level, levels - 1))
    assert not foveation.blend[foveation.tile_level == levels - 1].any()
    inner = full.tile_level < levels - 1
    assert np.array_equal(foveation.blend[inner], full.blend[inner])
    assert np.array_equal(foveation.plane[inner], full.plane[inner])


@pytest.mark.parametrize("gaze", [(0, 0), (250, 0), (125, 70), (33.3, 139)])
def test_tiles_follow_their_pixels(gaze):
    display = Display(250, 140)
    foveation = foveation_map(display, gaze)
    eccentricity, weight = display.eccentricity(gaze), foveation.blend_weights_exact
    assert (foveation.tiles_x, foveation.tiles_y) == (16, 9)
    for ty in range(9):
        for tx in range(16):
            here = np.s_[16 * ty : 16 * ty + 16, 16 * tx : 16 * tx + 16]
            assert foveation.tile_level[ty, tx] == region_level(eccentricity[here].min())
            assert foveation.blend[ty, tx] == (weight[here] > 0).any()


@pytest.mark.parametrize(
    ("size", "largest", "rms"),
    [((1920, 1080), 0.004, 0.0003), ((1237, 822), 0.009, 0.0006), ((640, 360), 0.032, 0.0022), ((256, 144), 0.12, 0.01)],
)
def test_error_of_the_planes(size, largest, rms):
    """The measured error of a weight made from a plane; it falls with the square of the resolution."""
    foveation = foveation_map(Display(*size), (size[0] / 2, size[1] / 2))
    error = foveation.blend_weights_plane - foveation.blend_weights_exact
    assert 0 < np.abs(error).max() < largest
    assert np.sqrt((error**2).mean()) < rms


def test_plane_starts_at_the_tiles_first_pixel():
    foveation = foveation_map(Display(640, 360), (320, 180))
    ty, tx = np.argwhere(foveation.blend)[0]
    value, slope_x, slope_y = foveation.plane[ty, tx]
    weight = foveation.blend_weights_plane
    assert weight[16 * ty, 16 * tx] == pytest.approx(smoothstep(value))
    assert weight[16 * ty + 9, 16 * tx + 5] == pytest.approx(smoothstep(value + 5 * slope_x + 9 * slope_y))
    assert (foveation.plane[~foveation.blend] == 0).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (5, 3), (17, 16)])
def test_tiny_displays_have_finite_planes_and_bounded_weights(size):
    for fov_deg in (20, 90, 175):
        foveation = foveation_map(Display(*size, fov_deg), (0, 0))
        assert np.isfinite(foveation.plane).all()
        assert ((foveation.blend_weights_plane >= 0) & (foveation.blend_weights_plane <= 1)).all()


def test_without_a_gaze():
    foveation = no_foveation(Display(100, 50))
    assert foveation.tile_level.shape == (4, 7)
    assert not foveation.tile_level.any() and not foveation.blend.any()
    assert not foveation.blend_weights_exact.any() and not foveation.blend_weights_plane.any()


@pytest.mark.parametrize("gaze", [(-0.1, 5), (5, -1), (100.1, 5), (5, 50.5), (math.nan, 5), (math.inf, 5)])
def test_gaze_off_the_display_is_refused(gaze):
    with pytest.raises(InputError, match="off the display"):
        foveation_map(Display(100, 50), gaze)


@pytest.mark.parametrize("arguments", [(0, 5), (5, -1), (5, 5, 0), (5, 5, 180), (5, 5, math.nan)])
def test_impossible_displays_are_refused(arguments):
    with pytest.raises(InputError, match="not accepted"):
        Display(*arguments)


@pytest.mark.parametrize("levels", [0, 5, -1])
def test_impossible_levels_are_refused(levels):
    with pytest.raises(InputError, match="levels are not accepted"):
        foveation_map(Display(64, 64), (1, 1), levels)
