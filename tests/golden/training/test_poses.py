"""Interpolated poses: where they are, what they show, and what the gates of levels make of them."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.render import render  # noqa: E402
from golden.metrics.hvsq import Hvsq  # noqa: E402
from golden.scenes.camera import Camera  # noqa: E402
from golden.scenes.pictures import to_bytes  # noqa: E402
from golden.training.efficiency import without_lowest  # noqa: E402
from golden.training.foveated import FoveatedModel  # noqa: E402
from golden.training.levels import LevelOptions, LevelStage  # noqa: E402
from golden.training.poses import between, interpolated_cameras, with_poses  # noqa: E402
from tests.helpers.training_samples import small_dense, small_scene  # noqa: E402


def camera(turn_deg: float, position: tuple[float, float, float]) -> Camera:
    """Turned about the y axis."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return Camera(rotation, -rotation @ np.array(position), 100.0, 100.0, 32.0, 32.0, 64, 64)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def dense():
    return small_dense()


def test_half_way():
    half = between(camera(10.0, (0.0, 0.0, 1.0)), camera(40.0, (2.0, 4.0, 1.0)))
    expected = camera(25.0, (1.0, 2.0, 1.0))
    assert np.allclose(half.rotation, expected.rotation) and np.allclose(half.position, expected.position)
    assert (half.fx, half.width) == (100.0, 64)


def test_neighbours_are_near_and_look_the_same_way():
    """Of four cameras, the second is nearest to the first but looks away; the last has no neighbour at all."""
    cameras = [camera(0.0, (0.0, 0, 0)), camera(90.0, (0.1, 0, 0)), camera(5.0, (1.0, 0, 0)), camera(200.0, (0.2, 0, 0))]
    found = interpolated_cameras(cameras, 4)
    assert len(found) == 1 and np.allclose(found[0].position, [0.5, 0, 0])
    many = [camera(float(i), (float(i), 0, 0)) for i in range(100)]
    spread = [each.position[0] for each in interpolated_cameras(many, 16)]
    assert len(spread) == 16 and min(spread) < 7 and max(spread) > 92


def test_poses_are_further_views_that_the_dense_model_shows(scene, dense):
    masks = np.zeros((len(scene), 64, 64), bool)
    posed, views = with_poses(replace(scene, masks=masks), dense, 6)
    assert views == tuple(range(len(scene), len(scene) + len(views))) and 3 <= len(views) <= 6
    assert (posed.train, posed.validation, posed.test) == (scene.train, scene.validation, scene.test)
    train = np.array([scene.cameras[view].position for view in scene.train])
    for view in views:
        assert np.array_equal(posed.images[view], to_bytes(render(dense, posed.cameras[view]).image.numpy()))
        assert posed.masks[view].all() and np.linalg.norm(train - posed.cameras[view].position, axis=1).min() > 0
    alone = replace(scene, train=scene.train[:1])
    assert with_poses(alone, dense, 6) == (alone, ())


def gate_views(stage):
    """The stage's scene with poses, its photographs and its poses."""
    return stage._judged, stage._gate_views[: stage._photographs], stage._gate_views[stage._photographs :]


def mean_hvsq(scene, model, views, pooling, alpha_max):
    values = [float(Hvsq(scene.photograph(view), pooling, "blocks")(
        render(model, scene.cameras[view], alpha_max=alpha_max).image.clamp(0, 1))) for view in views]
    return np.array(values)


def test_levels_are_held_on_poses_too(scene, dense):
    """The gate is the worse of photographs and poses; a pose's HVSQ is that to the dense model plus the dense model's own."""
    options = LevelOptions(iterations=10, poses=6)
    level1 = dense.select(without_lowest(dense.opacity, 200))
    stage = LevelStage(scene, FoveatedModel(level1), 1, options, posed=dense)
    thinner = level1.select(without_lowest(level1.opacity, 150))
    stage._training = LevelStage(scene, FoveatedModel(thinner), 1, options)._training
    judged, photographs, poses = gate_views(stage)
    own = {pooling: mean_hvsq(judged, dense, photographs, pooling, 0.99).mean() for pooling in (1.0, 3.0)}
    ratios = []
    for views, missing in ((photographs, {1.0: 0.0, 3.0: 0.0}), (poses, own)):
        level = mean_hvsq(judged, thinner, views, 3.0, 1.0) + missing[3.0]
        each = level / (mean_hvsq(judged, level1, views, 1.0, 0.99) + missing[1.0])
        ratios.append(each.mean() + each.std(ddof=1) / np.sqrt(len(each)))
    assert len(poses) >= 3
    assert stage._look().hvsq / stage.target == pytest.approx(max(ratios), rel=1e-4)
    assert stage.target == pytest.approx(mean_hvsq(scene, level1, photographs, 1.0, 0.99).mean(), rel=1e-4)


def test_a_level_with_poses_resumes(scene, dense):
    options = LevelOptions(iterations=8, interval=2, poses=4)
    whole, first, second = (LevelStage(scene, FoveatedModel(dense), 1, options, posed=dense) for _ in range(3))
    for _ in range(8):
        whole.step()
    for _ in range(3):
        first.step()
    second.load(first.state())
    for _ in range(5):
        second.step()
    assert second.history == whole.history and second.result().counts == whole.result().counts
