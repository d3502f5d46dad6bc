"""Gaussians that the machine cannot place: so wide that they reach into frames that their centre lies far beyond.

A centre beyond the range of `mean2d` saturates, and what such a splat shows is then somewhere else. Only a splat far off to the
side, hardly before the camera, has its centre there, and only a wide one still meets the frame. The projection of such a splat
is a bad approximation anyway. It is narrowed, not removed: from where it lies before a camera it shows what it did.
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
"""Share of the range of `mean2d` that centres may use in the views at hand: views to come are turned by a few degrees."""

NARROWED = 0.99
"""Share of the widest accepted scale that is left: what was narrowed is not too wide by a rounding error."""

MEAN2D = PAPER.formats.mean2d
FARTHEST = float(min(-MEAN2D.to_float(MEAN2D.raw_min), MEAN2D.to_float(MEAN2D.raw_max)))
"""Pixels from the frame's corner that a centre may lie at."""


class Bounds:
    """The widest scales that the machine can place in the views of a scene.

    A splat at camera depth z and x to the side, or up, has its centre at f x / z pixels. Its footprint reaches at most
    SUPPORT_SIGMA f s / z sqrt(1 + t^2) pixels, s its largest standard deviation and t the slope that projection clamps to:
    below 1 / (SUPPORT_SIGMA sqrt(1 + t^2)) of the larger x, s cannot bring it back into the frame.

    Args:
        scene: its training and validation views' poses are looked from; photographs are not read.
    """

    def __init__(self, scene: TrainingScene) -> None:
        self._cameras = [scene.cameras[view] for view in (*scene.train, *scene.validation)]

    @torch.no_grad()
    def apply(self, gaussians: Gaussians) -> int:
        """Narrows what some view cannot place, in place; how many Gaussians that were."""
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
    """How many splats of all the views' frames have a centre that `mean2d` cannot hold."""
    with torch.no_grad():
        centres = (project(gaussians, scene.cameras[view], SUPPORT_SIGMA).mean2d for view in views)
        return sum(int(_beyond(each, FARTHEST).sum()) for each in centres)


def _in_camera(means: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N, 3) the means in camera axes."""
    rotation, translation = (
        torch.from_numpy(each).to(means.device, torch.float32) for each in (camera.rotation, camera.translation))
    return means @ rotation.T + translation


def _centre(point: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N, 2) pixels."""
    focal, principal = (point.new_tensor(each) for each in ((camera.fx, camera.fy), (camera.cx, camera.cy)))
    return point[:, :2] / point[:, 2:] * focal + principal


def _beyond(centre: torch.Tensor, farthest: float) -> torch.Tensor:
    """(N,) bool."""
    return (centre.abs() > farthest).any(dim=1)


def _clamped_slope(camera: Camera) -> float:
    """The largest slope that the Jacobian is taken at."""
    across = max(camera.cx, camera.width - camera.cx) / camera.fx
    down = max(camera.cy, camera.height - camera.cy) / camera.fy
    return FRUSTUM_MARGIN * max(across, down)
