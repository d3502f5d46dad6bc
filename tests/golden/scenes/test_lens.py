"""Distorted lenses against pycolmap's camera models, and photographs without the distortion."""

from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.camera import Camera
from golden.scenes.lens import COEFFICIENTS, Lens, lens_of, without_distortion
from spec.errors import InputError

CAMERA = Camera(np.eye(3), np.zeros(3), fx=90.0, fy=95.0, cx=48.0, cy=41.0, width=100, height=80, name="photo.jpg")
MODELS = {
    "SIMPLE_RADIAL": {"k1": -0.1}, "RADIAL": {"k1": -0.1, "k2": 0.03},
    "OPENCV": {"k1": 0.1, "k2": -0.05, "p1": 0.01, "p2": -0.02},
    "FULL_OPENCV": dict(zip(COEFFICIENTS, (0.1, -0.05, 0.01, 0.02, 0.01, 0.02, -0.01, 0.005), strict=True)),
}


@pytest.mark.parametrize("model", MODELS)
def test_projection_is_pycolmaps(model):
    pycolmap = pytest.importorskip("pycolmap")
    camera = CAMERA if "OPENCV" in model else replace(CAMERA, fy=CAMERA.fx)
    focal = [camera.fx, camera.fy] if "OPENCV" in model else [camera.fx]
    theirs = pycolmap.Camera(model=model, width=100, height=80, params=[*focal, camera.cx, camera.cy, *MODELS[model].values()])
    rays = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
    want = theirs.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
    np.testing.assert_allclose(lens_of(camera, MODELS[model]).project(rays), want, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_the_pinhole_camera_sees_what_the_lens_saw_and_no_more(model):
    lens = lens_of(CAMERA, MODELS[model])
    pinhole = lens.pinhole()
    assert (pinhole.width, pinhole.height, pinhole.cx, pinhole.cy) == (100, 80, 48.0, 41.0)
    assert pinhole.fx / CAMERA.fx == pytest.approx(pinhole.fy / CAMERA.fy)
    x, y = np.meshgrid(np.linspace(0, 100, 101), np.linspace(0, 80, 81))
    rays = np.stack([(x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy], axis=-1).reshape(-1, 2)
    u, v = lens.project(rays).T
    gap = min(u.min(), v.min(), 100 - u.max(), 80 - v.max())
    assert -1e-3 < gap < 1.5  # the border of the pinhole's frame lies inside the lens's and touches it somewhere


def test_undistorted_pixels_are_those_of_a_pinhole():
    lens = lens_of(CAMERA, MODELS["OPENCV"])
    pinhole = lens.pinhole()

    def picture(rays):
        """A smooth picture of the rays' directions."""
        x, y = rays.reshape(-1, 2).T
        return np.stack([128 + 100 * np.sin(4 * x), 128 + 100 * np.cos(5 * y), 128 + 80 * np.sin(3 * (x + y))], axis=1)

    def rays_of(camera):
        x, y = np.meshgrid(np.arange(100) + 0.5, np.arange(80) + 0.5)
        return np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=-1).reshape(-1, 2)

    goal, found = rays_of(CAMERA), rays_of(CAMERA)
    for _ in range(30):  # inverts the distortion by fixed-point iteration: what the lens's pixels show
        u, v = lens.project(found).T
        found = found + goal - np.stack([(u - 48) / 90, (v - 41) / 95], axis=1)
    seen = np.round(picture(found)).astype(np.uint8).reshape(80, 100, 3)
    want = picture(rays_of(pinhole)).reshape(80, 100, 3)
    got = lens.undistorted(seen, pinhole).astype(float)
    assert np.abs(got - want).max() < 2 < np.abs(seen - want).max()


def test_a_lens_keeps_its_coefficients_when_its_photograph_is_reduced():
    lens = lens_of(CAMERA, MODELS["OPENCV"]).resized(50, 40)
    rays = np.array([[0.1, 0.2], [-0.3, 0.1]])
    np.testing.assert_allclose(lens.project(rays), lens_of(CAMERA, MODELS["OPENCV"]).project(rays) / 2)


def test_lenses_without_distortion_are_none():
    assert lens_of(CAMERA, {"k1": 0.0}) is None
    assert without_distortion([CAMERA], [{}]) == ((CAMERA,), None)
    cameras, lenses = without_distortion([CAMERA, CAMERA], [{}, {"k1": 0.1}])
    assert cameras[0] is CAMERA and cameras[1].fx > CAMERA.fx and lenses[0] is None and isinstance(lenses[1], Lens)


def test_a_lens_that_folds_its_frame_is_refused_by_name():
    with pytest.raises(InputError, match=r"photo\.jpg: the lens's distortion k1 -50 folds"):
        lens_of(CAMERA, {"k1": -50.0}).pinhole()
