"""Small scenes and cameras for the tests of the integer renderer: those of the hard cases."""

from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map
from msv2.cases.makers import random_model, splats, turned_view, view
from spec.constants import SH_C0

__all__ = ["SH_C0", "map_for", "random_model", "splats", "turned_view", "view"]


def map_for(camera: Camera, gaze: tuple[float, float] | None, levels: int) -> FoveationMap | None:
    """The foveation map of a gaze that is given as fractions of the frame; None without a gaze."""
    if gaze is None:
        return None
    return foveation_map(Display(camera.width, camera.height), (gaze[0] * camera.width, gaze[1] * camera.height), levels)
