"""The embedded scene: posed images, true depth and surface points of a procedural room, without any file.

The room stands in `embedded_world`, its Gaussian model in `embedded_splats`; this is the camera's side of it.
"""

from __future__ import annotations

import math

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.embedded_world import embedded_world
from golden.scenes.raytrace import MISS, trace

FIELD_OF_VIEW_DEG = 64.0
"""Horizontal field of view of the embedded cameras."""

UP = np.array([0.0, 0.0, 1.0])
"""The room's up direction."""

TEST_EVERY = 8
"""Every 8th view, from view 0, is held out for tests; the rest train (the field's habit since Mip-NeRF 360)."""


def look_at(position: np.ndarray, target: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World-to-camera rotation (3, 3) and translation (3,) of an OpenCV camera at `position` that faces `target`."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ position


def embedded_cameras(width: int = 256, height: int = 256, views: int = 24) -> list[Camera]:
    """Cameras on a ring in the room that look at the table, at changing heights, radii and aims.

    Every TEST_EVERY-th view is a test view. View 0 stands in the south-east and faces the window.

    Args:
        width: frame width in pixels.
        height: frame height in pixels.
        views: number of cameras, evenly spread around the room.
    """
    if views < 1:
        raise ValueError(f"views must be at least 1, not {views!r}")
    focal = 0.5 * width / math.tan(math.radians(0.5 * FIELD_OF_VIEW_DEG))
    cameras = []
    for k in range(views):
        azimuth = math.radians(-72.0) + 2.0 * math.pi * k / views
        wave = 2.0 * math.pi * 0.381966 * k  # the golden ratio keeps height, radius and aim out of step with the azimuth
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


def _sample_offsets(samples: int) -> np.ndarray:
    """(samples, 2) positions inside a pixel: the Hammersley points in base 2, centred on the pixel."""
    index = np.arange(samples)
    radical, digit, scale = np.zeros(samples), index.copy(), 0.5
    while digit.any():
        radical += scale * (digit & 1)
        digit, scale = digit >> 1, 0.5 * scale
    points = np.stack([(index + 0.5) / samples, radical], axis=1)
    return points - points.mean(axis=0) + 0.5


def render_reference(camera: Camera, samples: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Ray-trace the embedded scene.

    Args:
        camera: any camera in the room.
        samples: rays per pixel for the colour, the same pattern in each pixel.

    Returns:
        image: (H, W, 3) float32 in [0, 1], as displayed (no further gamma): the mean of the samples.
        depth: (H, W) float32, z depth of the pixel's centre in metres, inf in the sky.
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, not {samples!r}")
    row, column = (axis.ravel() for axis in np.indices((camera.height, camera.width), dtype=float))
    origin = np.broadcast_to(camera.position, (len(row), 3))
    total = np.zeros((len(row), 3))
    for dx, dy in _sample_offsets(samples):
        total += trace(embedded_world(), origin, camera_rays(camera, column + dx, row + dy))[3]
    centre = camera_rays(camera, column + 0.5, row + 0.5)
    z = trace(embedded_world(), origin, centre)[0] * (centre @ camera.rotation[2])
    image = (total / samples).reshape(camera.height, camera.width, 3)
    return image.astype(np.float32), z.reshape(camera.height, camera.width).astype(np.float32)


def surface_points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What structure from motion would find: random pixels of the embedded cameras at their true depth.

    Args:
        count: number of points.
        seed: of the pixels drawn.

    Returns:
        points: (N, 3) float64, metres, on visible surfaces, none in the sky.
        colours: (N, 3) float64 in [0, 1], as seen by the camera that the point was drawn from.
        normals: (N, 3) float64, unit, facing that camera.
    """
    rng = np.random.default_rng(seed)
    cameras = embedded_cameras()
    found: list[tuple[np.ndarray, ...]] = []
    while sum(len(batch[0]) for batch in found) < count:
        which = rng.integers(len(cameras), size=count)
        at = rng.random((count, 2)) * (cameras[0].width, cameras[0].height)
        origin, direction = np.empty((count, 3)), np.empty((count, 3))
        for k, camera in enumerate(cameras):
            mine = which == k
            origin[mine] = camera.position
            direction[mine] = camera_rays(camera, at[mine, 0], at[mine, 1])
        distance, primitive, normal, colour = trace(embedded_world(), origin, direction)
        hit = primitive != MISS
        found.append(((origin + distance[:, None] * direction)[hit], colour[hit], normal[hit]))
    points, colours, normals = (np.concatenate(arrays)[:count] for arrays in zip(*found, strict=True))
    return points, colours, normals
