"""The embedded scene's cameras and their rays."""

from __future__ import annotations

import math

import numpy as np

from golden.scenes.camera import Camera

FIELD_OF_VIEW_DEG = 64.0
"""Horizontal field of view of the embedded cameras."""

UP = np.array([0.0, 0.0, 1.0])
"""The room's up direction."""

TEST_EVERY = 8
"""Every 8th camera, from camera 0 on, is held out for tests and the others train (the field's habit since Mip-NeRF 360)."""


def look_at(position: np.ndarray, target: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World-to-camera rotation (3, 3) and translation (3,) of an OpenCV camera at `position` that looks at `target`."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ position


def embedded_cameras(width: int = 256, height: int = 256, views: int = 24) -> list[Camera]:
    """Cameras on a ring in the room that look at the table, at varying heights, radii and targets.

    Every TEST_EVERY-th camera is a test camera. Camera 0 stands in the south-east and faces the window.

    Args:
        width: frame width in pixels.
        height: frame height in pixels.
        views: number of cameras, evenly spread around the room.

    Raises:
        ValueError: `views` is below 1.
    """
    if views < 1:
        raise ValueError(f"views must be at least 1, not {views!r}")
    focal = 0.5 * width / math.tan(math.radians(0.5 * FIELD_OF_VIEW_DEG))
    cameras = []
    for k in range(views):
        azimuth = math.radians(-72.0) + 2.0 * math.pi * k / views
        wave = 2.0 * math.pi * 0.381966 * k  # a golden-ratio step, so that height, radius and target do not follow the azimuth
        radius = 1.78 + 0.12 * math.cos(1.7 * wave)
        position = np.array([radius * math.cos(azimuth), radius * math.sin(azimuth), 1.45 + 0.40 * math.sin(wave)])
        target = np.array([0.25 * math.sin(1.3 * wave), 0.15 + 0.2 * math.sin(0.9 * wave), 0.95 + 0.12 * math.sin(2.1 * wave)])
        rotation, translation = look_at(position, target, UP)
        cameras.append(Camera(
            rotation, translation, focal, focal, 0.5 * width, 0.5 * height, width, height, name=f"embedded_{k:02d}"
        ))
    return cameras


def camera_rays(camera: Camera, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(N, 3) unit directions in world axes through image points (x, y) in pixels, each (N,)."""
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(len(x))], axis=1)
    return (local / np.linalg.norm(local, axis=1, keepdims=True)) @ camera.rotation
