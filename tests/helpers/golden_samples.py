"""Small scenes and cameras for the tests of the integer renderer: those of the hard cases."""

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map
from golden.scenes.model import GaussianModel
from msv2.cases.makers import random_model, splats, turned_view, view
from spec.constants import SH_C0

__all__ = ["SH_C0", "map_for", "random_model", "splats", "turned_view", "view"]


def map_for(camera: Camera, gaze: tuple[float, float] | None, levels: int) -> FoveationMap | None:
    """The foveation map of a gaze that is given as fractions of the frame; None without a gaze."""
    if gaze is None:
        return None
    return foveation_map(Display(camera.width, camera.height), (gaze[0] * camera.width, gaze[1] * camera.height), levels)


def ball() -> GaussianModel:
    """A ball of 400 splats whose colours do not depend on the direction."""
    rng = np.random.default_rng(5)
    n = 400
    direction = rng.normal(size=(n, 3))
    return GaussianModel(
        means=direction / np.linalg.norm(direction, axis=1, keepdims=True), log_scales=rng.normal(-2.2, 0.3, (n, 3)),
        quats=rng.normal(size=(n, 4)), opacity=rng.uniform(0.3, 0.95, (n, 1)), sh_dc=rng.normal(0, 1, (n, 1, 3)),
        sh_rest=np.zeros((n, 0, 3)), quality_bound=np.ones(n, np.uint8))
