"""Posed photographs as one class, `Dataset`, whichever tool wrote them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.camera import Camera
from golden.scenes.files import is_file
from golden.scenes.lens import Lens
from spec.errors import InputError

UNREADABLE = (OSError, SyntaxError, ValueError, MemoryError, Image.DecompressionBombError)
"""The exceptions that Pillow raises on broken files: SyntaxError for a broken PNG, MemoryError for a part that announces
gigabytes, the last one for a header that announces more pixels than any photograph has."""

TEST_EVERY = 8
"""Every 8th photograph, from the first on, is held out for tests, as in Mip-NeRF 360 and every 3DGS paper since."""


@dataclass(frozen=True)
class Dataset:
    """Cameras, their photographs, and the points that structure from motion (SfM) reconstructed.

    Attributes:
        cameras: V cameras, in the order of the photographs' names.
        images: the photographs' paths, one per camera, or None where there are none.
        points: (P, 3) float64 SfM points in world units; P may be 0.
        point_colours: (P, 3) uint8 RGB.
        up: (3,) unit vector, world up.
        name: a short name for folders and reports.
        pose_error: (V,) float64, for each photograph the median distance between its keypoints and the projections of their 3D
            points, in pixels at the size of the reconstruction; nan where a photograph has no keypoints. None where the data
            set has no such numbers.
        lenses: for each camera the distorted lens that took its photograph, or None. `cameras` are pinholes in any case, and
            `pixels` removes the distortion. None where no lens is distorted.
        masks: for each photograph the path of its mask, or None; None where there are no masks.
        depths: nearest and farthest depth of the scene from its cameras, in world units; None where the data set has none.
    """

    cameras: tuple[Camera, ...]
    images: tuple[Path, ...] | None
    points: np.ndarray
    point_colours: np.ndarray
    up: np.ndarray
    name: str
    pose_error: np.ndarray | None = None
    lenses: tuple[Lens | None, ...] | None = None
    masks: tuple[Path | None, ...] | None = None
    depths: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.images is not None and len(self.images) != len(self.cameras):
            raise ValueError(f"images must be one per camera ({len(self.cameras)}), not {len(self.images)!r}")

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def test_views(self) -> tuple[int, ...]:
        """Indices of the held-out photographs and their cameras."""
        return tuple(range(0, len(self), TEST_EVERY))

    def pixels(self, index: int) -> np.ndarray:
        """Reads a photograph from disk (again at each call): (height, width, 4) uint8 RGBA, sRGB as stored, without the lens's
        distortion. A photograph without an alpha channel is opaque.

        Raises:
            InputError: this camera has no photograph, or it is unreadable or not of the camera's size.
        """
        if self.images is None:
            raise InputError(f"{self.name}: has cameras but no photographs")
        camera, path = self.cameras[index], self.images[index]
        try:
            with open_image(path) as image:
                rgba = np.asarray(image.convert("RGBA"))
        except UNREADABLE as error:
            raise InputError(f"{path}: is not a readable photograph ({error})") from error
        if rgba.shape[:2] != (camera.height, camera.width):
            raise InputError(f"{path}: is {rgba.shape[1]}x{rgba.shape[0]}, its camera {camera.width}x{camera.height}")
        lens = self.lenses[index] if self.lenses is not None else None
        return rgba if lens is None else lens.undistorted(rgba, camera)

    def photograph(self, index: int) -> np.ndarray:
        """`pixels` as (height, width, 3) float32 in 0..1. A photograph with alpha is composited over black, the renderers'
        background, as 3DGS does by default.

        Raises:
            InputError: as for `pixels`.
        """
        rgba = self.pixels(index).astype(np.float32) / np.float32(255)
        return rgba[..., :3] * rgba[..., 3:]


def open_image(path: Path) -> Image.Image:
    """The image in a regular file, not decoded yet. A pipe or a device is refused, because reading it might never end.

    Raises:
        OSError: there is no such file; and all of UNREADABLE.
    """
    if not is_file(path):
        raise OSError("no regular file")
    return Image.open(path)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header of a photograph.

    Raises:
        InputError: the file is missing or not an image.
    """
    try:
        with open_image(path) as image:
            return image.size
    except UNREADABLE as error:
        raise InputError(f"{path}: is not a readable photograph ({error})") from error


def fit_to_images(cameras: list[Camera], images: list[Path]) -> tuple[Camera, ...]:
    """Returns each camera at the size of its photograph: data sets come with photographs scaled down but not their intrinsics.

    Raises:
        InputError: a photograph is missing or unreadable, or has other proportions than its camera.
    """
    return tuple(_fitted(camera, path) for camera, path in zip(cameras, images, strict=True))


def _fitted(camera: Camera, image: Path) -> Camera:
    """The camera at the size of its photograph, which must be the camera's size times one scale, rounded to whole pixels."""
    width, height = image_size(image)
    scale = (width / camera.width + height / camera.height) / 2
    if abs(width - scale * camera.width) > 1 or abs(height - scale * camera.height) > 1:
        raise InputError(f"{image}: is {width}x{height}, its camera {camera.width}x{camera.height}; photographs of the "
                         "camera's proportions are accepted (was it cropped, rotated or taken for another?)")
    return camera if (camera.width, camera.height) == (width, height) else camera.resized(width, height)
