"""Small scenes for the tests of the differentiable renderer, and the comparison with the dense one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import Rendering, render
from golden.scenes.camera import Camera
from tests.helpers.training_dense_compositor import dense_render

CAMERA = Camera(np.eye(3), np.zeros(3), 40.0, 42.0, 25.0, 18.0, 53, 37)
BACKGROUND = (0.2, 0.5, 0.9)


def tilted_camera() -> Camera:
    """A camera away from the origin with a turned frame, 33 x 50 pixels."""
    angle = 0.4
    rotation = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    return Camera(rotation, rotation @ np.array([-0.3, 0.2, 0.7]), 31.0, 29.0, 15.0, 27.0, 33, 50)


def random_gaussians(count: int, seed: int, coefficients: int = 15, amplified: bool = True) -> Gaussians:
    """Gaussians in front of the cameras, some outside, of all opacities; colours partly below 0, where they are clamped."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    means = torch.rand(count, 3, generator=generator) * torch.tensor([4.0, 4.0, 3.0]) - torch.tensor([2.0, 2.0, -1.5])
    log_amp = torch.rand(count, generator=generator) if amplified else torch.zeros(count)
    return Gaussians(means, 0.7 * normal(count, 3) - 2, normal(count, 4), 2 * normal(count), log_amp, 0.8 * normal(count, 3),
                     0.2 * normal(count, coefficients, 3))


def single(**changes: Sequence[float]) -> Gaussians:
    """One grey Gaussian ahead of `CAMERA`, or more where a field has more rows."""
    fields = {"means": [[0.0, 0.0, 2.0]], "log_scales": [[-2.0, -2.2, -1.8]], "quats": [[1.0, 0.2, -0.3, 0.4]],
              "opacity": [0.5], "log_amp": [0.0], "sh_dc": [[0.3, -0.2, 0.6]]}
    fields |= changes
    count = max(map(len, fields.values()))
    tensors = {name: torch.tensor(rows, dtype=torch.float32) for name, rows in fields.items()}
    tensors = {name: rows.expand(count, *rows.shape[1:]).clone() for name, rows in tensors.items()}
    return Gaussians(**tensors, sh_rest=torch.zeros(count, 0, 3))


def trainable(gaussians: Gaussians) -> Gaussians:
    """A copy whose every field asks for its gradient."""
    return gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_(True))


def random_loss(images: Sequence[torch.Tensor], seed: int) -> torch.Tensor:
    """A scalar that weighs every pixel of image, depth sum and transmittance at random."""
    generator = torch.Generator().manual_seed(seed)
    weights = [torch.randn(image.shape, generator=generator) for image in images]
    return sum((image * weight.to(image.dtype)).sum() for image, weight in zip(images, weights, strict=True))


def gradients(
    gaussians: Gaussians, draw: Callable[[Gaussians], Sequence[torch.Tensor]], seed: int = 1
) -> dict[str, torch.Tensor]:
    """Every field's gradient of `random_loss` of what `draw` draws."""
    trained = trainable(gaussians)
    random_loss(draw(trained), seed).backward()
    return {name: torch.zeros_like(t) if t.grad is None else t.grad for name, t in trained.tensors().items()}


def images(rendering: Rendering) -> tuple[torch.Tensor, ...]:
    """What carries gradients."""
    return rendering.image, rendering.depth_sum, rendering.transmittance


def check_against_dense(
    gaussians: Gaussians, camera: Camera, alpha_max: float, *, bound: float = 2e-5, support_sigma: float | None = 3.0
) -> dict[str, torch.Tensor]:
    """Images and gradients within `bound` of the largest value of their kind, against float64; returns our gradients."""
    settings = {"alpha_max": alpha_max, "background": BACKGROUND, "support_sigma": support_sigma}
    with torch.no_grad():
        for ours, theirs in zip(images(render(gaussians, camera, **settings)), dense_render(gaussians, camera, **settings),
                                strict=False):
            assert (ours - theirs).abs().max() <= bound * max(1.0, float(theirs.abs().max()))
    ours = gradients(gaussians, lambda g: images(render(g, camera, **settings)))
    theirs = gradients(gaussians, lambda g: dense_render(g, camera, **settings)[:3])
    for name, expected in theirs.items():
        assert torch.isfinite(ours[name]).all(), name
        if expected.numel():
            scale = max(float(expected.abs().max()), 1e-3)
            assert (ours[name] - expected).abs().max() <= bound * scale, name
    return ours
