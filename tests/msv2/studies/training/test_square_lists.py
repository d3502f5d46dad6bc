"""Intersections by squares of three standard deviations, against the pixels of a mask and against the exact lists."""

from dataclasses import replace

import numpy as np
import pytest

from golden.oracle.project import project
from golden.oracle.tiles import tile_lists
from golden.scenes.camera import Camera
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.model import GaussianModel
from msv2.studies.training.square_lists import square_intersections

FOCAL = 6400.0
CAMERA = Camera(np.eye(3), np.zeros(3), FOCAL, FOCAL, 32.0, 24.0, 64, 48)
"""4x3 tiles, and so narrow a field that Gaussians are projected without perspective."""


def balls(rows: list[tuple[float, float, float, float, float]]) -> GaussianModel:
    """Gaussians as (x px, y px, depth, standard deviations px along x and y)."""
    x, y, z, wide, high = np.array(rows).T
    n = len(rows)
    scales = np.stack([wide, high, wide], 1) / FOCAL * np.abs(z)[:, None]
    return GaussianModel(
        means=np.stack([(x - 32) / FOCAL * z, (y - 24) / FOCAL * z, z], 1), log_scales=np.log(scales),
        quats=np.tile([1.0, 0, 0, 0], (n, 1)), opacity=np.full((n, 1), 0.5), sh_dc=np.zeros((n, 1, 3)),
        sh_rest=np.zeros((n, 0, 3)), quality_bound=np.ones(n, np.uint8), up=np.array([0.0, -1, 0]), name="balls")


@pytest.mark.parametrize(("ball", "tiles"), [
    ((24.5, 24.5, 1.0, 1.0, 1.0), 1),    # sigma^2 = 1.3, and 0.1 under the root: half an edge of 4 px, columns 20..28
    ((33.5, 24.5, 1.0, 1.0, 1.0), 2),    # columns 29..37 meet two tiles
    ((24.5, 24.5, 1.0, 8.0, 0.2), 12),   # a flat needle has a square too: 25 px, all tiles
    ((-6.5, 24.5, 1.0, 1.0, 1.0), 0),    # beside the frame
    ((24.5, 24.5, -1.0, 9.0, 9.0), 0),   # behind the camera
])
def test_known_squares(ball, tiles):
    assert square_intersections(balls([ball]), CAMERA) == tiles
    assert square_intersections(balls([ball, ball]), CAMERA) == 2 * tiles


def test_opacity_is_not_looked_at():
    ball = balls([(33.5, 24.5, 1.0, 1.0, 1.0)])
    assert square_intersections(replace(ball, opacity=np.full((1, 1), 1e-4)), CAMERA) == 2


def test_squares_cover_the_exact_lists():
    """Each exact intersection is one of a square, and a scene has far more of squares."""
    model, camera = cached_embedded_model(3000), embedded_cameras(256, 192)[0]
    splats, _ = project(model, camera, 3.0)
    exact = len(tile_lists(splats, no_foveation(Display(256, 192))).entries)
    squares = square_intersections(model, camera)
    assert 1.3 * exact < squares < 10 * exact
    each = np.array([square_intersections(model.select(np.array([i])), camera) for i in range(0, 3000, 60)])
    for count, i in zip(each, range(0, 3000, 60), strict=True):
        own, _ = project(model.select(np.array([i])), camera, 3.0)
        assert len(tile_lists(own, no_foveation(Display(256, 192))).entries) <= count
