"""A plain differentiable renderer in torch, as research code writes one: dense alphas for each tile, cumulative products,
autograd.

It is written from the oracle's equations alone and shares no arithmetic with `golden.diff.render`. So it is an independent
check of that renderer, and its opponent in the benchmark. Every step is a torch operation, and autograd makes the gradients.
Tensors may be float32 or float64, on any device. It needs some hundred bytes of memory for each pixel and listed splat until
`backward` has ended.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch

from golden.diff.gaussians import Gaussians
from golden.scenes.camera import Camera
from spec.constants import (
    ALPHA_MAX_L1,
    ALPHA_MIN,
    FRUSTUM_MARGIN,
    LOW_PASS,
    SH_C0,
    SH_C1,
    SH_C2,
    SH_C3,
    SUPPORT_SIGMA,
    T_STOP,
    TILE,
)
from spec.guard_band import MEAN_RANGE

MEAN, FACTOR, OPACITY, COLOUR, DEPTH = slice(0, 2), slice(2, 5), slice(5, 6), slice(6, 9), slice(9, 10)
"""Columns of the row that describes a projected splat."""


class ReferenceRendering(NamedTuple):
    """The result: `image` (H, W, 3), not clamped, background included; `depth_sum` (H, W), sum of T alpha z; `transmittance`
    (H, W)."""

    image: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    alpha_max: float = ALPHA_MAX_L1,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    support_sigma: float | None = SUPPORT_SIGMA,
) -> ReferenceRendering:
    """Renders one level; the arguments are those of `golden.diff.render.render`."""
    support = math.inf if support_sigma is None else support_sigma**2 / 2
    splats, reach = _project(gaussians, camera, support)
    entries, counts = _tile_lists(splats[:, MEAN].detach(), reach, camera)
    behind = splats.new_tensor([*background, 0.0, 1.0])
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    steps = torch.arange(TILE, dtype=splats.dtype, device=splats.device) + 0.5
    tiles = []
    for tile, listed in enumerate(splats[entries].split(counts)):
        x = (steps + TILE * (tile % tiles_x)).repeat(TILE)[:, None]
        y = (steps + TILE * (tile // tiles_x)).repeat_interleave(TILE)[:, None]
        tiles.append(_composite(listed, x, y, support, alpha_max, behind))
    grid = torch.stack(tiles).reshape(tiles_y, tiles_x, TILE, TILE, 5).transpose(1, 2)
    frame = grid.reshape(tiles_y * TILE, tiles_x * TILE, 5)[: camera.height, : camera.width]
    return ReferenceRendering(frame[..., :3], frame[..., 3], frame[..., 4])


def _project(gaussians: Gaussians, camera: Camera, support: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Projects the Gaussians beyond the near plane that are not transparent and lie within the guard band, and sorts them
    front to back.

    Returns:
        (M, 10) rows, see the columns above, and (M, 2) half the extent of their footprints in pixels.
    """
    like = gaussians.means
    rotation, translation = like.new_tensor(camera.rotation), like.new_tensor(camera.translation)
    with torch.no_grad():
        x, y, z = (like @ rotation.T + translation).unbind(1)
        across, down, (low, high) = x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy, MEAN_RANGE
        kept = (low < torch.minimum(across, down)) & (torch.maximum(across, down) < high)
        shown = torch.nonzero(kept & (z > camera.near) & (gaussians.amplified_opacity >= ALPHA_MIN)).squeeze(1)
        shown = shown[torch.argsort(z[shown], stable=True)]
    g = gaussians.map(lambda tensor: tensor[shown])
    x, y, z = (g.means @ rotation.T + translation).unbind(1)
    mean2d = torch.stack([x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy], 1)
    axes = _jacobian(x, y, z, camera) @ rotation @ _rotations(g.quats) @ torch.diag_embed(torch.exp(g.log_scales))
    covariance = axes @ axes.transpose(1, 2) + LOW_PASS * torch.eye(2, dtype=like.dtype, device=like.device)
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    # The determinant is computed as a sum of squares, because a difference of products would cancel for needle-shaped splats.
    area = torch.linalg.cross(axes[:, 0], axes[:, 1], dim=1).square().sum(1)
    determinant = area + LOW_PASS * (xx + yy) - LOW_PASS**2
    factor = torch.stack([(yy / determinant).sqrt(), -xy / (yy * determinant).sqrt(), yy.rsqrt()], 1)
    opacity = g.amplified_opacity
    colour = _colour(g, g.means - like.new_tensor(camera.position))
    with torch.no_grad():
        q_max = torch.log(opacity / ALPHA_MIN).clamp(min=0.0, max=support)
        reach = (2 * q_max[:, None] * torch.stack([xx, yy], 1)).sqrt() + 1e-3  # a little more, to allow for rounding
    return torch.cat([mean2d, factor, opacity[:, None], colour, z[:, None]], 1), reach


