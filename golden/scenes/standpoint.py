"""Where a camera stands around a target, by numbers that a user can copy: azimuth, elevation and distance (`--orbit`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.orbit import FOV_DEG, look_at

NEAR_PLANE = 0.02
"""Largest near plane as a share of the distance to the target."""


@dataclass(frozen=True)
class Standpoint:
    """A camera by numbers.

    Attributes:
        target: (3,) the point that the camera looks at, world units.
        up: (3,) unit vector, world up.
        azimuth_deg: angle around `up`, counter-clockwise as seen from above, from the first of `horizontal_axes(up)`.
        elevation_deg: angle above the horizontal plane through the target, between -90 and 90.
        distance: from target to camera, world units.
        fov_deg: horizontal field of view.
    """

    target: np.ndarray
    up: np.ndarray
    azimuth_deg: float
    elevation_deg: float
    distance: float
    fov_deg: float = FOV_DEG

    @property
    def position(self) -> np.ndarray:
        """(3,) the camera's place in world units."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        east, north = horizontal_axes(self.up)
        level = math.cos(azimuth) * east + math.sin(azimuth) * north
        return self.target + self.distance * (math.cos(elevation) * level + math.sin(elevation) * self.up)

    def camera(self, width: int, height: int, name: str | None = None) -> Camera:
        """The camera with a frame of `width` by `height` pixels."""
        up = self.up
        if abs(self.elevation_deg) > 89.9:  # straight down or up: the frame's upper edge points away from the azimuth
            azimuth = math.radians(self.azimuth_deg)
            east, north = horizontal_axes(self.up)
            up = -math.copysign(1.0, self.elevation_deg) * (math.cos(azimuth) * east + math.sin(azimuth) * north)
        return look_at(self.position, self.target, up, width, height, self.fov_deg,
                       near=min(Camera.near, NEAR_PLANE * self.distance), name=name or f"orbit {self.orbit}")

    @property
    def orbit(self) -> str:
        """The numbers as `--orbit` takes them: azimuth, elevation and distance, rounded to what one can see."""
        return f"{self.azimuth_deg:.5g},{self.elevation_deg:.5g},{self.distance:.5g}"


def horizontal_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with `up`; azimuth 0 lies along the first, 90 along the second.

    The first lies along the axis that follows the one nearest to `up`, x for +z, so it does not jump where `up` is tilted.
    """
    along = np.eye(3)[(int(np.argmax(np.abs(up))) + 1) % 3]
    east = along - (along @ up) * up
    east = east / np.linalg.norm(east)
    return east, np.cross(up, east)


def standpoint_of(camera: Camera, target: np.ndarray, up: np.ndarray) -> Standpoint:
    """The standpoint at the place of `camera` that looks at `target`: the inverse of `Standpoint.camera`."""
    east, north = horizontal_axes(up)
    offset = camera.position - target
    distance = float(np.linalg.norm(offset))
    azimuth = math.degrees(math.atan2(float(offset @ north), float(offset @ east))) % 360.0
    elevation = math.degrees(math.asin(float(np.clip(offset @ up / distance, -1, 1))))
    return Standpoint(target, up, azimuth, elevation, distance, math.degrees(2 * math.atan(camera.width / 2 / camera.fx)))
