"""The default camera shows the subject whole, upright and with nothing before it; judged by positions and by the renderer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.default_camera import Judge, choose_framing, default_camera, fitted
from golden.scenes.eight_cameras import eight_cameras
from golden.scenes.embedded.scene import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.load import load_model
from golden.scenes.model import GaussianModel
from golden.scenes.orientation import find_orientation
from golden.scenes.standpoint import Standpoint, horizontal_axes, standpoint_of
from spec.config import PAPER
from tests.helpers.standing_models import box_on_ground, sign, turned, with_floater

SIZE = (96, 54)


def inside(model: GaussianModel, camera: Camera) -> np.ndarray:
    """(N,) bool: whether a splat's middle is in the frame."""
    x, y, z = (model.means @ camera.rotation.T + camera.translation).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return (z > camera.near) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)


def covered(model: GaussianModel, camera: Camera) -> float:
    """Coverage of the frame by the renderer."""
    frame = pipeline.render(model, camera, config=PAPER, foveation=no_foveation(Display(camera.width, camera.height)))
    return float(1 - frame.transmittance.mean())


def hidden(model: GaussianModel, camera: Camera, depth: float) -> float:
    """Share of the frame that the renderer covers with what is nearer than a depth."""
    near = model.select(model.means @ camera.rotation[2] + camera.translation[2] < depth)
    return covered(near, camera) if len(near) else 0.0


BOX = np.arange(6000, 10000)
RAISED = Rotation.from_rotvec([0.7, 0.4, 0.3])


def cropped(model: GaussianModel) -> GaussianModel:
    """Without the ground beyond 0.8 on one side."""
    return model.select((model.means[:, 0] < 0.8) | (np.arange(len(model)) >= 6000))


@pytest.mark.parametrize("aspect", [SIZE, (54, 96), (64, 64)])
@pytest.mark.parametrize("change", [lambda m: m, lambda m: turned(m, RAISED), cropped], ids=["z up", "turned", "cropped"])
def test_the_object_is_whole_and_free(change, aspect):
    model = change(box_on_ground())
    up = find_orientation(model).up
    found = choose_framing(model, up, aspect=aspect[1] / aspect[0])
    camera = found.standpoint.camera(*aspect)
    box = np.arange(len(model))[-4000:]
    assert inside(model, camera)[box].mean() > 0.99
    assert covered(model, camera) > 0.2
    distance = np.linalg.norm(camera.position - model.means[box].mean(axis=0))
    assert hidden(model, camera, 0.4 * distance) < 0.05
    assert camera.rotation[1] @ up < -0.3 and abs(camera.rotation[0] @ up) < 1e-9


def test_a_floater_before_the_camera_moves_it_elsewhere():
    model = box_on_ground()
    up = np.array([0.0, 0, 1])
    first = choose_framing(model, up).standpoint
    place = first.target + 0.8 * (first.position - first.target)
    blocked = with_floater(model, place, 0.5)
    assert hidden(blocked, first.camera(*SIZE), 0.5 * first.distance) > 0.5
    camera = choose_framing(blocked, up).standpoint.camera(*SIZE)
    distance = np.linalg.norm(camera.position - first.target)
    assert hidden(blocked, camera, 0.4 * distance) < 0.1
    assert inside(blocked, camera)[BOX].mean() > 0.95


@pytest.mark.parametrize("unit", [1e-3, 1e4])
def test_the_unit_does_not_matter(unit):
    model = box_on_ground()
    scaled = replace(model, means=model.means * unit, log_scales=model.log_scales + np.log(unit))
    a, b = (choose_framing(m, np.array([0.0, 0, 1])).standpoint for m in (model, scaled))
    assert b.distance == pytest.approx(unit * a.distance, rel=1e-6) and a.azimuth_deg == b.azimuth_deg


def test_far_floaters_do_not_matter():
    model = box_on_ground()
    rng = np.random.default_rng(5)
    extra = replace(model.select(np.arange(300)), means=rng.normal(size=(300, 3)) * 200, opacity=np.full((300, 1), 0.3))
    arrays = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    noisy = replace(model, **{k: np.concatenate([getattr(model, k), getattr(extra, k)]) for k in arrays})
    camera = choose_framing(noisy, np.array([0.0, 0, 1])).standpoint.camera(*SIZE)
    assert inside(noisy, camera)[BOX].mean() > 0.99


def test_a_room_is_seen_from_inside():
    """As a file without its cameras."""
    model = replace(cached_embedded_model(), up_source="ply")
    camera = default_camera(model, (), *SIZE, up=find_orientation(model).up)
    assert np.abs(camera.position[:2]).max() < 2.3 and 0 < camera.position[2] < 2.6
    assert covered(model, camera) > 0.9 and hidden(model, camera, 0.5) < 0.1


@pytest.mark.parametrize("normal", range(3))
def test_a_sign_is_seen_from_its_face(normal):
    model = sign(normal, "ply")
    camera = choose_framing(model, find_orientation(model).up).standpoint.camera(*SIZE)
    assert abs(camera.rotation[2, normal]) > 0.8 and inside(model, camera).mean() > 0.9


