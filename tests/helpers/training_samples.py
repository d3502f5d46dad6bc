"""Gaussians, cameras and guarded scenes for the tests of training."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from golden.diff.gaussians import Gaussians, from_model
from golden.scenes.camera import Camera
from golden.scenes.embedded.scene import cached_embedded_model
from golden.training.scene import TrainingScene, load_training_scene

SIZE = 64
FOCAL = 100.0 * SIZE
"""Of `forward_camera`, px: so narrow a field that balls are round on the whole frame."""


def forward_camera(**changes: object) -> Camera:
    """A camera at the origin that looks along +z: a point (x, y, 1) falls on the pixel (FOCAL x + SIZE / 2, ...)."""
    camera = Camera(np.eye(3), np.zeros(3), FOCAL, FOCAL, SIZE / 2, SIZE / 2, SIZE, SIZE)
    return replace(camera, **changes)


def round_gaussians(rows: list[tuple[float, float, float, float, float]]) -> Gaussians:
    """Grey balls given as (x px, y px, depth, standard deviation px, opacity) on the frame of `forward_camera`."""
    table = torch.tensor(rows, dtype=torch.float32)
    x, y, z, sigma, opacity = table.T
    n = len(table)
    means = torch.stack([(x - SIZE / 2) / FOCAL * z, (y - SIZE / 2) / FOCAL * z, z], dim=1)
    return Gaussians(
        means, torch.log(sigma / FOCAL * z.abs())[:, None].repeat(1, 3), torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.logit(opacity), torch.zeros(n), torch.zeros(n, 3), torch.zeros(n, 0, 3))


def crowd(seed: int = 3, count: int = 9) -> Gaussians:
    """Gaussians of all orientations that overlap each other, with harmonics; one is so opaque that its alpha is clipped, one is
    behind the camera."""
    random = np.random.default_rng(seed)
    z = random.uniform(2.0, 4.0, count)
    means = np.stack([z * random.uniform(-0.3, 0.3, count), z * random.uniform(-0.25, 0.25, count), z], 1)
    means[-1, 2] = -3.0
    opacity = random.uniform(-1.0, 2.0, count)
    opacity[0] = 9.0

    def tensor(values) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float32)

    return Gaussians(
        tensor(means), tensor(random.uniform(-2.5, -1.0, (count, 3))), tensor(random.standard_normal((count, 4))),
        tensor(opacity), torch.zeros(count), tensor(random.uniform(-0.5, 1.0, (count, 3))),
        tensor(0.3 * random.standard_normal((count, 8, 3))))


class _Guarded(tuple):
    """Cameras of which the forbidden ones may not be looked at."""

    forbidden: frozenset[int] = frozenset()

    def __getitem__(self, index):
        if index in self.forbidden:
            raise AssertionError(f"camera of test view {index} was read")
        return super().__getitem__(index)


class GuardedScene(TrainingScene):
    """A scene whose test views may not be read."""

    def photograph(self, index: int) -> torch.Tensor:
        if index in self.test:
            raise AssertionError(f"photograph of test view {index} was read")
        return super().photograph(index)


def guarded(scene: TrainingScene) -> GuardedScene:
    """The scene, raising where a test view's camera or photograph is read."""
    cameras = _Guarded(scene.cameras)
    cameras.forbidden = frozenset(scene.test)
    fields = {name: getattr(scene, name) for name in scene.__dataclass_fields__}
    return GuardedScene(**{**fields, "cameras": cameras})


def small_scene() -> TrainingScene:
    """The embedded scene at 64x64."""
    return load_training_scene("embedded", (SIZE, SIZE))


def small_dense(count: int = 800) -> Gaussians:
    """A model of the embedded scene with far more Gaussians than 64x64 pixels need."""
    return from_model(cached_embedded_model(count, sh_degree=1))


def same(left: Gaussians, right: Gaussians) -> bool:
    """Whether all fields are equal, bit for bit."""
    return all(torch.equal(a, b) for a, b in zip(left.tensors().values(), right.tensors().values(), strict=True))


def pixels_covered(sigma: float, x: float, y: float, opacity: float, size: int = SIZE) -> int:
    """Pixels where a lone ball's alpha reaches 1/255 within three standard deviations, low pass of 0.3 px^2 included."""
    centres = np.arange(size) + 0.5
    squared = (centres[None, :] - x) ** 2 + (centres[:, None] - y) ** 2
    q = squared / (2 * (sigma**2 + 0.3))
    return int((q <= min(4.5, math.log(255 * opacity))).sum())
