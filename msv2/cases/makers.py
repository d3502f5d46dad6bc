"""Makes small models and cameras for the cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.constants import SH_C0


def view(width: int = 64, height: int = 48, **changes: object) -> Camera:
    """A camera at the origin that looks along z, with a focal length of 50 pixels."""
    camera = Camera(np.eye(3), np.zeros(3), 50.0, 50.0, width / 2, height / 2, width, height)
    return replace(camera, **changes)


def turned_view(width: int, height: int) -> Camera:
    """A turned camera with unequal focal lengths, whose principal point is off the centre."""
    turn = np.deg2rad(12)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    return Camera(rotation, np.array([0.3, -0.2, 1.0]), 0.8 * width, 0.9 * width, 0.55 * width, 0.4 * height, width, height)


def splats(
    *means: Sequence[float], scale: ArrayLike = 0.1, opacity: ArrayLike = 0.8, colour: ArrayLike = (1, 1, 1),
    quat: ArrayLike = (1, 0, 0, 0), levels: int = 1,
) -> GaussianModel:
    """Gaussians of a given colour, per point or for all. `scale` is one standard deviation, three, or an (N, 3) array."""
    n = len(means)
    with np.errstate(divide="ignore"):
        log_scales = np.log(np.broadcast_to(scale, (n, 3)).astype(float))
    dc = (np.broadcast_to(colour, (n, 3)) - 0.5) / SH_C0
    return GaussianModel(
        means=np.array(means, float).reshape(n, 3), log_scales=log_scales,
        quats=np.broadcast_to(np.array(quat, float), (n, 4)).copy(),
        opacity=np.broadcast_to(np.reshape(opacity, (-1, 1)), (n, levels)).astype(float),
        sh_dc=np.repeat(dc[:, None], levels, axis=1), sh_rest=np.zeros((n, 0, 3)),
        quality_bound=np.full(n, levels, np.uint8),
    )


def random_model(rng: np.random.Generator, n: int, levels: int = 1, sh: int = 0, wild: bool = False) -> GaussianModel:
    """Splats in front of, beside and behind a camera near the origin; some have equal depths.

    With `wild`, their axes span eight decades (needles, discs, giants), and their opacities reach the faintest and the largest.
    """
    means = rng.uniform((-4, -3, -1), (4, 3, 8), (n, 3))
    means[: n // 4, 2] = np.round(means[: n // 4, 2])
    log_scales = rng.uniform(np.log(1e-6), np.log(1e2), (n, 3)) if wild else rng.normal(-1.8, 0.8, (n, 3))
    opacity = 2 ** rng.uniform(-9, 7, (n, levels)) if wild else rng.uniform(0, 1, (n, levels)) ** 2 * np.geomspace(1, 8, levels)
    return GaussianModel(
        means=means, log_scales=log_scales, quats=rng.normal(size=(n, 4)), opacity=opacity,
        sh_dc=rng.normal(0, 1.0, (n, levels, 3)), sh_rest=rng.normal(0, 0.2, (n, (sh + 1) ** 2 - 1, 3)),
        quality_bound=rng.integers(1, levels + 1, n).astype(np.uint8),
    )