def test_the_estimates_are_those_of_the_renderer():
    """Coverage of forty cameras, near and far. Thinning leaves gaps that a model of few splats does not have, so the coarse
    picture promises too little rather than too much."""
    model, rng = box_on_ground(), np.random.default_rng(7)
    judge = Judge.of(model, SIZE[1] / SIZE[0])
    errors = []
    for _ in range(40):
        numbers = rng.uniform(0, 360), rng.uniform(5, 70), rng.uniform(1, 6)
        point = Standpoint(judge.subject.middle, np.array([0.0, 0, 1]), *numbers)
        errors.append(judge.framing(point).coverage - covered(model, point.camera(*SIZE)))
    assert np.abs(errors).mean() < 0.18 and np.max(errors) < 0.1 and np.min(errors) > -0.35


def test_a_scene_with_cameras_keeps_its_first():
    cameras = embedded_cameras(200, 100)
    camera = default_camera(box_on_ground(), cameras, 64, 64)
    np.testing.assert_array_equal(camera.rotation, cameras[0].rotation)
    assert camera.fx == camera.fy == pytest.approx(cameras[0].fx * 0.32) and (camera.cx, camera.cy) == (32, 32)


def test_another_size_shows_all_that_was_shown():
    camera = replace(embedded_cameras(200, 100)[0], cx=90.0, cy=60.0)
    other = fitted(camera, 150, 300)
    for x, y in ((0, 0), (200, 100)):
        u, v = ((p - c) / f for p, c, f in ((x, camera.cx, camera.fx), (y, camera.cy, camera.fy)))
        assert -1e-9 <= u * other.fx + other.cx <= 150 + 1e-9 and -1e-9 <= v * other.fy + other.cy <= 300 + 1e-9


@pytest.mark.parametrize("up", [[0.0, 0, 1], [0, -1, 0], [0.6, 0, 0.8]])
@pytest.mark.parametrize("elevation", [-90.0, -30.0, 0.0, 45.0, 90.0])
def test_standpoints_and_back(up, elevation):
    point = Standpoint(np.array([1.0, 2, 3]), np.array(up), 77.0, elevation, 4.0, 50.0)
    camera = point.camera(64, 36)
    np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera.rotation @ point.target + camera.translation, [0, 0, 4], atol=1e-9)
    back = standpoint_of(camera, point.target, point.up)
    assert back.elevation_deg == pytest.approx(elevation, abs=1e-5)
    assert (back.distance, back.fov_deg) == pytest.approx((4, 50))
    if abs(elevation) < 89:
        assert back.azimuth_deg == pytest.approx(77)


def test_azimuth_does_not_jump_where_up_is_tilted():
    straight, tilted = horizontal_axes(np.array([0.0, -1, 0])), horizontal_axes(np.array([0.05, -0.998, -0.04]) / 0.99988)
    assert straight[0] @ tilted[0] > 0.99 and straight[1] @ tilted[1] > 0.99


@pytest.mark.parametrize("n", [1, 2, 7])
def test_tiny_models_are_framed(n):
    model = box_on_ground().select(np.arange(n))
    camera = default_camera(model, (), 64, 64)
    assert np.isfinite(camera.rotation).all() and (model.means @ camera.rotation[2] + camera.translation[2] > 0).all()


def test_degenerate_and_giant_splats_do_no_harm():
    model = box_on_ground()
    model.log_scales[:50, 1:] = -np.inf
    model.log_scales[50:60] = 60.0
    assert np.isfinite(default_camera(model, (), 64, 36).translation).all()


def test_eight_cameras_show_the_whole_object():
    model = box_on_ground()
    found = eight_cameras(model, np.array([0.0, 0, 1]))
    assert len(found) == 8 and len({title for title, _ in found}) == 8
    shares = {title: inside(model, framing.standpoint.camera(*SIZE)).mean() for title, framing in found}
    assert shares["whole"] > 0.93 and shares["close"] < shares["default"]
    assert all(hidden(model, f.standpoint.camera(*SIZE), 0.4 * f.standpoint.distance) < 0.2 for _, f in found)


@pytest.mark.data
@pytest.mark.parametrize("change", ["as it is", "turned", "cropped", "z up", "floater"])
def test_truck(data_dir, change):
    """The truck, whose place in the file's axes is known, is whole and free in the default camera's frame."""
    model = load_model(data_dir / "trained" / "truck.splat")
    body = np.flatnonzero((np.abs(model.means - [-0.22, 0.17, 0.16]) < [0.5, 0.25, 0.5]).all(axis=1))
    rotation = {"turned": RAISED, "z up": Rotation.from_rotvec([-np.pi / 2, 0, 0])}.get(change, Rotation.identity())
    changed = turned(model, rotation)
    up = rotation.apply([0.0, -1, 0])
    if change == "floater":
        point = choose_framing(model, find_orientation(model).up).standpoint
        changed = with_floater(changed, point.target + 0.75 * (point.position - point.target), 0.3)
    if change == "cropped":
        kept = np.linalg.norm(model.means - [-0.22, 0.17, 0.16], axis=1) < 0.75
        changed, body = changed.select(kept), np.flatnonzero(np.isin(np.flatnonzero(kept), body))
    orientation = find_orientation(changed)
    assert orientation.up @ up > np.cos(np.radians(12))
    found = choose_framing(changed, orientation.up)
    camera = found.standpoint.camera(160, 90)
    assert inside(changed, camera)[body].mean() > 0.95
    assert hidden(changed, camera, 0.4 * found.standpoint.distance) < 0.1
    assert covered(changed, camera) > 0.25
