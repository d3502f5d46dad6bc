"""The oracle on captured scenes: what small random ones cannot show."""

import os
from pathlib import Path

import numba
import numpy as np
import pytest

from golden.oracle.render import render
from golden.scenes.levels import smfr_levels
from golden.scenes.load import load_model
from golden.scenes.orbit import orbit_camera
from spec.paths import ROOT

DATA = Path(os.environ.get("MSV2_DATA", ROOT.parent / "shared" / "data"))
pytestmark = [pytest.mark.data, pytest.mark.skipif(not DATA.is_dir(), reason=f"no scenes at {DATA} (set MSV2_DATA)")]


@pytest.fixture(scope="module", params=["truck.splat", "rock_sh3"])
def scene(request):
    model = smfr_levels(load_model(DATA / "trained" / request.param))
    return model, orbit_camera(model, 0, 8, 320, 180)


def test_tile_tests_give_one_image(scene):
    model, camera = scene
    exact, box = (render(model, camera, gaze=(100, 90), tile_test=test) for test in ("exact", "obb"))
    assert exact.coverage.mean() > 0.5
    assert (box.tile_intersections >= exact.tile_intersections).all() and box.entries > exact.entries
    assert np.array_equal(box.image, exact.image)
    assert np.array_equal(box.depth, exact.depth, equal_nan=True)


def test_threads_do_not_change_the_frame(scene):
    model, camera = scene
    threads = numba.get_num_threads()
    many = render(model, camera, gaze=(100, 90))
    numba.set_num_threads(1)
    one = render(model, camera, gaze=(100, 90))
    numba.set_num_threads(threads)
    assert np.array_equal(one.image, many.image)


def test_foveation_spares_entries_and_leaves_the_fovea_alone(scene):
    model, camera = scene
    full, foveated = render(model, camera), render(model, camera, gaze=(160, 90))
    fovea = (foveated.foveation.tile_level == 0) & ~foveated.foveation.blend
    assert fovea.any() and foveated.entries < 0.8 * full.entries
    pixels = np.kron(fovea, np.ones((16, 16), bool))[:180, :320]
    assert np.array_equal(foveated.image[pixels], full.image[pixels])
    assert not np.allclose(foveated.image[~pixels], full.image[~pixels])
