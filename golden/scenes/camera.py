"""The camera that every renderer takes: OpenCV axes, world to camera, pixel centres at integers + 0.5."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        rotation: (3, 3) float64, world to camera; camera axes are x right, y down, z forward (OpenCV).
        translation: (3,) float64, world units; p_camera = rotation @ p_world + translation.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels; the top left pixel's centre is at (0.5, 0.5).
        width, height: frame size in pixels.
        near: near plane in world units; points with z <= near are culled.
        name: the photograph's name, or how the camera was made.
    """

    rotation: np.ndarray
    translation: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = 0.2
    name: str = "camera"

    @property
    def position(self) -> np.ndarray:
        """(3,) float64, the camera's centre in world units."""
        return -self.rotation.T @ self.translation

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with a frame of `width` by `height` pixels: focal lengths and principal point scale with the
        frame."""
        sx, sy = width / self.width, height / self.height
        return replace(self, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy, width=width, height=height)

    def turned(self, degrees: float) -> Camera:
        """The camera turned in its place about its own vertical axis, to the right where `degrees` is positive."""
        sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
        turn = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
        return replace(self, rotation=turn @ self.rotation, translation=turn @ self.translation)
