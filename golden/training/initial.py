"""The first Gaussians, from structure from motion's points (3DGS section 5.1)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from golden.diff.gaussians import Gaussians
from golden.scenes.camera import Camera
from golden.scenes.conventions import colour_to_sh_dc
from golden.scenes.model import SH_REST_COUNT
from golden.training.scene import MIN_POINTS, TrainingScene
from spec.errors import InputError

NEIGHBOURS = 3
"""A point's scale is its mean distance to this many nearest neighbours."""

OPACITY = 0.1
"""Every point's opacity (3DGS)."""

WIDEST = 0.1
"""Largest first scale, in shares of the distance to the nearest training camera: a stray point is not a screen-filling blob."""

THINNEST = 1e-5
"""Smallest first scale, in shares of the scene's extent: points on the same spot keep a finite logarithm."""


def initial_gaussians(scene: TrainingScene, seed: int, *, max_points: int | None = None, sh_degree: int = 3) -> Gaussians:
    """Round Gaussians on the scene's points, of their colour, as wide as their neighbours are far.

    Points that no training view has in its frame are dropped: nothing would ever move or remove them. Of more than
    `max_points` a random subset stays.

    Args:
        seed: of that subset.
        max_points: at least 4; None keeps all.
        sh_degree: 0..3 of `sh_rest`, which is zero.

    Raises:
        InputError: the scene has fewer than four points in its training views.
        ValueError: `max_points` or `sh_degree` out of range.
    """
    if max_points is not None and max_points < MIN_POINTS:
        raise ValueError(f"max_points must be at least {MIN_POINTS} or None, not {max_points!r}")
    if sh_degree not in SH_REST_COUNT:
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, not {sh_degree!r}")
    cameras = [scene.cameras[i] for i in scene.train]
    kept = np.flatnonzero(np.logical_or.reduce([_in_frame(scene.points, camera) for camera in cameras]))
    if len(kept) < MIN_POINTS:
        raise InputError(f"{scene.name}: {len(kept)} of {len(scene.points)} points are in view of a training camera; at least "
                         f"{MIN_POINTS} are needed (do points and cameras belong to the same reconstruction?)")
    if max_points is not None and len(kept) > max_points:
        kept = np.sort(np.random.default_rng([seed, len(kept)]).permutation(kept)[:max_points])
    points = scene.points[kept]
    near = cKDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
    eye = cKDTree(np.array([camera.position for camera in cameras])).query(points)[0]
    scale = np.maximum(np.minimum(near, WIDEST * eye), THINNEST * scene.extent)
    n = len(points)
    return Gaussians(
        means=_tensor(points), log_scales=_tensor(np.log(scale))[:, None].repeat(1, 3),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1), opacity=torch.full((n,), float(np.log(OPACITY / (1 - OPACITY)))),
        log_amp=torch.zeros(n), sh_dc=_tensor(colour_to_sh_dc(scene.colours[kept])),
        sh_rest=torch.zeros(n, SH_REST_COUNT[sh_degree], 3))


def _in_frame(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(P,) bool: beyond the near plane and inside the frame."""
    x, y, z = (points @ camera.rotation.T + camera.translation).T
    ahead = z > camera.near
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
