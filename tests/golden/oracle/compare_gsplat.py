"""The oracle with plain 3DGS semantics against gsplat's PyTorch reference, on the CPU.

    python tests/golden/oracle/compare_gsplat.py SCENE... [--size WxH]

Needs PyTorch and gsplat's files (`pip install --no-deps gsplat==1.5.3`; neither a GPU nor gsplat's build). gsplat's
are the covariances, the projection, the harmonics and each pair's alpha and colour sum. Its choice of pairs and
nerfacc's products along a ray exist in CUDA only: both are restated here, after RasterizeToPixels3DGSFwd.cu.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import types
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.metrics.image import psnr_vs
from golden.oracle.render import render
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.guard_band import UNBOUNDED

ALPHA_MAX = 0.999  # gsplat's; 3DGS has 0.99
ALPHA_MIN = 1 / 255
T_STOP = 1e-4


@dataclass(frozen=True)
class Comparison:
    """Errors of the oracle against gsplat, which stops a pixel before the splat that would take T below 1e-4.

    Attributes:
        psnr_default_db: the oracle as every renderer here is defined: 3-sigma support, alpha at most 0.99.
        psnr_db: the oracle with plain semantics, as are the maxima.
        stopped_share: share of pixels that the oracle stops.
        max_error_open: over the other pixels, where both composite every splat.
        max_error_stopped: over the stopped pixels.
        max_error_same_stop: over all pixels, gsplat's pairs chosen by the oracle's rule.
    """

    psnr_default_db: float
    psnr_db: float
    stopped_share: float
    max_error_open: float
    max_error_stopped: float
    max_error_same_stop: float


def compare(model: GaussianModel, camera: Camera) -> Comparison:
    """Render both ways, each by its own rule for stopping a pixel, then gsplat's way by the oracle's rule."""
    ours = render(model, camera, support_sigma=None, alpha_max=(ALPHA_MAX,), mean_range=UNBOUNDED)
    theirs = gsplat_image(model, camera, stop_after=False)
    same_rule = gsplat_image(model, camera, stop_after=True)
    stopped = ours.transmittance < T_STOP
    error = np.abs(ours.image - theirs).max(axis=-1)
    return Comparison(
        psnr_default_db=psnr_vs(render(model, camera).image, theirs),
        psnr_db=psnr_vs(ours.image, theirs),
        stopped_share=float(stopped.mean()),
        max_error_open=float(error[~stopped].max(initial=0)),
        max_error_stopped=float(error[stopped].max(initial=0)),
        max_error_same_stop=float(np.abs(ours.image - same_rule).max()),
    )


def gsplat_image(model: GaussianModel, camera: Camera, *, stop_after: bool) -> np.ndarray:
    """(H, W, 3) float64 by gsplat's functions; `stop_after`: composite the splat at which a pixel stops."""
    import torch

    gsplat = load_reference()
    means, quats, scales = map(torch.from_numpy, (model.means, model.quats, np.exp(model.log_scales)))
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3], view[:3, 3] = torch.from_numpy(camera.rotation), torch.from_numpy(camera.translation)
    intrinsics = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=torch.float64)

    covariances, _ = gsplat._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    radii, means2d, depths, conics, _ = gsplat._fully_fused_projection(
        means, covariances, view[None], intrinsics[None], camera.width, camera.height, near_plane=camera.near
    )
    coefficients = torch.from_numpy(np.concatenate([model.sh_dc, model.sh_rest], axis=1))
    directions = means - torch.from_numpy(camera.position)
    colours = gsplat._spherical_harmonics(model.sh_degree, directions, coefficients)
    colours = torch.clamp_min(colours + 0.5, 0.0)

    opacity = torch.from_numpy(model.opacity[:, 0].copy())
    gaussian, pixel = choose_pairs(
        radii[0].numpy(), means2d[0].numpy(), depths[0].numpy(), conics[0].numpy(), opacity.numpy(), camera, stop_after
    )
    image, _ = gsplat.accumulate(
        means2d, conics, opacity[None], colours[None], torch.from_numpy(gaussian), torch.from_numpy(pixel),
        torch.zeros(len(pixel), dtype=torch.int64), camera.width, camera.height,
    )
    return image[0].numpy()


