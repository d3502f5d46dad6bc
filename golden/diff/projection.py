"""Differentiable projection of Gaussians to splats: the oracle's semantics (`golden.oracle.project`) in float32.

On the CPU, fused kernels do it (`projection_cpu`), elsewhere torch operations. In both, a first step without gradients decides
which Gaussians survive, and only survivors are projected with gradients. Vectors are kept as rows of components, (3, N) and (2,
3, N), so that there are few operations and each works on contiguous memory. Sources: Zwicker et al. 2001, Kerbl et al. 2023.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from golden.diff.gaussians import Gaussians
from golden.diff.projection_cpu import FRAME_SLACK, project_backward, project_forward, view_of
from golden.scenes.camera import Camera
from golden.scenes.model import SH_REST_COUNT
from spec.constants import ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, SH_C0
from spec.guard_band import MEAN_RANGE, Range
from spec.harmonics import C1, C2, C2_Z, C3_0, C3_1, C3_2, C3_3


@dataclass
class Projection:
    """The Gaussians that may touch the frame, in the order of their rows; all fields but the last three carry gradients.

    Attributes:
        mean2d: (M, 2) pixels.
        factor: (M, 3) 1/px, triangular factor of the conic: see `golden.oracle.ellipse`.
        opacity: (M,) amplified opacity.
        colour: (M, 3), at least 0.
        depth: (M,) camera z in world units.
        index: (M,) int64 rows of the Gaussians, ascending.
        q_max: (M,) largest falloff exponent that the splat covers.
        radius: (M,) px, largest extent of the footprint from its centre.
    """

    mean2d: torch.Tensor
    factor: torch.Tensor
    opacity: torch.Tensor
    colour: torch.Tensor
    depth: torch.Tensor
    index: torch.Tensor
    q_max: torch.Tensor
    radius: torch.Tensor


@dataclass(frozen=True)
class _View:
    """A camera as float32 tensors on one device. The eye is a sum of two parts, because one float32 would shift distant
    cameras."""

    rotation: torch.Tensor
    eye: torch.Tensor
    eye_rest: torch.Tensor
    focal: torch.Tensor
    centre: torch.Tensor
    lowest: torch.Tensor
    highest: torch.Tensor
    frame: tuple[int, int]
    mean_range: Range


def _view(camera: Camera, device: torch.device, mean_range: Range) -> _View:
    def tensor(values: object) -> torch.Tensor:
        return torch.tensor(np.asarray(values), dtype=torch.float32, device=device)

    focal, centre = np.array([[camera.fx], [camera.fy]]), np.array([[camera.cx], [camera.cy]])
    size = np.array([[camera.width], [camera.height]])
    eye = camera.position.astype(np.float32)
    return _View(
        tensor(camera.rotation), tensor(eye), tensor(camera.position - eye), tensor(focal), tensor(centre),
        tensor(-FRUSTUM_MARGIN * centre / focal), tensor(FRUSTUM_MARGIN * (size - centre) / focal),
        (camera.width, camera.height), mean_range)


def _offset(view: _View, means: torch.Tensor) -> torch.Tensor:
    """(3, N) offsets from the eye to the means, in world axes."""
    return ((means - view.eye) - view.eye_rest).T.contiguous()


def _covariance(view: _View, point: torch.Tensor, log_scales: torch.Tensor, quats: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """xx, xy, yy of the screen covariance without the low-pass, and the determinant with it; all (N,), in px^2 and px^4.

    The rows of M = J W R S are computed by rotating the rows of J W by the inverse rotation. The determinant is a sum of
    squares, as in the oracle.
    """
    inverse = 1 / point[2]
    slope = torch.clamp(point[:2] * inverse, view.lowest, view.highest)
    lines = view.rotation[:2, :, None] - slope[:, None] * view.rotation[2, :, None]
    lines = lines * (view.focal * inverse)[:, None]
    quats = quats.T.contiguous()
    quats = quats / torch.linalg.vector_norm(quats, dim=0)
    axis = quats[1:].expand(2, 3, -1)
    turn = 2 * torch.linalg.cross(axis, lines, dim=1)
    m = (lines - quats[0] * turn + torch.linalg.cross(axis, turn, dim=1)) * torch.exp(log_scales).T.contiguous()
    xx, yy = (m * m).sum(1)
    xy = (m[0] * m[1]).sum(0)
    area = torch.linalg.cross(m[0], m[1], dim=0)
    return xx, xy, yy, (area * area).sum(0) + LOW_PASS * (xx + yy) + LOW_PASS**2


def _factor(xy: torch.Tensor, yy: torch.Tensor, determinant: torch.Tensor) -> torch.Tensor:
    """(3, N) triangular factor of the conic; `yy` includes the low-pass."""
    f0 = torch.sqrt(yy / determinant)
    return torch.stack([f0, -f0 * xy / yy, torch.rsqrt(yy)])


def _meets_frame(mean2d: torch.Tensor, factor: torch.Tensor, q_max: torch.Tensor, frame: tuple[int, int]) -> torch.Tensor:
    """(N,) bool: whether the ellipse meets the rectangle of the frame's pixel centres (`golden.oracle.ellipse`)."""
    f0, f1, f2 = factor
    low = 0.5 - mean2d
    high = torch.stack([low[0] + (frame[0] - 1), low[1] + (frame[1] - 1)])
    dx, dy = torch.minimum(torch.clamp(low, min=0), high)
    facing_y = torch.clamp(-f0 * f1 * dx / (f1 * f1 + f2 * f2), low[1], high[1])
    facing_x = torch.clamp(-f1 / f0 * dy, low[0], high[0])

    def exponent(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return 0.5 * ((f0 * x + f1 * y) ** 2 + (f2 * y) ** 2)

    vertical = torch.where(dx != 0, exponent(dx, facing_y), math.inf)
    horizontal = torch.where(dy != 0, exponent(facing_x, dy), math.inf)
    inside = (dx == 0) & (dy == 0)
    return inside | (torch.minimum(vertical, horizontal) <= q_max + FRAME_SLACK)


@torch.no_grad()
def _survivors(view: _View, near: float, gaussians: Gaussians, q_max: torch.Tensor) -> torch.Tensor:
    """(M,) int64 rows that are finite, beyond the near plane, not transparent, within the guard band, and meet the frame."""
    g = gaussians
    sums = [g.means.sum(1), g.quats.sum(1), g.opacity, g.log_amp, g.sh_dc.sum(1), g.sh_rest.sum((1, 2))]
    finite = torch.isfinite(sum(sums)) & (g.log_scales < math.inf).all(1)
    point = view.rotation @ _offset(view, g.means)
    _, xy, yy, determinant = _covariance(view, point, g.log_scales, g.quats)
    mean2d = point[:2] / point[2] * view.focal + view.centre
    low, high = view.mean_range
    finite &= torch.isfinite(determinant) & ((low < mean2d) & (mean2d < high)).all(0)
    meets = _meets_frame(mean2d, _factor(xy, yy + LOW_PASS, determinant), q_max, view.frame)
    return torch.nonzero(finite & (point[2] > near) & (q_max >= 0) & meets).squeeze(1)


class _Rows(torch.autograd.Function):
    """Rows of a tensor at distinct indices. torch's own backward pass has to allow for repeated indices and is slow."""

    @staticmethod
    def forward(ctx: object, tensor: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(index)
        ctx.shape = tensor.shape
        return tensor.index_select(0, index)

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        (index,) = ctx.saved_tensors
        return gradient.new_zeros(ctx.shape).index_copy_(0, index, gradient), None


def _basis(direction: torch.Tensor, count: int) -> torch.Tensor:
    """(count, N) harmonics from degree 1 on at the unit vectors (3, N), in the order and signs of `golden.oracle.harmonics`."""
    x, y, z = direction
    functions = [-C1 * y, C1 * z, -C1 * x]
    if count > 3:
        xx, yy, zz, xy = x * x, y * y, z * z, x * y
        difference = xx - yy
        functions += [C2 * xy, -C2 * y * z, C2_Z * (2 * zz - xx - yy), -C2 * x * z, C2 / 2 * difference]
    if count > 8:
        ring = 4 * zz - xx - yy
        functions += [
            -C3_3 * y * (3 * xx - yy), C3_2 * xy * z, -C3_1 * y * ring, C3_0 * z * (2 * zz - 3 * (xx + yy)), -C3_1 * x * ring,
            C3_2 / 2 * z * difference, -C3_3 * x * (xx - 3 * yy)]
    return torch.stack(functions)


def _colour(offset: torch.Tensor, sh_dc: torch.Tensor, sh_rest: torch.Tensor) -> torch.Tensor:
    """(N, 3) colours max(0, SH sum + 0.5); where they are clamped there is no gradient."""
    total = sh_dc * SH_C0 + 0.5
    if sh_rest.shape[1]:
        direction = offset / torch.linalg.vector_norm(offset, dim=0)
        total = total + (sh_rest * _basis(direction, sh_rest.shape[1]).T[:, :, None]).sum(1)
    return torch.relu(total)


def check_gaussians(gaussians: Gaussians) -> None:
    """Raises TypeError or ValueError unless every field has its dtype and shape and all are on one device."""
    n, coefficients = len(gaussians.means), tuple(gaussians.sh_rest.shape[1:2])
    if gaussians.sh_rest.ndim != 3 or coefficients[0] not in SH_REST_COUNT.values():
        raise ValueError(f"sh_rest must be (N, K, 3) with K = 0, 3, 8 or 15, not {tuple(gaussians.sh_rest.shape)!r}")
    shapes = {"means": (n, 3), "log_scales": (n, 3), "quats": (n, 4), "opacity": (n,), "log_amp": (n,), "sh_dc": (n, 3),
              "sh_rest": (n, *coefficients, 3)}
    for field in fields(gaussians):
        tensor = getattr(gaussians, field.name)
        if tensor.dtype != torch.float32 or tensor.device != gaussians.device:
            raise TypeError(f"{field.name} must be float32 on {gaussians.device}, not {tensor.dtype} on {tensor.device}")
        if tuple(tensor.shape) != shapes[field.name]:
            raise ValueError(f"{field.name} must have shape {shapes[field.name]}, not {tuple(tensor.shape)!r}")


def project(
    gaussians: Gaussians, camera: Camera, support_sigma: float | None, mean_range: Range = MEAN_RANGE,
) -> Projection:
    """Projects the Gaussians that can change a pixel; the others get no gradient.

    Args:
        gaussians: the Gaussians.
        camera: the camera.
        support_sigma: Mahalanobis radius that bounds the support, or None for the bound on alpha alone.
        mean_range: the guard band (`spec.guard_band`): pixels between which a projected mean must lie.
    """
    support = math.inf if support_sigma is None else support_sigma**2 / 2
    on_cpu = gaussians.device.type == "cpu"
    splats = (_project_kernels if on_cpu else project_torch)(gaussians, camera, support, mean_range)
    if splats.mean2d.requires_grad:
        splats.mean2d.retain_grad()
    return splats


class _Kernels(torch.autograd.Function):
    """The fused kernels as an autograd function; index, q_max and radius are appended to the list `extras`."""

    @staticmethod
    def forward(ctx, means, log_scales, quats, opacity, log_amp, sh_dc, sh_rest, view, support, extras):
        fields = (means, log_scales, quats, opacity, log_amp, sh_dc, sh_rest)
        ctx.save_for_backward(*fields)
        ctx.view = view
        index, *results, q_max, radius = map(torch.from_numpy, project_forward(_arrays(fields), view, support))
        ctx.index = index
        extras.extend((index, q_max, radius))
        if not any(ctx.needs_input_grad[:3]):
            mean2d, factor, _opacity, _colour, depth = results
            ctx.mark_non_differentiable(mean2d, factor, depth)
        return tuple(results)

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):
        needed = ctx.needs_input_grad
        results = project_backward(
            _arrays(ctx.saved_tensors), ctx.view, ctx.index.numpy(), _arrays(gradients), any(needed[:3]), needed[6])
        fields = (torch.from_numpy(result) if wanted else None for result, wanted in zip(results, needed, strict=False))
        return (*fields, None, None, None)


def _arrays(tensors: Sequence[torch.Tensor]) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(tensor.detach().numpy()) for tensor in tensors)


