"""Lenses with distortion, and photographs without it.

The project's renderers draw pinhole cameras. A photograph of a distorted lens is therefore resampled to what a pinhole camera
at the same place, with the same principal point and frame size, would have seen. That camera's focal length is the shortest at
which every pixel was seen by the lens, so that no border is left empty.

The model is OpenCV's rational one, of which COLMAP's SIMPLE_RADIAL, RADIAL, OPENCV and FULL_OPENCV are special cases. Only its
forward direction is needed, which is a formula, so no package is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from spec.errors import InputError

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""The distortion coefficients in OpenCV's order, which is also that of COLMAP's FULL_OPENCV."""

ZOOM_RANGE = (0.25, 4.0)
"""Focal lengths of the pinhole camera that are tried, relative to the lens's."""

ZOOM_STEPS = 24
"""Halvings of that range; they find the focal length to a millionth."""


@dataclass(frozen=True)
class Lens:
    """A camera whose lens is distorted.

    Attributes:
        camera: its pose, focal lengths, principal point and frame size; the distortion is not in it.
        coefficients: eight numbers in the order of COEFFICIENTS.
    """

    camera: Camera
    coefficients: tuple[float, ...]

    def project(self, rays: np.ndarray) -> np.ndarray:
        """(N, 2) float64 image points, in pixels, of the rays (x / z, y / z), an (N, 2) array in camera axes."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self.coefficients
        x, y = rays.T
        r = x * x + y * y
        radial = (1 + r * (k1 + r * (k2 + r * k3))) / (1 + r * (k4 + r * (k5 + r * k6)))
        u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
        v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
        return np.stack([self.camera.fx * u + self.camera.cx, self.camera.fy * v + self.camera.cy], axis=1)

    def resized(self, width: int, height: int) -> Lens:
        """The same lens with a frame of `width` by `height` pixels; its coefficients do not depend on the size."""
        return replace(self, camera=self.camera.resized(width, height))

    def pinhole(self) -> Camera:
        """The camera without distortion whose every pixel the lens saw.

        Raises:
            InputError: see `zoom`.
        """
        return self.zoomed(self.zoom())

    def zoom(self) -> float:
        """The focal length of `pinhole`, relative to the lens's.

        Raises:
            InputError: there is none within ZOOM_RANGE, because the coefficients fold the frame's border over.
        """
        low, high = ZOOM_RANGE
        if not self._covers(high):
            raise InputError(f"{self.camera.name}: the lens's distortion {self._text()} folds the frame's border over; smaller "
                             "coefficients are accepted (or colmap image_undistorter, then import its model)")
        for _ in range(ZOOM_STEPS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._covers(middle) else (middle, high)
        return high

    def undistorted(self, pixels: np.ndarray, camera: Camera) -> np.ndarray:
        """What a pinhole camera would have seen, by bilinear interpolation between the lens's pixels.

        Args:
            pixels: (H, W, C) uint8, what the lens saw, of its camera's size.
            camera: the pinhole camera, see `pinhole`; its pose is the lens's.

        Returns:
            (camera.height, camera.width, C) uint8, rounded to nearest; the border is repeated beyond the lens's frame.
        """
        height, width, channels = pixels.shape
        result = np.empty((camera.height, camera.width, channels), np.uint8)
        source = pixels.astype(np.float32)
        x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        for row in range(camera.height):  # by rows, because a whole photograph's coordinates would take gigabytes
            y = np.full(camera.width, (row + 0.5 - camera.cy) / camera.fy)
            u, v = (self.project(np.stack([x, y], axis=1)) - 0.5).T
            u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
            left, top = np.minimum(u.astype(int), max(width - 2, 0)), np.minimum(v.astype(int), max(height - 2, 0))
            right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
            across, down = (u - left)[:, None].astype(np.float32), (v - top)[:, None].astype(np.float32)
            upper = source[top, left] * (1 - across) + source[top, right] * across
            lower = source[bottom, left] * (1 - across) + source[bottom, right] * across
            result[row] = np.floor(upper * (1 - down) + lower * down + 0.5)
        return result

    def zoomed(self, zoom: float) -> Camera:
        """The camera without distortion, with the lens's focal lengths times `zoom`."""
        return replace(self.camera, fx=zoom * self.camera.fx, fy=zoom * self.camera.fy)

    def _covers(self, zoom: float) -> bool:
        """Whether the lens saw all of a pinhole frame, and did not fold it: along lines from the middle to the border, image
        points must move outwards and end inside the frame."""
        camera = self.zoomed(zoom)
        width, height = camera.width, camera.height
        edge = np.concatenate([
            np.stack(np.broadcast_arrays(x, y), axis=1) for x, y in (
                (np.linspace(0, width, 33), 0.0), (np.linspace(0, width, 33), height),
                (0.0, np.linspace(0, height, 33)), (width, np.linspace(0, height, 33)))])
        border = (edge - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        share = np.linspace(0, 1, 17)[1:]
        with np.errstate(all="ignore"):
            along = self.project((share[:, None, None] * border).reshape(-1, 2)).reshape(len(share), len(border), 2)
        distance = np.linalg.norm(along - (self.camera.cx, self.camera.cy), axis=2)
        slack = 1e-6 * max(width, height)
        inside = ((along[-1] >= -slack) & (along[-1] <= (width + slack, height + slack))).all()
        return bool(np.isfinite(distance).all() and (np.diff(distance, axis=0) > 0).all() and inside)

    def _text(self) -> str:
        return ", ".join(f"{name} {value:g}" for name, value in zip(COEFFICIENTS, self.coefficients, strict=True) if value)


def lens_of(camera: Camera, coefficients: dict[str, float]) -> Lens | None:
    """The lens of a camera with these coefficients by name; None if all are zero."""
    values = tuple(float(coefficients.get(name, 0.0)) for name in COEFFICIENTS)
    return Lens(camera, values) if any(values) else None


def without_distortion(
    cameras: Sequence[Camera], coefficients: Sequence[dict[str, float]],
) -> tuple[tuple[Camera, ...], tuple[Lens | None, ...] | None]:
    """Pinhole cameras in place of cameras with these coefficients, and the lenses of those that were distorted.

    Args:
        cameras: the cameras, at the size of their photographs.
        coefficients: for each its distortion coefficients by name; those that are missing are zero.

    Returns:
        The pinhole cameras, and the lenses; None in place of the lenses if no camera is distorted.

    Raises:
        InputError: see `Lens.pinhole`.
    """
    lenses = tuple(lens_of(camera, each) for camera, each in zip(cameras, coefficients, strict=True))
    zooms: dict[tuple[object, ...], float] = {}  # photographs of one camera have one lens, which is looked at once
    pinholes = []
    for camera, lens in zip(cameras, lenses, strict=True):
        if lens is None:
            pinholes.append(camera)
            continue
        key = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, lens.coefficients)
        if key not in zooms:
            zooms[key] = lens.zoom()
        pinholes.append(lens.zoomed(zooms[key]))
    return tuple(pinholes), lenses if any(lenses) else None
