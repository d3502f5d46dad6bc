"""Small models for tests of cameras and of orientation: a box on the ground, a sign; turned, with a floater."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from golden.scenes.model import GaussianModel


def model_of(points: np.ndarray, sigma: float, source: str = "ply", colour: np.ndarray | None = None) -> GaussianModel:
    """Round splats of opacity 0.9 at (N, 3) points; its up is only a habit."""
    n = len(points)
    dc = np.zeros((n, 1, 3)) if colour is None else colour.reshape(n, 1, 3)
    return GaussianModel(
        means=np.asarray(points, np.float64), log_scales=np.full((n, 3), np.log(sigma)), quats=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full((n, 1), 0.9), sh_dc=dc, sh_rest=np.zeros((n, 0, 3)), quality_bound=np.ones(n, np.uint8),
        up_source=source)


def box_on_ground(source: str = "ply", seed: int = 0) -> GaussianModel:
    """A hollow box of 1.2 x 0.8 x 0.9 on a disc of ground of radius 3, z up; the box's splats come last, 4,000 of 10,000."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.random(6000) * 2 * np.pi, 3 * np.sqrt(rng.random(6000))
    ground = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.normal(0, 0.01, 6000)], axis=1)
    box = rng.random((4000, 3))
    face = rng.integers(0, 5, 4000)  # no bottom
    box[np.arange(4000), np.array([0, 0, 1, 1, 2])[face]] = np.array([0, 1, 0, 1, 1])[face]
    return model_of(np.concatenate([ground, (box - [0.5, 0.5, 0]) * [1.2, 0.8, 0.9]]), 0.03, source)


def sign(normal: int, source: str, seed: int = 0) -> GaussianModel:
    """A flat ring with a bar across, 2 wide and thinner than a hundredth, whose normal is one of the axes."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.random(4000) * 2 * np.pi, np.sqrt(rng.uniform(0.7**2, 1, 4000))
    bar = rng.uniform(-1, 1, (1500, 2)) * [0.7, 0.15]
    flat = np.concatenate([np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), bar])
    points = np.insert(flat, normal, rng.normal(0, 0.003, len(flat)), axis=1)
    return model_of(points, 0.02, source)


def turned(model: GaussianModel, rotation: Rotation) -> GaussianModel:
    """The model turned about the origin. It may have no harmonics, which would have to turn with it."""
    assert model.sh_rest.shape[1] == 0
    x, y, z, w = (rotation * Rotation.from_quat(model.quats[:, [1, 2, 3, 0]])).as_quat().T
    return replace(model, means=rotation.apply(model.means), quats=np.stack([w, x, y, z], axis=1))


def with_floater(model: GaussianModel, place: np.ndarray, sigma: float) -> GaussianModel:
    """The model with one more splat, opaque and round."""
    extra = model.select(np.array([0]))
    extra = replace(
        extra, means=np.asarray(place)[None], log_scales=np.full((1, 3), np.log(sigma)), opacity=np.full((1, 1), 0.99))
    arrays = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    return replace(model, **{name: np.concatenate([getattr(model, name), getattr(extra, name)]) for name in arrays})