def _project_kernels(gaussians: Gaussians, camera: Camera, support: float, mean_range: Range) -> Projection:
    extras: list[torch.Tensor] = []
    splats = _Kernels.apply(*gaussians.tensors().values(), view_of(camera, mean_range), support, extras)
    return Projection(*splats, *extras)


def project_torch(gaussians: Gaussians, camera: Camera, support: float, mean_range: Range = MEAN_RANGE) -> Projection:
    """As `project`, but in torch operations on any device; `support` bounds the falloff's exponent."""
    view = _view(camera, gaussians.device, mean_range)
    with torch.no_grad():
        q_max = torch.log(gaussians.amplified_opacity / ALPHA_MIN).clamp(max=support)
        index = _survivors(view, camera.near, gaussians, q_max)
    rows = gaussians if len(index) == len(gaussians) else gaussians.map(lambda tensor: _Rows.apply(tensor, index))
    offset = _offset(view, rows.means)
    point = view.rotation @ offset
    mean2d = (point[:2] / point[2] * view.focal + view.centre).T.contiguous()
    xx, xy, yy, determinant = _covariance(view, point, rows.log_scales, rows.quats)
    factor = _factor(xy, yy + LOW_PASS, determinant).T
    with torch.no_grad():
        q_max = q_max[index]
        widest = 0.5 * (xx + yy) + torch.hypot(0.5 * (xx - yy), xy) + LOW_PASS
        radius = torch.sqrt(2 * q_max * widest)
    return Projection(
        mean2d, factor, rows.amplified_opacity, _colour(offset, rows.sh_dc, rows.sh_rest), point[2], index, q_max, radius)