def _jacobian(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(M, 2, 3) Jacobian of the perspective projection, at x / z and y / z clamped to 3DGS's margin around the frame."""
    margin = FRUSTUM_MARGIN
    sx = (x / z).clamp(-margin * camera.cx / camera.fx, margin * (camera.width - camera.cx) / camera.fx)
    sy = (y / z).clamp(-margin * camera.cy / camera.fy, margin * (camera.height - camera.cy) / camera.fy)
    zero = torch.zeros_like(z)
    rows = [camera.fx / z, zero, -camera.fx * sx / z, zero, camera.fy / z, -camera.fy * sy / z]
    return torch.stack(rows, 1).reshape(-1, 2, 3)


def _rotations(quats: torch.Tensor) -> torch.Tensor:
    """(M, 3, 3) rotations of the wxyz quaternions, which are normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def _colour(g: Gaussians, offset: torch.Tensor) -> torch.Tensor:
    """(M, 3) colours seen along `offset` (M, 3) from the eye; negative colours become 0."""
    x, y, z = torch.nn.functional.normalize(offset, dim=1).unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    basis += [factor * term for factor, term in zip(SH_C2, (
        x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy), strict=True)]
    basis += [factor * term for factor, term in zip(SH_C3, (
        y * (3 * xx - yy), x * y * z, y * (4 * zz - xx - yy), z * (2 * zz - 3 * xx - 3 * yy), x * (4 * zz - xx - yy),
        z * (xx - yy), x * (xx - 3 * yy)), strict=True)]
    count = g.sh_rest.shape[1]
    rest = torch.einsum("nk,nkc->nc", torch.stack(basis[:count], 1), g.sh_rest) if count else 0.0
    return (SH_C0 * g.sh_dc + 0.5 + rest).clamp(min=0.0)


@torch.no_grad()
def _tile_lists(mean2d: torch.Tensor, reach: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, list[int]]:
    """Rows of the splats whose bounding box meets each tile, tile after tile, and the number of splats in each tile."""
    low, high = mean2d - reach, mean2d + reach
    entries = []
    for top in range(0, camera.height, TILE):
        row = torch.nonzero((high[:, 1] >= top) & (low[:, 1] <= top + TILE)).squeeze(1)
        for left in range(0, camera.width, TILE):
            entries.append(row[(high[row, 0] >= left) & (low[row, 0] <= left + TILE)])
    return torch.cat(entries), [len(entry) for entry in entries]


def _composite(
    listed: torch.Tensor, x: torch.Tensor, y: torch.Tensor, support: float, alpha_max: float, behind: torch.Tensor,
) -> torch.Tensor:
    """(pixels, 5): red, green, blue, sum of T alpha z and T of the splats `listed` (n, 10), front to back.

    Args:
        x, y: (pixels, 1) pixel centres.
        behind: (5,) the vector that is added with the remaining transmittance as its weight.
    """
    if not len(listed):
        return behind.expand(len(x), 5)
    mean, factor = listed[:, MEAN], listed[:, FACTOR]
    dx, dy = x - mean[:, 0], y - mean[:, 1]
    falloff = 0.5 * ((factor[:, 0] * dx + factor[:, 1] * dy).square() + (factor[:, 2] * dy).square())
    alpha = (listed[:, OPACITY].T * torch.exp(-falloff)).clamp(max=alpha_max)
    alpha = torch.where((alpha >= ALPHA_MIN) & (falloff <= support), alpha, 0.0)
    after = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    running = before >= T_STOP  # the splat that makes a pixel stop is still composited
    weight = torch.where(running, before * alpha, 0.0)
    left = after.gather(1, running.sum(1, keepdim=True) - 1)
    shown = weight @ listed[:, COLOUR.start : DEPTH.stop]
    return torch.cat([shown, torch.zeros_like(left)], 1) + left * behind
