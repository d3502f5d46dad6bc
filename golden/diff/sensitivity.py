"""How much an image depends on each Gaussian: sums over its pixels of squared derivatives, for criteria of pruning.

Speedy-Splat (Hanson et al. 2024) sums the squared derivative with respect to a Gaussian's projected value g = exp(-q) at each
pixel. PUP 3D-GS (Hanson et al. 2024) sums outer products of the gradients with respect to the Gaussian's mean and log scales,
which is the Gauss-Newton approximation of the reconstruction error's second derivatives. Both sum over colour channels.

The sums over pixels are made in screen space (`blend_squares`). As each splat comes from one Gaussian, the Jacobian of the
projection brings the sums to world space afterwards, exactly: the derivatives of 5 + 3 numbers with respect to 6 each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from golden.diff.blend_cpu import Blending
from golden.diff.blend_squares import PLACE, PRODUCTS, squares
from golden.diff.gaussians import Gaussians
from golden.diff.pairs import tile_lists
from golden.diff.projection import Projection, check_gaussians, project
from golden.scenes.camera import Camera
from spec.constants import ALPHA_MAX_L1, SUPPORT_SIGMA, TILE

PLACED = 6
"""Numbers of a Gaussian whose gradients `fisher` multiplies: its mean 3 and its log scales 3."""


@dataclass(frozen=True)
class Sensitivity:
    """Sums over the pixels and colour channels of one image, for M projected Gaussians of N.

    Attributes:
        index: (M,) int64 rows of the projected Gaussians, ascending.
        value: (M,) float64 sum of (dI / dg)^2.
        fisher: (M, 6, 6) float64 sum of outer products of dI / d(mean, log scales), in world units; None unless asked for.
    """

    index: torch.Tensor
    value: torch.Tensor
    fisher: torch.Tensor | None


def sensitivity(
    gaussians: Gaussians, camera: Camera, *, alpha_max: float = ALPHA_MAX_L1, background: Sequence[float] = (0.0, 0.0, 0.0),
    support_sigma: float | None = SUPPORT_SIGMA, fisher: bool = True,
) -> Sensitivity:
    """The sensitivities of one image. It is computed on the CPU, also for Gaussians elsewhere; results are on their device.

    Args:
        gaussians, camera, alpha_max, background, support_sigma: as for `render`.
        fisher: whether `Sensitivity.fisher` is wanted.
    """
    check_gaussians(gaussians)
    device, own = gaussians.device, gaussians.detached().to("cpu")
    if fisher:
        own.means.requires_grad_()
        own.log_scales.requires_grad_()
    with torch.enable_grad():
        splats = project(own, camera, support_sigma)
        sums = torch.from_numpy(squares(blended(splats, camera, alpha_max, background), fisher))
        products = _world(own, splats, sums).to(device) if fisher else None
    return Sensitivity(splats.index.to(device), sums[:, 0].to(device), products)


def blended(splats: Projection, camera: Camera, alpha_max: float, background: Sequence[float]) -> Blending:
    """The forward pass of the whole frame."""
    fields = (splats.mean2d, splats.factor, splats.opacity, splats.colour, splats.depth)
    arrays = tuple(np.ascontiguousarray(tensor.detach().numpy()) for tensor in fields)
    q_max, size = splats.q_max.numpy(), (camera.width, camera.height)
    mask = np.ones((-(-camera.height // TILE), -(-camera.width // TILE)), bool)
    lists = tile_lists(arrays[0], arrays[1], q_max, arrays[4], *size, mask)
    return Blending(arrays, q_max, lists, size, alpha_max, tuple(background))


def _world(gaussians: Gaussians, splats: Projection, sums: torch.Tensor) -> torch.Tensor:
    """(M, 6, 6) products of the derivatives with respect to means and log scales, from those in screen space."""
    place = torch.cat([_jacobian(gaussians, splats, splats.mean2d), _jacobian(gaussians, splats, splats.factor)], 1)
    colour = _jacobian(gaussians, splats, splats.colour)
    upper = torch.triu_indices(PLACE, PLACE)
    screen = sums.new_zeros(len(sums), PLACE, PLACE)
    screen[:, upper[0], upper[1]] = screen[:, upper[1], upper[0]] = sums[:, 2 : 2 + PRODUCTS]
    with_colour = sums[:, 2 + PRODUCTS :].reshape(-1, 3, PLACE) @ place
    cross = with_colour.transpose(1, 2) @ colour
    own = sums[:, 1, None, None] * (colour.transpose(1, 2) @ colour)
    return place.transpose(1, 2) @ screen @ place + cross + cross.transpose(1, 2) + own


def _jacobian(gaussians: Gaussians, splats: Projection, numbers: torch.Tensor) -> torch.Tensor:
    """(M, K, 6) float64 derivatives of (M, K) numbers of the splats with respect to their Gaussians' means and log scales."""
    rows = []
    for k in range(numbers.shape[1]):
        one = torch.zeros_like(numbers)
        one[:, k] = 1
        found = torch.autograd.grad(numbers, (gaussians.means, gaussians.log_scales), one, retain_graph=True)
        rows.append(torch.cat([gradient[splats.index] for gradient in found], 1).double())
    return torch.stack(rows, 1)
