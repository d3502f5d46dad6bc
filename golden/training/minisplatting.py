"""Mini-Splatting's densification (Fang and Wang 2024, section 3.2): blur split and depth reinitialisation.

With both and without its simplification, dense training is what that paper calls Mini-Splatting-D, from which the source of
this project's method prunes. Blur split: Gaussians that have the largest share in many pixels of a view are split, because
gradients on the screen miss those that cover a smooth, blurred area. Depth reinitialisation: all Gaussians are replaced by
new ones at the points that the training cameras' pixels show, so that points come to lie evenly on surfaces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import Rendering
from golden.diff.strongest import strongest
from golden.scenes.camera import Camera
from golden.training.initial import initial_gaussians
from golden.training.views import generator

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

BLURRED = 2e-4
"""Share of a frame's pixels beyond which a Gaussian that is the strongest there is split (Fang and Wang)."""

REINITIALISED = (1 / 6, 1 / 3)
"""Shares of the run at which Gaussians are replaced: iterations 5,000 and 10,000 of their 30,000."""


class LargestAreas:
    """For each Gaussian, the largest share of a frame in which it was the strongest, since rows were last added or removed.

    Args:
        points: number of Gaussians.
        device: where to keep the shares.
    """

    def __init__(self, points: int, device: torch.device | str = "cpu") -> None:
        self.share = torch.zeros(points, device=device)

    def observe(self, rendering: Rendering) -> None:
        """Takes note of a rendering made with `usage=True`."""
        pixels = rendering.transmittance.numel()
        found = rendering.dominated.to(self.share) / pixels
        self.share[rendering.index] = torch.maximum(self.share[rendering.index], found)


def chord_centres(gaussians: Gaussians, origin: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """(P, 3) points at which rays from an origin (3,) along (P, 3) directions are deepest in their Gaussians: the middle of the
    chord that an ellipsoid of equal density cuts from the ray, t = d' S^-1 (mean - origin) / d' S^-1 d.

    Args:
        gaussians: P Gaussians, one for each ray.
    """
    w, x, y, z = torch.nn.functional.normalize(gaussians.quats, dim=1).unbind(1)
    rotation = torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1).reshape(-1, 3, 3)
    inverse = torch.exp(-gaussians.log_scales)

    def scaled(vectors: torch.Tensor) -> torch.Tensor:
        return torch.einsum("pij,pi->pj", rotation, vectors) * inverse

    along, to_mean = scaled(directions), scaled(gaussians.means - origin)
    t = (along * to_mean).sum(1) / (along * along).sum(1)
    return origin + t[:, None] * directions


def pixel_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The camera's position (3,) and the directions (H, W, 3) in world axes through its pixels' centres, with a length of 1
    along the camera's axis."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], -1)
    return camera.position, local @ camera.rotation


@torch.no_grad()
def reinitialised(
    gaussians: Gaussians, scene: TrainingScene, points: int, seed: int, counter: int, sh_degree: int = 0,
) -> Gaussians:
    """New round Gaussians at points that pixels of the training views show, in the photographs' colours.

    A pixel's point is where its ray is deepest in its strongest Gaussian. Pixels are drawn with 1 - transmittance as their
    weight, as many from each view; masks' hidden pixels are not drawn.

    Args:
        gaussians: the Gaussians that are replaced.
        scene: the training views.
        points: about how many Gaussians to make.
        seed, counter: of the random numbers.
        sh_degree: see `initial_gaussians`.
    """
    places, colours = [], []
    each = -(-points // len(scene.train))
    own = gaussians.detached().to("cpu")
    for view in scene.train:
        row, opacity = strongest(own, scene.cameras[view])
        weight = np.where(row >= 0, np.clip(opacity, 0.0, 1.0), 0.0).astype(np.float64)
        if scene.masks is not None:
            weight *= scene.masks[view]
        drawable = np.flatnonzero(weight)
        if not len(drawable):
            continue
        probability = weight.ravel()[drawable]
        pixels = generator(seed, f"depth {view}", counter).choice(
            drawable, min(each, len(drawable)), replace=False, p=probability / probability.sum())
        position, directions = pixel_rays(scene.cameras[view])
        rays = torch.from_numpy(directions.reshape(-1, 3)[pixels].astype(np.float32))
        shown = own.select(torch.from_numpy(row.ravel()[pixels]))
        places.append(chord_centres(shown, torch.from_numpy(position.astype(np.float32)), rays).numpy().astype(np.float64))
        colours.append(scene.images[view].reshape(-1, 3)[pixels] / 255)
    found = replace(scene, points=np.concatenate(places), colours=np.concatenate(colours))
    return initial_gaussians(found, seed, max_points=points, sh_degree=sh_degree)
