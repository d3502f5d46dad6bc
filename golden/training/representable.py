"""Finds and narrows Gaussians that the machine cannot place: they are so wide that they reach into frames far from their
centre.

A centre beyond the range of `mean2d` saturates, and the splat then appears somewhere else. Only a splat that is far to the side
and barely in front of the camera has its centre there, and only a wide one still meets the frame. The projection approximates
such a splat badly in any case. It is narrowed and not removed, so that cameras in front of which it lies still see it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from golden.diff.gaussians import Gaussians
from golden.diff.projection import project
from golden.scenes.camera import Camera
from golden.training.scene import TrainingScene
from spec.config import PAPER
from spec.constants import FRUSTUM_MARGIN, SUPPORT_SIGMA

SAFETY = 0.25
"""Share of the range of `mean2d` that centres may use in the known views, because other cameras are rotated by a few
degrees."""

NARROWED = 0.99
"""Scales are narrowed to this share of the widest accepted scale, so that rounding does not leave them too wide."""

MEAN2D = PAPER.formats.mean2d
FARTHEST = float(min(-MEAN2D.to_float(MEAN2D.raw_min), MEAN2D.to_float(MEAN2D.raw_max)))
"""Largest distance in pixels between the frame's corner and a centre."""


class Bounds:
    """The widest scales that the machine can place in the views of a scene.

    A splat at camera depth z and x to the side (or up) has its centre at f x / z pixels. Its footprint reaches at most
    SUPPORT_SIGMA f s / z sqrt(1 + t^2) pixels, where s is its largest standard deviation and t the slope to which the
    projection clamps. If s is below x / (SUPPORT_SIGMA sqrt(1 + t^2)), with the larger of both x, the footprint cannot reach
    back into the frame.

    Args:
        scene: the poses of its training and validation views are used; photographs are not read.
    """

    def __init__(self, scene: TrainingScene) -> None:
        self._cameras = [scene.cameras[view] for view in (*scene.train, *scene.validation)]

    @torch.no_grad()
    def apply(self, gaussians: Gaussians) -> int:
        """Narrows, in place, the Gaussians that some view cannot place; returns how many these were."""
        widest = gaussians.log_scales.amax(dim=1).exp()
        limit = torch.full_like(widest, math.inf)
        for camera in self._cameras:
            point = _in_camera(gaussians.means, camera)
            accepted = point[:, :2].abs().amax(dim=1) / (SUPPORT_SIGMA * math.hypot(1, _clamped_slope(camera)))
            beyond = (point[:, 2] > camera.near) & _beyond(_centre(point, camera), SAFETY * FARTHEST)
            rows = torch.nonzero(beyond & (widest > accepted)).squeeze(1)
            if len(rows):
                rows = rows[project(gaussians.select(rows), camera, SUPPORT_SIGMA).index]
                limit[rows] = torch.minimum(limit[rows], NARROWED * accepted[rows])
        wide = int(torch.isfinite(limit).sum())
        if wide:
            gaussians.log_scales.copy_(torch.minimum(gaussians.log_scales, limit.log()[:, None]))
        return wide


def misplaced(gaussians: Gaussians, scene: TrainingScene, views: Sequence[int]) -> int:
    """Number of splats, over all the views' frames, whose centre `mean2d` cannot hold."""
    with torch.no_grad():
        centres = (project(gaussians, scene.cameras[view], SUPPORT_SIGMA).mean2d for view in views)
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
