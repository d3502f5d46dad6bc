"""An independent differentiable renderer: plain torch in float64, every splat against every pixel, straight from formulas."""

from __future__ import annotations

import math

import torch

from golden.diff.gaussians import Gaussians
from golden.scenes.camera import Camera
from spec.constants import SH_C0, SH_C1, SH_C2, SH_C3


def rotations(quats: torch.Tensor) -> torch.Tensor:
    """(N, 3, 3) of wxyz quaternions."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    return torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1).reshape(-1, 3, 3)


def harmonics(direction: torch.Tensor) -> torch.Tensor:
    """(N, 15) basis functions beyond the first."""
    x, y, z = direction.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    second = (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy)
    third = (y * (3 * xx - yy), x * y * z, y * (4 * zz - xx - yy), z * (2 * zz - 3 * xx - 3 * yy), x * (4 * zz - xx - yy),
             z * (xx - yy), x * (xx - 3 * yy))
    first = [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    return torch.stack(first + [c * f for c, f in zip(SH_C2 + SH_C3, second + third, strict=True)], 1)


def project(g: Gaussians, camera: Camera) -> tuple[torch.Tensor, ...]:
    """mean2d (N, 2), conic (N, 2, 2), opacity (N,), colour (N, 3), z (N,)."""
    rotation, translation = torch.tensor(camera.rotation), torch.tensor(camera.translation)
    x, y, z = (g.means @ rotation.T + translation).unbind(1)
    mean2d = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)
    tx = torch.clamp(x / z, -1.3 * camera.cx / camera.fx, 1.3 * (camera.width - camera.cx) / camera.fx)
    ty = torch.clamp(y / z, -1.3 * camera.cy / camera.fy, 1.3 * (camera.height - camera.cy) / camera.fy)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([camera.fx / z, zero, -camera.fx * tx / z, zero, camera.fy / z, -camera.fy * ty / z], 1)
    spread = rotations(g.quats) * torch.exp(g.log_scales)[:, None]
    onto = jacobian.reshape(-1, 2, 3) @ rotation @ spread
    covariance = onto @ onto.transpose(1, 2) + 0.3 * torch.eye(2, dtype=torch.float64)
    opacity = torch.clamp(torch.sigmoid(g.opacity) * torch.exp(g.log_amp), max=128.0)
    direction = g.means - torch.tensor(camera.position)
    direction = direction / direction.norm(dim=1, keepdim=True)
    basis = harmonics(direction)[:, : g.sh_rest.shape[1]]
    colour = g.sh_dc * SH_C0 + 0.5 + torch.einsum("nk,nkc->nc", basis, g.sh_rest)
    return mean2d, torch.linalg.inv(covariance), opacity, torch.clamp(colour, min=0), z


def dense_render(
    g: Gaussians, camera: Camera, alpha_max: float, background: tuple[float, float, float], support_sigma: float | None = 3.0
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Image (H, W, 3), sum of T alpha z (H, W), transmittance (H, W) and shares T alpha (H, W, N), all float64."""
    g = g.map(lambda tensor: tensor.double())
    mean2d, conic, opacity, colour, z = project(g, camera)
    rows, columns = torch.meshgrid(
        torch.arange(camera.height, dtype=torch.float64), torch.arange(camera.width, dtype=torch.float64), indexing="ij")
    offset = torch.stack([columns, rows], -1)[:, :, None] + 0.5 - mean2d
    q = 0.5 * torch.einsum("hwni,nij,hwnj->hwn", offset, conic, offset)
    alpha = torch.clamp(opacity * torch.exp(-q), max=alpha_max)
    seen = (alpha >= 1 / 255) & (z > camera.near) & (q <= (math.inf if support_sigma is None else support_sigma**2 / 2))
    light = torch.ones(camera.height, camera.width, dtype=torch.float64)
    alphas, parts = torch.where(seen, alpha, 0.0).unbind(-1), list(q.unbind(-1))
    for n in torch.argsort(z, stable=True).tolist():
        used = torch.where(light >= 1e-4, alphas[n], 0.0)
        parts[n] = light * used
        light = light * (1 - used)
    shares = torch.stack(parts, -1)
    image = shares @ colour + light[..., None] * torch.tensor(background, dtype=torch.float64)
    return image, shares @ z, light, shares
