"""Real captures load whole, stand upright, and their points lie where the photographs show them."""

import time

import numpy as np
import pytest

from golden.scenes.datasets import load_dataset
from golden.scenes.load import load_model
from golden.scenes.orbit import estimate_up, orbit_camera, plan_orbit

pytestmark = pytest.mark.data


@pytest.mark.parametrize(("name", "splats", "degree", "up"), [
    ("truck.splat", 116_544, 0, (0, -1, 0)), ("rock_sh3", 185_761, 3, (0, -1, 0)), ("garden_large", 843_068, 0, (0, 0, 1)),
])
def test_models(data_dir, name, splats, degree, up):
    if not name.endswith(".splat"):
        pytest.importorskip("imagecodecs")
    load_model(data_dir / "trained" / name)  # compiles gsply's readers
    start = time.perf_counter()
    model = load_model(data_dir / "trained" / name)
    assert time.perf_counter() - start < 10
    assert (len(model), model.sh_degree, model.dropped) == (splats, degree, {})
    np.testing.assert_array_equal(model.up, up)
    np.testing.assert_array_equal(estimate_up(model).up, up)
    assert plan_orbit(model).coverage >= 0.6
    camera = orbit_camera(model, 0, 8, 640, 360)
    depth = model.means @ camera.rotation[2] + camera.translation[2]
    assert np.mean(depth > camera.near) > 0.5


def residuals(folder, data, every):
    """(M, 2) pixels from each observed keypoint to its projected point, read from COLMAP's own observations."""
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction(str(folder))
    images = {image.name: image for image in reconstruction.images.values()}
    found = []
    for camera in data.cameras[::every]:
        seen = [p for p in images[camera.name].points2D if p.has_point3D()]
        points = np.array([reconstruction.points3D[p.point3D_id].xyz for p in seen]) @ camera.rotation.T + camera.translation
        found.append(points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy] - [p.xy for p in seen])
    return np.concatenate(found)


def test_bonsai(data_dir):
    folder = data_dir / "posed" / "bonsai"
    offsets = residuals(folder / "sparse" / "0", data := load_dataset(folder), 20)
    assert (len(data), len(data.points), data.cameras[0].name) == (292, 25_512, "DSCF5565.JPG")
    assert np.median(np.abs(offsets)) < 0.3
    assert np.abs(offsets.mean(axis=0)).max() < 0.05  # a pixel centre at integers would show as 0.5
    assert data.photograph(0).shape == (532, 800, 3)


def colour_agreement(data, view, dx=0.0, dy=0.0):
    """Correlation of the points' colours with the photograph's, where they project to, moved by (dx, dy) pixels."""
    camera = data.cameras[view]
    x, y, z = (data.points @ camera.rotation.T + camera.translation).T
    u, v = camera.fx * x / z + camera.cx + dx, camera.fy * y / z + camera.cy + dy
    inside = (z > camera.near) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    pixels = data.photograph(view)[v[inside].astype(int), u[inside].astype(int)]
    return np.corrcoef(pixels.ravel(), data.point_colours[inside].ravel())[0, 1]


def test_fern(data_dir):
    """LLFF's axes, and the pixel: agreement peaks where the points project and falls one pixel away in every direction."""
    data = load_dataset(data_dir / "posed" / "fern")
    assert (len(data), data.photograph(3).shape, len(data.points)) == (20, (378, 504, 3), 10_091)

    def agreement(dx, dy):
        return np.mean([colour_agreement(data, view, dx, dy) for view in range(0, 20, 7)])

    best = agreement(0, 0)
    assert best > 0.55
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        assert agreement(dx, dy) < best - 0.02


def test_garden_sfm(data_dir):
    data = load_dataset(data_dir / "posed" / "garden_sfm.npz")
    assert (len(data), len(data.points), data.images) == (3, 138_766, None)
    for camera in data.cameras:
        x, y, z = (data.points @ camera.rotation.T + camera.translation).T
        ahead = z > camera.near
        u, v = camera.fx * x[ahead] / z[ahead] + camera.cx, camera.fy * y[ahead] / z[ahead] + camera.cy
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        assert ahead.mean() > 0.8 and inside.mean() > 0.5
