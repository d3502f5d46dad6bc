"""The initial Gaussians, made from the points of structure from motion (3DGS section 5.1)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from golden.diff.gaussians import Gaussians
from golden.scenes.conventions import colour_to_sh_dc
from golden.scenes.model import SH_REST_COUNT
from golden.training.random_points import in_frame
from golden.training.scene import MIN_POINTS, TrainingScene
from spec.errors import InputError

NEIGHBOURS = 3
"""A point's scale is its mean distance to this many nearest neighbours."""

OPACITY = 0.1
"""Initial opacity of every point (3DGS)."""

WIDEST = 0.1
"""Largest initial scale, as a share of the distance to the nearest training camera, so that a stray point does not fill the
screen."""

THINNEST = 1e-5
"""Smallest initial scale, as a share of the scene's extent, so that coinciding points have a finite log scale."""


def initial_gaussians(scene: TrainingScene, seed: int, *, max_points: int | None = None, sh_degree: int = 3) -> Gaussians:
    """Round Gaussians at the scene's points, with the points' colours and as wide as the distance to their neighbours.

    Points that lie in no training camera's frame are dropped, because nothing would ever move or remove them. If there are more
    than `max_points`, a random subset is kept.

    Args:
        scene: the scene.
        seed: seed of that subset.
        max_points: at least 4; None keeps all.
        sh_degree: 0..3, the degree of `sh_rest`, which is zero.

    Raises:
        InputError: fewer than four points lie in the training cameras' frames.
        ValueError: `max_points` or `sh_degree` is out of range.
    """
    if max_points is not None and max_points < MIN_POINTS:
        raise ValueError(f"max_points must be at least {MIN_POINTS} or None, not {max_points!r}")
    if sh_degree not in SH_REST_COUNT:
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, not {sh_degree!r}")
    cameras = [scene.cameras[i] for i in scene.train]
    kept = np.flatnonzero(np.logical_or.reduce([in_frame(scene.points, camera) for camera in cameras]))
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


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
