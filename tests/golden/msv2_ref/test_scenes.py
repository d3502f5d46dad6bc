"""The integer renderer on captured scenes: 60 dB to the oracle, which gets the same blend planes."""

import numpy as np
import pytest

from golden.metrics.image import psnr_vs
from golden.msv2_ref.pipeline import render
from golden.oracle.render import render as oracle
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.levels import smfr_levels
from golden.scenes.load import load_model
from golden.scenes.orbit import orbit_camera

pytestmark = pytest.mark.data
SIZE = (320, 180)


@pytest.fixture(scope="module", params=["truck.splat", "rock_sh3", "garden_large"])
def scene(request, data_dir):
    model = smfr_levels(load_model(data_dir / "trained" / request.param))
    return model, orbit_camera(model, 0, 8, *SIZE)


@pytest.mark.parametrize("gaze", [None, (0.4, 0.6)], ids=["plain", "gaze"])
def test_image_and_depth_are_the_oracles(scene, gaze):
    model, camera = scene
    foveation = None if gaze is None else foveation_map(Display(*SIZE), (gaze[0] * SIZE[0], gaze[1] * SIZE[1]))
    ours = render(model, camera, foveation=foveation)
    exact = oracle(model, camera, foveation=foveation, weights="plane")
    assert exact.coverage.mean() > 0.5
    assert psnr_vs(ours.image, exact.image) >= 60
    valid = ~np.isnan(exact.depth) & ~np.isnan(ours.depth)
    assert valid.mean() > 0.4 and (np.isnan(exact.depth) != np.isnan(ours.depth)).mean() < 0.002
    assert np.percentile(np.abs(ours.depth / exact.depth - 1)[valid], 99) < 0.002
