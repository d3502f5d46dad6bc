"""The benchmark's yardstick: a per-tile renderer in torch, as references for 3D Gaussian Splatting are usually written.

Projection, colour and one depth sort are vectorised over the Gaussians; each tile then takes the splats whose bounding box
meets it and composites all its pixels against all of them with a cumulative product. One level, float32, no gradients.
Torch is an optional dependency and imported on first use.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from golden import threads
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, SH_C0, SUPPORT_SIGMA, T_STOP, TILE
from spec.errors import InputError
from spec.harmonics import basis_beyond_dc


def import_torch() -> ModuleType:
    """torch, one thread an operation: rows of tiles run in parallel instead, and idle OpenMP threads slow nobody by spinning.

    Raises:
        InputError: it is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise InputError("torch is not installed, and is compared with: make setup, or pip install -e '.[train]'") from error
    torch.set_num_threads(1)
    return torch


class TorchModel(NamedTuple):
    """A model's first level as float32 tensors of N rows, activated once a model; `mean` is relative to `origin`."""

    mean: Any
    scale: Any
    quat: Any
    opacity: Any
    base: Any
    rest: Any
    origin: np.ndarray


def prepare(model: GaussianModel) -> TorchModel:
    """The model's first level, ready for `render`."""
    torch = import_torch()
    origin = np.median(model.means, axis=0)
    arrays = (
        model.means - origin, np.exp(model.log_scales), model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True),
        model.opacity[:, 0], SH_C0 * model.sh_dc[:, 0] + 0.5, model.sh_rest)
    return TorchModel(*(torch.tensor(a, dtype=torch.float32) for a in arrays), origin)


def _rotations(torch: ModuleType, quat: Any) -> Any:
    """(N, 3, 3) rotation matrices of unit quaternions."""
    w, x, y, z = quat.unbind(1)
    rows = (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
            2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def _project(torch: ModuleType, model: TorchModel, camera: Camera) -> tuple[Any, ...]:
    """Of the visible, front to back: mean2d (M, 2), conic (M, 3), radius (M,) in pixels, opacity (M,), colour (M, 3)."""
    rotation = torch.tensor(camera.rotation, dtype=torch.float32)
    eye = torch.tensor(camera.position - model.origin, dtype=torch.float32)
    z = (model.mean - eye) @ rotation[2]
    visible = torch.nonzero((z > camera.near) & (model.opacity >= ALPHA_MIN)).squeeze(1)
    visible = visible[torch.argsort(z[visible], stable=True)]
    mean, scale, quat, opacity, base, rest = (t[visible] for t in model[:6])
    x, y, z = ((mean - eye) @ rotation.T).unbind(1)
    margin = FRUSTUM_MARGIN
    sx = torch.clamp(x / z, -margin * camera.cx / camera.fx, margin * (camera.width - camera.cx) / camera.fx)
    sy = torch.clamp(y / z, -margin * camera.cy / camera.fy, margin * (camera.height - camera.cy) / camera.fy)
    gx, gy, zero = camera.fx / z, camera.fy / z, torch.zeros_like(z)
    jacobian = torch.stack((gx, zero, -gx * sx, zero, gy, -gy * sy), 1).reshape(-1, 2, 3)
    axes = jacobian @ rotation @ (_rotations(torch, quat) * scale[:, None, :])
    covariance = axes @ axes.transpose(1, 2)
    xx, xy, yy = covariance[:, 0, 0] + LOW_PASS, covariance[:, 0, 1], covariance[:, 1, 1] + LOW_PASS
    # The determinant as a sum of squares: in float32 the textbook difference loses needles to cancellation.
    area = torch.linalg.cross(axes[:, 0], axes[:, 1], dim=1).square().sum(1)
    determinant = area + LOW_PASS * (xx + yy) - LOW_PASS**2
    mean2d = torch.stack((x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy), 1)
    middle = 0.5 * (xx + yy)
    radius = SUPPORT_SIGMA * torch.sqrt(middle + torch.sqrt(torch.clamp(middle * middle - determinant, min=0.0)))
    if rest.shape[1]:
        direction = torch.nn.functional.normalize(mean - eye, dim=1)
        basis = torch.from_numpy(basis_beyond_dc(direction.numpy(), rest.shape[1]))
        base = base + torch.einsum("nk,nkc->nc", basis.to(torch.float32), rest)
    conic = torch.stack((yy, -xy, xx), 1) / determinant[:, None]
    return mean2d, conic, radius, opacity, base.clamp(min=0.0)


def _draw_tile(torch: ModuleType, splats: tuple[Any, ...], mine: Any, x: Any, y: Any, background: Any) -> Any:
    """(pixels, 3) colours at x and y, (pixels, 1), of the splats `mine`, front to back."""
    mean2d, conic, _, opacity, colour = (t[mine] for t in splats)
    dx, dy = x - mean2d[:, 0], y - mean2d[:, 1]
    a, b, c = conic.unbind(1)
    falloff = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (opacity * torch.exp(-falloff)).clamp(max=ALPHA_MAX_L1)
    alpha = torch.where((alpha >= ALPHA_MIN) & (falloff <= SUPPORT_SIGMA**2 / 2), alpha, 0.0)
    after = torch.cumprod(1 - alpha, 1)
    before = torch.cat((torch.ones_like(after[:, :1]), after[:, :-1]), 1)
    weight = torch.where(before < T_STOP, 0.0, before * alpha)
    return weight @ colour + (1 - weight.sum(1, keepdim=True)) * background


def render(model: TorchModel, camera: Camera, background: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """One frame, (H, W, 3) float32."""
    torch = import_torch()
    with torch.inference_mode():
        splats = _project(torch, model, camera)
        mean2d, radius = splats[0], splats[2][:, None]
        low, high, behind = mean2d - radius, mean2d + radius, torch.tensor(background, dtype=torch.float32)
    image = torch.empty((camera.height, camera.width, 3))

    @torch.inference_mode()
    def draw_row(top: int) -> None:
        bottom = min(top + TILE, camera.height)
        row = torch.nonzero((high[:, 1] >= top) & (low[:, 1] <= bottom)).squeeze(1)
        for left in range(0, camera.width, TILE):
            right = min(left + TILE, camera.width)
            mine = row[(high[row, 0] >= left) & (low[row, 0] <= right)]
            y, x = torch.meshgrid(torch.arange(top, bottom) + 0.5, torch.arange(left, right) + 0.5, indexing="ij")
            pixels = _draw_tile(torch, splats, mine, x.reshape(-1, 1), y.reshape(-1, 1), behind)
            image[top:bottom, left:right] = pixels.reshape(bottom - top, right - left, 3)

    with ThreadPoolExecutor(threads.threads) as pool:
        list(pool.map(draw_row, range(0, camera.height, TILE)))
    return image.numpy()
