"""What the user of the viewer has set."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from spec.command_line import choice

ONE, SIDE_BY_SIDE, ANAGLYPH = "one", "side by side", "anaglyph"
EYES = (ONE, SIDE_BY_SIDE, ANAGLYPH)
"""How many eyes are drawn, and how two of them share the picture."""

GOLDEN, FLOAT = "golden", "float"
RENDERERS = (GOLDEN, FLOAT)
"""The integer renderer, whose pixels equal the hardware's, and the renderers in floating point."""

OVERLAYS = ("none", "levels", "error", "depth", "intersections", "warp")
"""What is drawn over or instead of the picture; `msv2.viewer.pictures` says what each shows."""


@dataclass(frozen=True)
class State:
    """What is to be drawn. All changes make a new state, so a thread may keep the one that it works on.

    Attributes:
        camera: the camera with the full frame's size; for two eyes, the source eye's.
        gaze: the gazed pixel of the full frame, or None for no foveation.
        levels: number of foveation levels, 1..4; they matter only with a gaze.
        effects: auto, all, none or a list, as `--effects` takes them.
        eyes: one of EYES.
        renderer: one of RENDERERS.
        overlay: one of OVERLAYS.
        gain: factor of the error overlay.
        units_per_metre: scale of the scene for two eyes; None for the scene's own, else 1.
        marked: whether a cross marks the gaze.

    Raises:
        InputError: `eyes`, `renderer` or `overlay` is none of the accepted words.
    """

    camera: Camera
    gaze: tuple[float, float] | None = None
    levels: int = 1
    effects: str = "auto"
    eyes: str = ONE
    renderer: str = GOLDEN
    overlay: str = "none"
    gain: float = 256.0
    units_per_metre: float | None = None
    marked: bool = True

    def __post_init__(self) -> None:
        choice("eyes", self.eyes, EYES)
        choice("renderer", self.renderer, RENDERERS)
        choice("overlay", self.overlay, OVERLAYS)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the full frame in pixels."""
        return self.camera.width, self.camera.height

    @property
    def stereo(self) -> bool:
        """Whether two eyes are drawn."""
        return self.eyes != ONE

    @property
    def depth(self) -> bool:
        """Whether a depth is computed for every pixel although one eye is drawn."""
        return self.overlay == "depth"

    @property
    def vertical_fov(self) -> float:
        """The frame's vertical field of view in radians."""
        return 2 * math.atan(self.camera.height / 2 / self.camera.fy)

    def resized(self, width: int, height: int) -> State:
        """The same state with a frame of another size."""
        if (width, height) == self.size:
            return self
        gaze = self.gaze and (self.gaze[0] * width / self.camera.width, self.gaze[1] * height / self.camera.height)
        return replace(self, camera=self.camera.resized(width, height), gaze=gaze)

    def moving(self, share: float = 0.5) -> State:
        """The state with the smaller frame that is drawn while the camera moves, at least 16 pixels on a side."""
        return self.resized(*(max(16, round(share * edge)) for edge in self.size))

    def posed(self, rotation: np.ndarray, position: np.ndarray) -> State:
        """The state with the camera at `position` (3,), with world-to-camera `rotation` (3, 3); its lens stays."""
        return replace(self, camera=replace(self.camera, rotation=rotation, translation=-rotation @ position, name="viewer"))

    def zoomed(self, vertical_fov: float) -> State:
        """The state with another vertical field of view, in radians; both focal lengths change by the same factor."""
        factor = self.camera.height / 2 / math.tan(vertical_fov / 2) / self.camera.fy
        camera = replace(self.camera, fx=self.camera.fx * factor, fy=self.camera.fy * factor, name="viewer")
        return replace(self, camera=camera)

    @property
    def frame_key(self) -> tuple[object, ...]:
        """Everything that the golden frame depends on, hashable."""
        camera = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in vars(self.camera).values())
        return camera, self.gaze, self.levels, self.effects, self.stereo, self.depth, self.units_per_metre


def fitted(camera: Camera, pixels: int = 640 * 360) -> Camera:
    """The camera with a frame of at most `pixels` pixels and its own ratio of width to height, in even numbers."""
    if camera.width * camera.height <= pixels:
        return camera
    share = math.sqrt(pixels / (camera.width * camera.height))
    return camera.resized(*(max(2, 2 * round(share * edge / 2)) for edge in (camera.width, camera.height)))
