"""What the host computes for a frame's registers: the depths of the points that a camera sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.registers import depth_far, depths_in_view
from golden.scenes.camera import Camera
from spec.constants import DEPTH_FRAME_MARGIN
from tb.top.stimuli import camera_of

ORIGIN = np.array([0.3, -0.2, 0.1])


def turned(seed: int = 1) -> Camera:
    """A camera whose axes are not those of the world, and whose principal point is not in the middle."""
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return replace(camera_of(150, 50), rotation=axes * np.sign(np.linalg.det(axes)), translation=np.array([0.5, -1.0, 2.0]),
                   cx=70.0, cy=21.0)


def points_at(camera: Camera, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(N, 3): points relative to ORIGIN that the camera sees at pixel (x, y) and depth z."""
    seen = np.stack([(x - camera.cx) / camera.fx * z, (y - camera.cy) / camera.fy * z, z], axis=1)
    return (seen - camera.translation) @ camera.rotation - ORIGIN


def test_points_of_the_widened_frame_give_their_depths_in_order():
    camera, rng = turned(), np.random.default_rng(2)
    wide, high = DEPTH_FRAME_MARGIN * camera.width, DEPTH_FRAME_MARGIN * camera.height
    x, y = rng.uniform(-3 * wide, camera.width + 3 * wide, 500), rng.uniform(-3 * high, camera.height + 3 * high, 500)
    z = rng.uniform(-3.0, 8.0, 500) + camera.near
    inside = (x > -wide) & (x < camera.width + wide) & (y > -high) & (y < camera.height + high) & (z > camera.near)
    assert 30 < inside.sum() < 470
    assert depths_in_view(points_at(camera, x, y, z), ORIGIN, camera) == pytest.approx(z[inside], rel=1e-9)


@pytest.mark.parametrize("edge", ["left", "right", "top", "bottom"])
def test_each_edge_of_the_widened_frame_divides_points(edge: str):
    camera = turned()
    wide, high = DEPTH_FRAME_MARGIN * camera.width, DEPTH_FRAME_MARGIN * camera.height
    x, y = np.full(2, camera.width / 2), np.full(2, camera.height / 2)
    if edge in ("left", "right"):
        x = np.array([-1e-3, 1e-3]) + (-wide if edge == "left" else camera.width + wide)
    else:
        y = np.array([-1e-3, 1e-3]) + (-high if edge == "top" else camera.height + high)
    kept = 3.0 if edge in ("left", "top") else 2.0
    assert depths_in_view(points_at(camera, x, y, np.array([2.0, 3.0])), ORIGIN, camera) == pytest.approx([kept])


def test_points_exactly_on_an_edge_are_outside():
    """A camera at the origin whose pixels are a world unit wide at depth 1; also the near plane."""
    camera = replace(camera_of(100, 60), rotation=np.eye(3), translation=np.zeros(3), fx=1.0, fy=1.0, cx=0.0, cy=0.0, near=0.5)
    least, most = -DEPTH_FRAME_MARGIN, 1 + DEPTH_FRAME_MARGIN
    edges = [(least * 100, 30, 1), (most * 100, 30, 1), (50, least * 60, 1), (50, most * 60, 1), (25, 15, 0.5)]
    assert len(depths_in_view(np.array(edges), np.zeros(3), camera)) == 0
    steps = np.array([(1e-9, 0, 0), (-1e-9, 0, 0), (0, 1e-9, 0), (0, -1e-9, 0), (0, 0, 1e-9)])
    assert len(depths_in_view(edges + steps, np.zeros(3), camera)) == 5


def test_depth_saturates_beyond_what_the_camera_sees():
    camera = turned()
    middle = np.full(100, camera.width / 2), np.full(100, camera.height / 2)
    z = np.linspace(1.0, 4.0, 100)
    seen = points_at(camera, *middle, z)
    far_away = points_at(camera, np.array([-5.0 * camera.width]), np.array([0.0]), np.array([900.0]))
    found = depth_far(seen, ORIGIN, camera)
    assert found == pytest.approx(4.0) and depth_far(np.concatenate([seen, far_away]), ORIGIN, camera) == found
    assert depth_far(far_away, ORIGIN, camera) == 2 * camera.near
