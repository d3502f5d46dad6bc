"""The differentiable renderer: the oracle's semantics in float32, with gradients for every field of the Gaussians."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from golden.diff.blend_cpu import Blending
from golden.diff.device import import_blend_warp, resolve_backend
from golden.diff.gaussians import Gaussians
from golden.diff.pairs import tile_lists
from golden.diff.projection import Projection, check_gaussians, project
from golden.oracle.render import ALPHA_MAX
from golden.scenes.camera import Camera
from golden.scenes.gaze import FoveationMap
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, SUPPORT_SIGMA, TILE
from spec.errors import InputError


@dataclass
class Rendering:
    """A rendered image of H x W pixels, with M of the Gaussians projected.

    Attributes:
        image: (H, W, 3) float32, background included, not clamped.
        depth_sum: (H, W) float32 sum of T alpha z.
        transmittance: (H, W) float32, the background's weight.
        index: (M,) int64 rows of the projected Gaussians, ascending.
        mean2d: (M, 2) pixels; if it needs a gradient, `mean2d.grad` holds it after the backward pass, in 1/px.
        radius: (M,) px, largest extent of the footprint from its centre.
        tiles: (M,) int32 number of tiles that used the splat before all their pixels had stopped.
        entries: number of listed intersections, that is (splat, tile) pairs.
        dominated: (M,) int32 number of pixels in which this splat has the largest T alpha; None unless asked for.
        weight: (M,) float32 sum of T alpha over the pixels; None unless asked for.
    """

    image: torch.Tensor
    depth_sum: torch.Tensor
    transmittance: torch.Tensor
    index: torch.Tensor
    mean2d: torch.Tensor
    radius: torch.Tensor
    tiles: torch.Tensor
    entries: int
    dominated: torch.Tensor | None
    weight: torch.Tensor | None


class _Blend(torch.autograd.Function):
    """Blending of splats on the CPU. The forward pass appends the `Blending` that it makes to the list `made`."""

    @staticmethod
    def forward(ctx, mean2d, factor, opacity, colour, depth, make, made):
        splats = tuple(np.ascontiguousarray(t.detach().numpy()) for t in (mean2d, factor, opacity, colour, depth))
        ctx.blending = make(splats)
        made.append(ctx.blending)
        ctx.set_materialize_grads(False)
        return tuple(map(torch.from_numpy, (ctx.blending.image, ctx.blending.depth_sum, ctx.blending.transmittance)))

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):
        def array(gradient: torch.Tensor | None, like: np.ndarray) -> np.ndarray:
            return np.zeros_like(like) if gradient is None else np.ascontiguousarray(gradient.numpy())

        blending = ctx.blending
        shapes = (blending.image, blending.depth_sum, blending.transmittance)
        results = blending.backward(*map(array, gradients, shapes), geometry=any(ctx.needs_input_grad[k] for k in (0, 1, 4)))
        return (*map(torch.from_numpy, results), None, None)


def _blend_cpu(
    splats: Projection, camera: Camera, alpha_max: float, background: Sequence[float], mask: np.ndarray
) -> tuple[tuple[torch.Tensor, ...], Blending]:
    """Image, depth sum and transmittance, differentiable, and the `Blending` that made them."""
    q_max = splats.q_max.numpy()
    size = (camera.width, camera.height)

    def make(arrays: tuple[np.ndarray, ...]) -> Blending:
        lists = tile_lists(arrays[0], arrays[1], q_max, arrays[4], *size, mask)
        return Blending(arrays, q_max, lists, size, alpha_max, tuple(background))

    made: list[Blending] = []
    images = _Blend.apply(splats.mean2d, splats.factor, splats.opacity, splats.colour, splats.depth, make, made)
    return images, made[0]


def _checked_mask(tile_mask: torch.Tensor | np.ndarray | None, camera: Camera) -> np.ndarray:
    shape = (-(-camera.height // TILE), -(-camera.width // TILE))
    if tile_mask is None:
        return np.ones(shape, bool)
    mask = np.ascontiguousarray(tile_mask.cpu().numpy() if isinstance(tile_mask, torch.Tensor) else tile_mask)
    if mask.dtype != bool:
        raise TypeError(f"tile_mask must be bool, not {mask.dtype}")
    if mask.shape != shape:
        raise ValueError(f"tile_mask must have shape {shape} for {camera.width}x{camera.height} pixels, not {mask.shape}")
    return mask


def _check_settings(camera: Camera, alpha_max: float, background: Sequence[float], support_sigma: float | None) -> None:
    if camera.width < 1 or camera.height < 1:
        raise ValueError(f"a frame of {camera.width}x{camera.height} pixels is not accepted: both must be at least 1")
    if not ALPHA_MIN < alpha_max <= 1:
        raise ValueError(f"alpha_max must lie above 1/255 and be at most 1, not {alpha_max!r}")
    if len(background) != 3 or not all(math.isfinite(c) for c in background):
        raise ValueError(f"background must be three finite numbers, not {background!r}")
    if support_sigma is not None and not support_sigma > 0:
        raise ValueError(f"support_sigma must be above 0 or None, not {support_sigma!r}")


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    alpha_max: float = ALPHA_MAX_L1,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    support_sigma: float | None = SUPPORT_SIGMA,
    usage: bool = False,
    tile_mask: torch.Tensor | np.ndarray | None = None,
    backend: str | None = None,
) -> Rendering:
    """Renders one level differentiably: image, depth sum and transmittance pass gradients to every field that needs one.

    The result is bit for bit the same for any number of threads (`torch.set_num_threads` sets it). A gradient is zero where
    alpha is clipped at `alpha_max`, below 1/255, beyond the support, and after a pixel has stopped. Where the Jacobian's slopes
    are clamped, the gradient is that of torch's clamp.

    Args:
        gaussians: the level's Gaussians, float32.
        camera: the camera.
        alpha_max: upper bound of alpha: 0.99 for level 1, 1 for levels 2 to 4.
        background: red, green, blue behind everything.
        support_sigma: Mahalanobis radius that bounds a splat's support, or None for the bound on alpha alone.
        usage: also return `dominated` and `weight`, which costs about another forward pass.
        tile_mask: (tiles_y, tiles_x) bool; tiles outside the mask show the background.
        backend: `numba` or `warp`; by default numba for Gaussians on the CPU and Warp for those on CUDA.

    Raises:
        TypeError, ValueError: a field has the wrong dtype or shape, or a setting is out of range; the message names what is
            accepted.
        InputError: Warp is needed and not installed.
    """
    check_gaussians(gaussians)
    _check_settings(camera, alpha_max, background, support_sigma)
    blend = _blend_cpu if resolve_backend(gaussians.device, backend) == "numba" else import_blend_warp().blend
    splats = project(gaussians, camera, support_sigma)
    mask = _checked_mask(tile_mask, camera)
    images, blending = blend(splats, camera, alpha_max, background, mask)
    dominated, weight = map(torch.as_tensor, blending.usage()) if usage else (None, None)
    return Rendering(
        *images, splats.index, splats.mean2d, splats.radius, torch.as_tensor(blending.tiles), len(blending.lists.splat),
        dominated, weight)


def render_foveated(
    levels: Sequence[Gaussians],
    camera: Camera,
    foveation: FoveationMap,
    *,
    alpha_max: Sequence[float] = ALPHA_MAX,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    support_sigma: float | None = SUPPORT_SIGMA,
) -> torch.Tensor:
    """(H, W, 3) float32: each tile at its level, blend tiles from two levels by each pixel's own eccentricity.

    The image is differentiable in every level.

    Args:
        levels: the Gaussians of each level, level 1 first, with their rows in the same order in all levels.
        camera: the camera.
        foveation: which levels each tile shows; its display must have the frame's size.
        alpha_max: upper bound of alpha for each level.
        background, support_sigma: as for `render`.

    Raises:
        InputError: the map does not fit the frame, or uses levels that are not given.
        TypeError, ValueError: as for `render`.
    """
    display = foveation.display
    if (display.width_px, display.height_px) != (camera.width, camera.height):
        raise InputError(f"display of {display.width_px}x{display.height_px} pixels is not accepted: "
                         f"the frame has {camera.width}x{camera.height}")
    if foveation.levels > len(levels) or foveation.levels > len(alpha_max):
        raise InputError(f"{foveation.levels} levels are not accepted: {len(levels)} are given, {len(alpha_max)} alpha_max")
    if foveation.tile != TILE:
        raise InputError(f"tiles of {foveation.tile} pixels are not accepted: {TILE} are")
    device = levels[0].device
    level = np.asarray(foveation.tile_level)
    farther = torch.from_numpy(foveation.blend_weights_exact.astype(np.float32)).to(device)
    image = torch.zeros(camera.height, camera.width, 3, device=device)
    for k in range(foveation.levels):
        second = foveation.blend & (level == k - 1)
        mask = (level == k) | second
        if not mask.any():
            continue
        shown = render(levels[k], camera, alpha_max=alpha_max[k], background=background, support_sigma=support_sigma,
                       tile_mask=mask).image
        first_here, second_here = (_pixels(tiles, camera, device) for tiles in (level == k, second))
        image = image + (first_here * (1 - farther) + second_here * farther)[..., None] * shown
    return image


def _pixels(tiles: np.ndarray, camera: Camera, device: torch.device) -> torch.Tensor:
    """(H, W) float32: 1 in the pixels of the marked tiles, 0 elsewhere."""
    expanded = tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)[: camera.height, : camera.width]
    return torch.from_numpy(expanded.astype(np.float32)).to(device)
