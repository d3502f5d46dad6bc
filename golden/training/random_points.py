"""Random points where there are none of structure from motion: in the volume that the training cameras have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from golden.scenes.camera import Camera

COUNT = 10_000
"""Number of random points."""

COMMON = 0.5
"""A random point lies in the frames of at least this share of the training cameras. The share is halved until there are such
points."""

BATCH = 40_000
"""Points that are drawn at a time."""

BATCHES = 8
"""Batches that are drawn before the share is halved."""

DEPTHS = (0.5, 2.0)
"""Nearest and farthest depth, relative to the cameras' distance from the point that they look at."""

PARALLEL_DEPTHS = (1.0, 40.0)
"""The same, relative to the extent of the cameras' positions, for cameras that look at no common point."""

PARALLEL = 0.01
"""Cameras look at a common point if the mean squared sine of the angles between their axes exceeds this (6 degrees)."""


def random_points(
    cameras: Sequence[Camera], images: np.ndarray, depths: tuple[float, float] | None = None, count: int = COUNT, seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Points in the volume that the cameras have in common, each in the colour of a pixel that it is seen through.

    A point lies on the ray of a random pixel of a random camera. Its depth lies between the data set's bounds or those guessed
    from the cameras. It is drawn evenly in disparity, because that is how depth shows in a frame.

    Args:
        cameras: the training cameras.
        images: (V, H, W, 3) uint8, their photographs.
        depths: nearest and farthest depth in world units, as LLFF gives them; None: guessed from the cameras.
        count: number of points.
        seed: seed of everything drawn.

    Returns:
        (count, 3) float64 points in world units, and their (count, 3) float64 colours in 0..1.
    """
    near, far = depths if depths is not None else depths_from(cameras)
    random, share = np.random.default_rng(seed), COMMON
    points, colours = np.empty((0, 3)), np.empty((0, 3))
    for batch in range(1, 64 * BATCHES):
        drawn, seen = _drawn(cameras, images, near, far, random)
        common = sum(in_frame(drawn, camera).astype(int) for camera in cameras) >= math.ceil(share * len(cameras))
        points, colours = np.concatenate([points, drawn[common]]), np.concatenate([colours, seen[common]])
        if len(points) >= count:
            break
        if batch % BATCHES == 0:
            share /= 2
    return points[:count], colours[:count]


def _drawn(
    cameras: Sequence[Camera], images: np.ndarray, near: float, far: float, random: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """BATCH points on rays through random pixels of random cameras, and these pixels' colours in 0..1."""
    which = random.integers(len(cameras), size=BATCH)
    at, share = random.random((BATCH, 2)), random.random(BATCH)
    depth = 1 / (share / near + (1 - share) / far)
    points, colours = np.empty((BATCH, 3)), np.empty((BATCH, 3))
    for index, camera in enumerate(cameras):
        mine = which == index
        x, y = at[mine].T * [[camera.width], [camera.height]]
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(len(x))], axis=1)
        points[mine] = camera.position + (depth[mine, None] * rays) @ camera.rotation
        colours[mine] = images[index][y.astype(int), x.astype(int)] / 255
    return points, colours


def depths_from(cameras: Sequence[Camera]) -> tuple[float, float]:
    """Nearest and farthest depth at which cameras with no further data are likely to see something.

    The point that the cameras look at is the nearest one to all their axes. Where axes are nearly parallel, or that point is
    behind the cameras, the positions' extent gives the scale instead.
    """
    axes, positions = (np.array([getattr(camera, name) for camera in cameras]) for name in ("rotation", "position"))
    axes = axes[:, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] > PARALLEL * len(cameras):
        focus = np.linalg.solve(total, np.einsum("vij,vj->i", across, positions))
        distance = float(np.median(((focus - positions) * axes).sum(axis=1)))
        if distance > 0:
            return DEPTHS[0] * distance, DEPTHS[1] * distance
    extent = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()) or 1.0
    return PARALLEL_DEPTHS[0] * extent, PARALLEL_DEPTHS[1] * extent


def in_frame(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(P,) bool: whether the point lies beyond the near plane and inside the frame."""
    x, y, z = (points @ camera.rotation.T + camera.translation).T
    ahead = z > camera.near
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