def choose_pairs(radii, means2d, depths, conics, opacity, camera, stop_after) -> tuple[np.ndarray, np.ndarray]:
    """The (splat, pixel) pairs that gsplat's kernel would composite, sorted by pixel, then by depth."""
    transmittance = np.ones((camera.height, camera.width))
    stopped = np.zeros(transmittance.shape, bool)
    number = np.arange(transmittance.size).reshape(transmittance.shape)
    gaussians, pixels = [], []
    for i in np.argsort(depths, kind="stable"):
        if radii[i].min() <= 0:
            continue
        (x0, y0), (x1, y1) = (np.maximum(np.floor(means2d[i] + s * radii[i]), 0).astype(int) for s in (-1, 1))
        box = np.s_[y0 : y1 + 1, x0 : x1 + 1]
        dx = np.arange(camera.width)[box[1]][None, :] + 0.5 - means2d[i, 0]
        dy = np.arange(camera.height)[box[0]][:, None] + 0.5 - means2d[i, 1]
        sigma = 0.5 * (conics[i, 0] * dx**2 + conics[i, 2] * dy**2) + conics[i, 1] * dx * dy
        alpha = np.minimum(ALPHA_MAX, opacity[i] * np.exp(-sigma))
        hit = (sigma >= 0) & (alpha >= ALPHA_MIN) & ~stopped[box]
        after = transmittance[box] * (1 - alpha)
        stops = hit & (after < T_STOP)
        shown = hit if stop_after else hit & ~stops
        stopped[box] |= stops
        transmittance[box] = np.where(shown, after, transmittance[box])
        pixels.append(number[box][shown])
        gaussians.append(np.full(len(pixels[-1]), i))
    gaussian, pixel = np.concatenate(gaussians), np.concatenate(pixels)
    order = np.argsort(pixel, kind="stable")
    return gaussian[order], pixel[order]


def load_reference() -> types.ModuleType:
    """gsplat's `_torch_impl`, loaded by itself: the package would compile its CUDA kernels."""
    package = importlib.util.find_spec("gsplat")
    if package is None:
        raise SystemExit("gsplat is not installed: pip install --no-deps gsplat==1.5.3")
    sys.modules["nerfacc"] = nerfacc_functions()
    spec = importlib.util.spec_from_file_location("gsplat_torch", Path(package.origin).parent / "cuda" / "_torch_impl.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nerfacc_functions() -> types.ModuleType:
    """The two functions of nerfacc that gsplat's `accumulate` calls, for samples sorted by ray."""
    import torch

    def render_weight_from_alpha(alphas, ray_indices, n_rays):
        logs = torch.log1p(-alphas)
        before = torch.cumsum(logs, 0) - logs
        first = torch.searchsorted(ray_indices, ray_indices)  # each ray's product starts at its first sample
        transmittance = torch.exp(before - before[first])
        return alphas * transmittance, transmittance

    def accumulate_along_rays(weights, values, ray_indices, n_rays):
        samples = weights[:, None] if values is None else weights[:, None] * values
        return torch.zeros(n_rays, samples.shape[1], dtype=samples.dtype).index_add_(0, ray_indices, samples)

    module = types.ModuleType("nerfacc")
    module.render_weight_from_alpha, module.accumulate_along_rays = render_weight_from_alpha, accumulate_along_rays
    return module


def main() -> None:
    """Print a table, a line per scene."""
    from golden.scenes.load import load_model
    from golden.scenes.orbit import orbit_camera

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="SCENE")
    parser.add_argument("--size", default="320x180", metavar="WxH")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    columns = "scene", "dB, default", "dB, plain", "stopped", "max error, open", "stopped", "same stop rule"
    print(" | ".join(columns), "|".join(["---"] * len(columns)), sep="\n")
    for scene in arguments.scenes:
        model = load_model(scene)
        c = compare(model, orbit_camera(model, 0, 8, width, height))
        print(
            f"{model.name} {arguments.size} | {c.psnr_default_db:.1f} | {c.psnr_db:.1f} | {100 * c.stopped_share:.0f} % "
            f"| {c.max_error_open:.1e} | {c.max_error_stopped:.1e} | {c.max_error_same_stop:.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
