"""The orbit: deterministic, upright, framed, in spite of floaters."""

from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.model import GaussianModel
from golden.scenes.orbit import estimate_up, look_at, orbit_camera, plan_orbit


def object_on_ground(up=(0.0, 0.0, 1.0), floaters=0, seed=0) -> GaussianModel:
    """A box that stands off the middle of a disc of ground, as dense as a capture; floaters are far and transparent."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.random(6000) * 2 * np.pi, 3 * np.sqrt(rng.random(6000))
    ground = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.normal(0, 0.02, 6000)], axis=1)
    box = rng.random((4000, 3)) * [1.2, 0.8, 0.9] + [0.4, -0.4, 0]
    points = np.concatenate([ground, box, rng.normal(size=(floaters, 3)) * 200])
    up = np.array(up)
    east = np.roll(up, 1)
    frame = np.stack([east, np.cross(up, east), up])
    n = len(points)
    opacity = np.full((n, 1), 0.9)
    opacity[len(points) - floaters:] = 0.05
    return GaussianModel(
        means=points @ frame, log_scales=np.full((n, 3), np.log(0.04)), quats=np.tile([1.0, 0, 0, 0], (n, 1)), opacity=opacity,
        sh_dc=np.zeros((n, 1, 3)), sh_rest=np.zeros((n, 0, 3)), quality_bound=np.ones(n, np.uint8), up=up,
    )


def covered(model: GaussianModel, camera, cell=8) -> float:
    """Share of the frame's cells in which a splat centre lies: an own, cruder measure than the planner's."""
    points = model.means @ camera.rotation.T + camera.translation
    x, y = (points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]).T // cell
    columns, rows = camera.width // cell, camera.height // cell
    inside = (points[:, 2] > camera.near) & (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
    return len(np.unique(x[inside] + columns * y[inside])) / (rows * columns)


def test_same_arguments_same_camera():
    model = object_on_ground()
    a, b = (orbit_camera(model, 3, 12, 320, 180) for _ in range(2))
    for key, value in vars(a).items():
        np.testing.assert_array_equal(getattr(b, key), value)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)])
def test_cameras_are_upright_above_and_around(up):
    model = object_on_ground(up)
    orbit = plan_orbit(model)
    positions = []
    for index in range(4):
        camera = orbit_camera(model, index, 4, 320, 180)
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.rotation) == pytest.approx(1)
        assert camera.rotation[1] @ up < -0.9  # the image's y is down
        assert camera.rotation[0] @ up == pytest.approx(0)
        assert (camera.position - orbit.focus) @ up > 0
        np.testing.assert_allclose(camera.rotation @ orbit.focus + camera.translation, [0, 0, orbit.radius], atol=1e-9)
        positions.append(camera.position - orbit.focus)
    level = np.sum(positions, axis=0) * (np.array(up) == 0)
    np.testing.assert_allclose(level, 0, atol=1e-9)


def test_up_can_be_overridden():
    camera = orbit_camera(object_on_ground(), 0, 4, 320, 180, up=np.array([0.0, 2.0, 0.0]))
    assert camera.rotation[0] @ [0, 1, 0] == pytest.approx(0)
    assert camera.rotation[1] @ [0, 1, 0] < -0.9


@pytest.mark.parametrize("floaters", [0, 300])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_views_are_covered_whatever_the_unit_and_the_floaters(floaters, unit):
    model = object_on_ground(floaters=floaters)
    model = replace(model, means=model.means * unit, log_scales=model.log_scales + np.log(unit))
    box = np.array([1.0, 0.0, 0.45]) * unit
    for index in range(6):
        camera = orbit_camera(model, index, 6, 320, 180)
        assert covered(model, camera) >= 0.5
        x, y, z = camera.rotation @ box + camera.translation
        assert z > 0 and abs(camera.fx * x / z) < 80 and abs(camera.fy * y / z) < 45  # the box is in the middle half


def test_radius_can_be_given():
    model = object_on_ground()
    assert plan_orbit(model, radius=7.0).radius == 7.0
    with pytest.raises(ValueError, match="not 0"):
        orbit_camera(model, 0, 0, 320, 180)


@pytest.mark.parametrize("n", [1, 2])
def test_tiny_models_are_framed(n):
    model = object_on_ground().select(np.arange(n))
    camera = orbit_camera(model, 0, 1, 64, 64)
    assert np.isfinite(camera.rotation).all() and (model.means @ camera.rotation[2] + camera.translation[2] > 0).all()


def test_degenerate_and_giant_splats_do_no_harm():
    model = object_on_ground()
    model.log_scales[:50, 1:] = -np.inf
    model.log_scales[50:60] = 60.0
    with np.errstate(all="raise", under="ignore"):
        camera = orbit_camera(model, 0, 4, 320, 180)
    assert np.isfinite(camera.translation).all()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_up_is_told_by_the_ground(axis, sign):
    up = sign * np.eye(3)[axis]
    model = replace(object_on_ground(up), up=np.array([0.0, -1.0, 0.0]))
    if axis == 1:  # the format's own axis: kept with its sign, which is not in doubt there
        up = model.up
    np.testing.assert_array_equal(estimate_up(model).up, up)


def test_up_stays_without_ground():
    model = object_on_ground()
    ball = replace(model, means=np.random.default_rng(1).normal(size=model.means.shape), up=np.array([0.0, -1.0, 0.0]))
    np.testing.assert_array_equal(estimate_up(ball).up, [0, -1, 0])


def test_look_at_projects_the_target_to_the_middle():
    camera = look_at(np.array([1.0, 1, 1]), np.array([0.0, 0, 3]), np.array([0.0, 0, 1]), 100, 50, 90.0)
    np.testing.assert_allclose((camera.rotation @ [0, 0, 3] + camera.translation)[:2], 0, atol=1e-12)
    assert camera.fx == pytest.approx(50) and (camera.cx, camera.cy) == (50, 25)
