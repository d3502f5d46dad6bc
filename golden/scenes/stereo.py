"""Two eyes: a rectified pair of cameras, where each eye looks, and which of the second eye's tiles may be warped.

The source eye is rendered, and its frame is warped into the target eye. Both cameras have the same rotation and intrinsics. The
target's centre lies to the source's right or left along the camera's x axis, so that a point appears on the same row in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.gaze import Display
from golden.scenes.load import EMBEDDED, TRAINED
from spec.constants import ECC_THRESHOLD_DEG, IPD_METRES, TILE
from spec.errors import InputError

EYES = ("left", "right")

METRIC_SCENES = {EMBEDDED: 1.0, TRAINED: 1.0}
"""Units per metre of the scenes whose scale is known, by name. Coordinates from structure from motion have no known scale."""


@dataclass(frozen=True)
class StereoPair:
    """The cameras of two eyes.

    Attributes:
        source: camera of the eye that is rendered as a whole.
        target: camera of the eye that the frame is warped into; only its centre differs from the source's.
        source_eye: "left" or "right".
        baseline: distance between the two centres in world units, positive.
    """

    source: Camera
    target: Camera
    source_eye: str
    baseline: float

    @property
    def sign(self) -> int:
        """Direction in which a pixel moves from source to target: -1 where the source is the left eye, +1 where it is the
        right."""
        return -1 if self.source_eye == "left" else 1

    @property
    def target_eye(self) -> str:
        """The other eye, "left" or "right"."""
        return EYES[1 - EYES.index(self.source_eye)]

    def disparity(self, depth: np.ndarray | float) -> np.ndarray:
        """Magnitude of the disparity in pixels, float64, at a z depth in world units."""
        with np.errstate(divide="ignore"):
            return self.baseline * self.source.fx / np.asarray(depth, np.float64)

    def left_right(self, source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sorts two values, one of the source and one of the target, into (left, right)."""
        return (source, target) if self.source_eye == "left" else (target, source)


def stereo_pair(
    source: Camera, *, ipd_metres: float = IPD_METRES, units_per_metre: float = 1.0, source_eye: str = "left",
) -> StereoPair:
    """The pair of cameras whose source eye is a given camera.

    Args:
        source: the camera of the source eye.
        ipd_metres: distance between the eyes (interpupillary distance) in metres.
        units_per_metre: scale of the scene's coordinates.
        source_eye: "left" or "right".

    Raises:
        InputError: a distance or scale is not positive and finite, or the eye is neither left nor right.
    """
    for name, value in (("IPD", ipd_metres), ("units per metre", units_per_metre)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} {value!r} is not accepted: a positive number is")
    if source_eye not in EYES:
        raise InputError(f"source eye {source_eye!r} is not accepted: choose one of {', '.join(EYES)}")
    baseline = ipd_metres * units_per_metre
    step = baseline if source_eye == "left" else -baseline
    target = replace(source, translation=source.translation - [step, 0.0, 0.0], name=f"{source.name}, other eye")
    return StereoPair(source, target, source_eye, baseline)


def scene_scale(scene: str, units_per_metre: float | None) -> tuple[float, str | None]:
    """The units per metre to use, and a warning where they had to be assumed.

    Args:
        scene: the scene's name.
        units_per_metre: the value that the user gave, or None.
    """
    if units_per_metre is not None:
        return units_per_metre, None
    if scene in METRIC_SCENES:
        return METRIC_SCENES[scene], None
    return 1.0, (f"the units of scene {scene!r} are unknown: 1 unit per metre is assumed; "
                 "msv2/studies/metric_scale/study.py computes the scale from a metric depth map")


def check_gaze(eye: str, gaze_xy: tuple[float, float], camera: Camera) -> None:
    """Raises InputError where a gaze is not on its eye's frame."""
    x, y = gaze_xy
    if not (0 <= x <= camera.width and 0 <= y <= camera.height):
        raise InputError(
            f"gaze {x:g},{y:g} of the {eye} eye is off-screen: accepted are 0..{camera.width},0..{camera.height} pixels")


def target_gaze(
    pair: StereoPair, gaze_xy: tuple[float, float], depth: float,
) -> tuple[tuple[float, float], str | None]:
    """Where the target eye looks when both eyes look at the same point, and a warning where that point is off-screen.

    Args:
        pair: the eyes.
        gaze_xy: the source's gaze in pixels.
        depth: z depth of the gazed pixel in world units. Where it is not finite, the target's gaze is the source's.

    Returns:
        The gaze, clamped to the frame, and the warning or None.
    """
    x, y = gaze_xy
    shifted = x + pair.sign * float(pair.disparity(depth)) if math.isfinite(depth) else x
    clamped = min(max(shifted, 0.0), float(pair.target.width))
    warning = None if clamped == shifted else (
        f"the gazed point is off-screen in the target eye, at column {shifted:.1f}: its gaze is clamped to {clamped:g}")
    return (clamped, y), warning


def warpable_tiles(display: Display, gaze_xy: tuple[float, float], threshold_deg: float = ECC_THRESHOLD_DEG) -> np.ndarray:
    """(tiles_y, tiles_x) bool: True where no pixel of the tile is less eccentric than the threshold. Other tiles must be
    rendered.

    Args:
        display: the target eye's display.
        gaze_xy: the target eye's gaze in pixels.
        threshold_deg: 0 allows every tile to be warped, 180 allows none.

    Raises:
        InputError: the threshold is not in 0..180 degrees, or the gaze is off the display.
    """
    if not 0 <= threshold_deg <= 180:
        raise InputError(f"eccentricity threshold {threshold_deg!r} is not accepted: 0..180 degrees are")
    nearest = display.eccentricity(gaze_xy)
    for axis in (0, 1):
        nearest = np.minimum.reduceat(nearest, np.arange(0, nearest.shape[axis], TILE), axis=axis)
    return nearest >= threshold_deg
