"""The camera that every renderer takes: OpenCV axes, world to camera, pixel centres at integers + 0.5."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from spec.errors import InputError

RIGID = 1e-3
"""Largest deviation of R R^T from the identity: a matrix with four decimals passes, a scaled one does not."""

WIDEST = 65_535
"""Most pixels of a frame's side in a file. Machines take fewer; see `row_width`."""


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


def checked(camera: Camera, where: str) -> Camera:
    """The camera, if it can be one. Every loader passes its cameras through this check.

    Args:
        camera: the camera.
        where: the file, and which of its cameras, for the message.

    Raises:
        InputError: a number is not finite, the rotation is none, or a focal length, the near plane or a side of the frame is
            not positive.
    """
    for name in ("fx", "fy", "cx", "cy", "near"):
        value = getattr(camera, name)
        if not math.isfinite(value):
            raise InputError(f"{where}: {name} is {value!r}; a finite number is needed")
        if name in ("fx", "fy", "near") and value <= 0:
            raise InputError(f"{where}: {name} is {value:g}; more than 0 is accepted")
    if not (1 <= camera.width <= WIDEST and 1 <= camera.height <= WIDEST):
        raise InputError(f"{where}: frame size {camera.width}x{camera.height}; 1..{WIDEST} pixels a side are accepted")
    if camera.rotation.shape != (3, 3) or camera.translation.shape != (3,):
        shapes = f"{camera.rotation.shape} and {camera.translation.shape}"
        raise InputError(f"{where}: rotation and translation have shapes {shapes}; (3, 3) and (3,) are needed")
    if not (np.isfinite(camera.rotation).all() and np.isfinite(camera.translation).all()):
        raise InputError(f"{where}: the pose holds a number that is not finite")
    if np.abs(camera.rotation @ camera.rotation.T - np.eye(3)).max() > RIGID or np.linalg.det(camera.rotation) < 0:
        raise InputError(f"{where}: rotation {camera.rotation.tolist()} is not a rotation matrix; orthonormal rows are needed")
    return camera
