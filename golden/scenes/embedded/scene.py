"""The embedded scene: posed images, true depth, surface points and a Gaussian model of a procedural room.

Everything is computed by code, and no file is needed. In this package, `world` has the room's objects, `raytrace` the ray
tracer and `views` the cameras; `patches` and `splats` make the Gaussian model.
"""

from __future__ import annotations

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.embedded.raytrace import MISS, trace
from golden.scenes.embedded.splats import cached_embedded_model, embedded_model
from golden.scenes.embedded.views import TEST_EVERY, UP, camera_rays, embedded_cameras
from golden.scenes.embedded.world import embedded_world

__all__ = [
    "TEST_EVERY", "UP", "cached_embedded_model", "embedded_cameras", "embedded_model", "render_photograph", "render_reference",
    "surface_points",
]


def _sample_offsets(samples: int) -> np.ndarray:
    """(samples, 2) positions inside a pixel: the Hammersley points in base 2, centred on the pixel."""
    index = np.arange(samples)
    radical, digit, scale = np.zeros(samples), index.copy(), 0.5
    while digit.any():
        radical += scale * (digit & 1)
        digit, scale = digit >> 1, 0.5 * scale
    points = np.stack([(index + 0.5) / samples, radical], axis=1)
    return points - points.mean(axis=0) + 0.5


def _pixels(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and ray origins of all pixels."""
    row, column = (axis.ravel() for axis in np.indices((camera.height, camera.width), dtype=float))
    return row, column, np.broadcast_to(camera.position, (len(row), 3))


def render_photograph(camera: Camera, samples: int = 4) -> np.ndarray:
    """Ray-trace the embedded scene.

    Args:
        camera: any camera in the room.
        samples: rays per pixel; every pixel has the same pattern of rays.

    Returns:
        (H, W, 3) float32 in [0, 1], the mean of the samples; display values, to which no gamma is applied.

    Raises:
        ValueError: samples is below 1.
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, not {samples!r}")
    row, column, origin = _pixels(camera)
    total = np.zeros((len(row), 3))
    for dx, dy in _sample_offsets(samples):
        total += trace(embedded_world(), origin, camera_rays(camera, column + dx, row + dy))[3]
    return (total / samples).reshape(camera.height, camera.width, 3).astype(np.float32)


def render_reference(camera: Camera, samples: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """The picture of `render_photograph`, and (H, W) float32, the z depth at the pixels' centres in metres, inf in the sky."""
    row, column, origin = _pixels(camera)
    centre = camera_rays(camera, column + 0.5, row + 0.5)
    z = trace(embedded_world(), origin, centre)[0] * (centre @ camera.rotation[2])
    return render_photograph(camera, samples), z.reshape(camera.height, camera.width).astype(np.float32)


def surface_points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface points such as structure from motion would find: random pixels of the embedded cameras at their true depth.

    Args:
        count: number of points.
        seed: seed of the random pixels.

    Returns:
        points: (N, 3) float64, metres, on visible surfaces, none in the sky.
        colours: (N, 3) float64 in [0, 1], as seen by the camera that the point was drawn from.
        normals: (N, 3) float64, unit, facing that camera.

    Raises:
        ValueError: count is below 1.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count!r}")
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
