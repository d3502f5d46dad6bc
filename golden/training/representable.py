"""Finds and narrows Gaussians that are so wide that they reach into frames from beyond the guard band, or from near its end.

A Gaussian whose projected centre lies beyond the guard band is not drawn (`spec.guard_band`). Only one that is far to the side
and barely in front of the camera has its centre there, and only a wide one would still meet the frame. So it appears or
disappears at once, as a veil over the whole frame, when a camera turns by a few degrees, and no gradient leads the training to
a model without it. The projection approximates such a splat badly in any case. It is narrowed and not removed, so that cameras
in front of which it lies still see it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.projection import project
from golden.scenes.camera import Camera
from golden.training.scene import TrainingScene
from golden.training.wide_splats import find_candidates
from spec.constants import FRUSTUM_MARGIN, SUPPORT_SIGMA
from spec.guard_band import MEAN_RANGE, UNBOUNDED

SAFETY = 0.25
"""Share of the guard band that the centres of wide splats may use in the known views, because other cameras are rotated by a
few degrees."""

NARROWED = 0.99
"""Scales are narrowed to this share of the widest accepted scale, so that rounding does not leave them too wide."""

FARTHEST = min(-MEAN_RANGE[0], MEAN_RANGE[1])
"""Largest distance in pixels between the frame's corner and a centre."""


class Bounds:
    """The widest scales with which no splat reaches into the views of a scene from near the end of the guard band.

    A splat at camera depth z and x to the side (or up) has its centre at f x / z pixels. Its footprint reaches at most
    SUPPORT_SIGMA f s / z sqrt(1 + t^2) pixels, where s is its largest standard deviation and t the slope to which the
    projection clamps. If s is below x / (SUPPORT_SIGMA sqrt(1 + t^2)), with the larger of both x, the footprint cannot reach
    back into the frame.

    Args:
        scene: the poses of its training and validation views are used; photographs are not read.
    """

    def __init__(self, scene: TrainingScene) -> None:
        self._cameras = [scene.cameras[view] for view in (*scene.train, *scene.validation)]
        shares = [1 / (SUPPORT_SIGMA * math.hypot(1, _clamped_slope(camera))) for camera in self._cameras]
        self._rotations = np.array([camera.rotation for camera in self._cameras], np.float32)
        self._translations = np.array([camera.translation for camera in self._cameras], np.float32)
        self._lenses = np.array([(c.fx, c.fy, c.cx, c.cy, c.near, share)
                                 for c, share in zip(self._cameras, shares, strict=True)], np.float32)

    @torch.no_grad()
    def apply(self, gaussians: Gaussians) -> int:
        """Narrows, in place, the Gaussians that are too wide for some view; returns how many these were."""
        widest = gaussians.log_scales.amax(dim=1).exp()
        limit = torch.full_like(widest, math.inf)
        candidates, cameras = self._candidates(gaussians, widest)
        some, widest = gaussians.select(candidates), widest[candidates]
        for camera in cameras:
            point = _in_camera(some.means, camera)
            accepted = point[:, :2].abs().amax(dim=1) / (SUPPORT_SIGMA * math.hypot(1, _clamped_slope(camera)))
            beyond = (point[:, 2] > camera.near) & _beyond(_centre(point, camera), SAFETY * FARTHEST)
            rows = torch.nonzero(beyond & (widest > accepted)).squeeze(1)
            if len(rows):
                rows = rows[project(some.select(rows), camera, SUPPORT_SIGMA, UNBOUNDED).index]
                limit[candidates[rows]] = torch.minimum(limit[candidates[rows]], NARROWED * accepted[rows])
        wide = int(torch.isfinite(limit).sum())
        if wide:
            gaussians.log_scales.copy_(torch.minimum(gaussians.log_scales, limit.log()[:, None]))
        return wide


    def _candidates(self, gaussians: Gaussians, widest: torch.Tensor) -> tuple[torch.Tensor, list[Camera]]:
        """Rows of the Gaussians that may be too wide for some camera, and those cameras. Of a model's Gaussians these are few;
        to look at them alone takes a tenth of the time."""
        if gaussians.device.type != "cpu":
            return torch.arange(len(gaussians), device=gaussians.device), self._cameras
        found, cameras = np.zeros(len(gaussians), bool), np.zeros(len(self._cameras), bool)
        means = np.ascontiguousarray(gaussians.means.detach().numpy())
        find_candidates(
            means, widest.numpy(), self._rotations, self._translations, self._lenses, SAFETY * FARTHEST, found, cameras)
        return torch.from_numpy(np.flatnonzero(found)), [self._cameras[place] for place in np.flatnonzero(cameras)]


def misplaced(gaussians: Gaussians, scene: TrainingScene, views: Sequence[int]) -> int:
    """Number of splats, over all the views' frames, that would meet the frame if their centre did not lie beyond the guard
    band."""
    with torch.no_grad():
        centres = (project(gaussians, scene.cameras[view], SUPPORT_SIGMA, UNBOUNDED).mean2d for view in views)
        return sum(int(_beyond(each, FARTHEST).sum()) for each in centres)


def _in_camera(means: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N, 3) means in camera axes."""
    rotation, translation = (
        torch.from_numpy(each).to(means.device, torch.float32) for each in (camera.rotation, camera.translation))
    return means @ rotation.T + translation


def _centre(point: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N, 2) centres in pixels."""
    focal, principal = (point.new_tensor(each) for each in ((camera.fx, camera.fy), (camera.cx, camera.cy)))
    return point[:, :2] / point[:, 2:] * focal + principal


def _beyond(centre: torch.Tensor, farthest: float) -> torch.Tensor:
    """(N,) bool: whether a centre is farther than `farthest` pixels along an axis."""
    return (centre.abs() > farthest).any(dim=1)


def _clamped_slope(camera: Camera) -> float:
    """The largest slope at which the Jacobian is evaluated."""
    across = max(camera.cx, camera.width - camera.cx) / camera.fx
    down = max(camera.cy, camera.height - camera.cy) / camera.fy
    return FRUSTUM_MARGIN * max(across, down)
