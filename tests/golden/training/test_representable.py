"""Splats that reach into frames from beyond the guard band: found, narrowed, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.diff.projection import project  # noqa: E402
from golden.training.representable import FARTHEST, Bounds, misplaced  # noqa: E402
from spec.constants import SUPPORT_SIGMA  # noqa: E402
from spec.guard_band import UNBOUNDED  # noqa: E402
from tests.helpers.training_samples import guarded, same, small_dense, small_scene  # noqa: E402


def beside(camera, across: float, ahead: float, scale: float) -> Gaussians:
    """One opaque ball, `across` to the right of a camera and `ahead` of it, world units."""
    place = np.array([across, 0.0, ahead]) - camera.translation
    n = 1
    return Gaussians(
        torch.from_numpy(camera.rotation.T @ place).float()[None], torch.full((n, 3), float(np.log(scale))),
        torch.tensor([[1.0, 0, 0, 0]]), torch.full((n,), 3.0), torch.zeros(n), torch.zeros(n, 3), torch.zeros(n, 0, 3))


@pytest.fixture(scope="module")
def scene():
    return guarded(small_scene())


def test_a_giant_off_to_the_side_is_narrowed_until_no_frame_lists_it(scene):
    """As on bonsai: so far to the side that its centre lies beyond the guard band, so wide that it would be listed."""
    view = scene.train[0]
    camera = scene.cameras[view]
    giant = beside(camera, 200.0, 0.5, 120.0)
    centre = project(giant, camera, SUPPORT_SIGMA, UNBOUNDED).mean2d
    assert len(centre) == 1 and float(centre.abs().max()) > FARTHEST
    assert not len(project(giant, camera, SUPPORT_SIGMA).index)
    assert misplaced(giant, scene, [view]) == 1
    bounds = Bounds(scene)
    assert bounds.apply(giant) == 1 and bounds.apply(giant) == 0
    assert misplaced(giant, scene, scene.train) == 0
    assert 40 < float(giant.log_scales.exp().max()) < 120


@pytest.mark.parametrize(("across", "ahead", "scale"), [(2.0, 0.5, 1.2), (200.0, 0.5, 5.0), (200.0, -0.5, 120.0)])
def test_what_the_guard_band_holds_is_left_alone(scene, across, ahead, scale):
    """Near ones stay within the range, narrow ones meet no frame from there, and behind a camera nothing is listed."""
    one = replace(scene, train=scene.train[:1], validation=())
    splat = beside(scene.cameras[scene.train[0]], across, ahead, scale)
    before = splat.detached()
    assert Bounds(one).apply(splat) == 0 and same(splat, before)


def test_a_crowd_is_narrowed_as_if_all_were_looked_at(scene, monkeypatch):
    """Of thousands of splats of all sizes around the cameras, the same are narrowed to the same scales, bit for bit, with and
    without the quick search before."""
    rng, n = np.random.default_rng(4), 4000
    crowd = Gaussians(
        torch.from_numpy(rng.normal(0, 30, (n, 3))).float(), torch.from_numpy(rng.normal(1, 2, (n, 3))).float(),
        torch.from_numpy(rng.normal(0, 1, (n, 4))).float(), torch.full((n,), 3.0), torch.zeros(n), torch.zeros(n, 3),
        torch.zeros(n, 0, 3))
    quick, whole = crowd.detached(), crowd.detached()
    bounds = Bounds(scene)
    found = bounds.apply(quick)
    monkeypatch.setattr(bounds, "_candidates", lambda gaussians, widest: (torch.arange(n), bounds._cameras))
    assert bounds.apply(whole) == found > 20 and same(quick, whole)


def test_a_model_without_giants_stays_as_it_is(scene):
    dense = small_dense()
    before = dense.detached()
    assert Bounds(scene).apply(dense) == 0 and same(dense, before)
