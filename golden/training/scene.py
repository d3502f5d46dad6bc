"""What a model is trained from: cameras, photographs, SfM points, and which views train, validate and test.

A *view* in the trainer is a camera together with its photograph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from golden.scenes.camera import Camera
from golden.scenes.dataset import TEST_EVERY, Dataset
from golden.scenes.datasets import load_dataset
from golden.scenes.embedded.scene import UP, embedded_cameras
from golden.training.embedded_photographs import EMBEDDED_VIEWS, photographs_and_points
from golden.training.photographs import area_resized, check_photographs, read_masks, read_photographs
from golden.training.random_points import random_points
from spec.errors import InputError

VALIDATE_EVERY = 8
"""Of the views that are no test views, every 8th validates. Gates read these, so that nothing is chosen by the test views."""

VALIDATE_LEAST = 5
"""Where an eighth is fewer views than this, more validate: a mean over two views says little about all other views."""

VALIDATE_EVERY_LEAST = 4
"""But never more than every 4th, so that enough views are left to train."""

MIN_EDGE = 32
"""Smallest frame edge in pixels: the HVSQ pyramid needs it, and it is above SSIM's window of 11."""

MIN_POINTS = 4
"""Smallest number of points: a point and its three nearest neighbours, which give its initial scale."""

DOUBTFUL_POSE = 2.0
"""A view whose pose error is more than this many times the median of all views is left out of training and validation. Its
photograph does not show what its camera says, so it would blur the model, and its PSNR would judge the pose."""

EXTENT_MARGIN = 1.1
"""3DGS's scene extent is the radius of the cameras' positions around their mean, times this factor."""

EMBEDDED_POINTS = 6000
"""Number of surface points that take the place of SfM points in the embedded scene."""

EMBEDDED_SIZE = (256, 256)
"""Default frame size of the embedded scene."""


@dataclass(frozen=True)
class TrainingScene:
    """V views, which are posed photographs of one size H x W, and P points.

    Attributes:
        name: a short name for folders and reports.
        up: (3,) unit vector, the scene's up direction in world axes.
        cameras: V cameras at the size that is trained at.
        images: (V, H, W, 3) uint8, the photographs.
        train, validation, test: indices of views; disjoint, and none is empty.
        doubtful: views whose poses the reconstruction itself contradicts; test views among them stay test views.
        extent: 3DGS's scene extent of the training cameras, in world units.
        points: (P, 3) float64, world units.
        colours: (P, 3) float64 in 0..1.
        masks: (V, H, W) bool, true where a photograph shows the scene; None if all pixels do.
        random_start: whether the points are random, because the data set has none.
    """

    name: str
    up: np.ndarray
    cameras: tuple[Camera, ...]
    images: np.ndarray
    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]
    extent: float
    points: np.ndarray
    colours: np.ndarray
    doubtful: tuple[int, ...] = ()
    masks: np.ndarray | None = None
    random_start: bool = False

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def judged(self) -> tuple[int, ...]:
        """The test views whose poses are not in doubt, over which means are taken; all test views if all are in doubt."""
        return tuple(view for view in self.test if view not in self.doubtful) or self.test

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of every view in pixels."""
        return self.cameras[0].width, self.cameras[0].height

    def photograph(self, index: int) -> torch.Tensor:
        """(H, W, 3) float32 in 0..1, display values; converted from the bytes at each call, which takes less than a
        millisecond."""
        return torch.from_numpy(self.images[index]).to(torch.float32).div_(255)

    def shown_share(self, index: int) -> float:
        """The share of a view's pixels that its mask does not hide."""
        return 1.0 if self.masks is None else float(self.masks[index].mean())

    def unmasked(self, index: int, image: torch.Tensor) -> torch.Tensor:
        """A rendering (H, W, 3) of a view with the photograph's pixels where the view's mask hides them.

        There, the result equals what it is compared with, and passes on no gradient, whichever loss or metric reads it.
        """
        if self.masks is None:
            return image
        shown = torch.from_numpy(self.masks[index]).to(image.device)
        return torch.where(shown[..., None], image, self.photograph(index).to(image.device))

    def with_views(self, cameras: Sequence[Camera], images: np.ndarray) -> TrainingScene:
        """The scene with further views, which neither train, validate nor test: their indices follow those of its own views.

        Args:
            cameras: cameras of the scene's size.
            images: (len(cameras), H, W, 3) uint8.
        """
        masks = self.masks
        if masks is not None:
            masks = np.concatenate([masks, np.ones(images.shape[:3], bool)])
        return replace(self, cameras=(*self.cameras, *cameras), images=np.concatenate([self.images, images]), masks=masks)

    def resized(self, width: int, height: int) -> TrainingScene:
        """The scene with smaller cameras and photographs; photographs are reduced by averaging over areas. A pixel of a reduced
        mask shows the scene if all of its area does."""
        if (width, height) == self.size:
            return self
        cameras, masks = tuple(camera.resized(width, height) for camera in self.cameras), self.masks
        if masks is not None:
            masks = area_resized(np.repeat(masks[..., None], 3, axis=3) * np.uint8(255), width, height)[..., 0] == 255
        return replace(self, cameras=cameras, images=area_resized(self.images, width, height), masks=masks)


def load_training_scene(
    path: Path | str, size: tuple[int, int] | None = None, *, points_needed: bool = True, views: int = EMBEDDED_VIEWS,
) -> TrainingScene:
    """Loads the scene at `path`, or the embedded one.

    Every 8th view is a test view, as everywhere in the field. Of the others, every 8th from the 4th on validates; in small data
    sets up to every 4th does. Pixels that a
    mask hides (a folder `masks`, `mask_path`) neither train nor judge; transparent pixels are composited over black. Distortion
    of lenses is removed. Photographs that a COLMAP model does not name are not used. Views with doubtful poses neither train
    nor validate. Points that are not finite are dropped. Where a data set has no points, random ones take their place.

    Args:
        path: a data set as `load_dataset` reads it, or 'embedded'.
        size: (width, height) to train at, no larger than the photographs and with their proportions; None for their size.
        points_needed: False if there is a trained model to start from.
        views: number of photographs of the embedded scene; other scenes have their own number.

    Raises:
        InputError: anything is wrong with the data set; the message names the file, the value and what is accepted.
    """
    if str(path) == "embedded":
        return _embedded(*(size or EMBEDDED_SIZE), views)
    path = Path(path)
    data = load_dataset(path)
    check_photographs(data, path)
    width, height = _accepted_size(data, size, path)
    finite = np.isfinite(data.points).all(axis=1)
    cameras = tuple(camera.resized(width, height) for camera in data.cameras)
    scene = divided_scene(data.name, data.up, cameras, read_photographs(data, width, height), data.points[finite],
                          data.point_colours[finite] / 255, doubtful_poses(data.pose_error), read_masks(data, width, height))
    if not points_needed or finite.sum() >= MIN_POINTS:
        return scene
    views = list(scene.train)
    points, colours = random_points([cameras[view] for view in views], scene.images[views], data.depths)
    return replace(scene, points=points, colours=colours, random_start=True)


def doubtful_poses(error: np.ndarray | None) -> tuple[int, ...]:
    """The views whose pose error (V,) is above DOUBTFUL_POSE times the median; views without a known error are trusted."""
    if error is None or not np.isfinite(error).any():
        return ()
    return tuple(int(i) for i in np.flatnonzero(error > DOUBTFUL_POSE * np.nanmedian(error)))


def _accepted_size(data: Dataset, size: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    full = data.cameras[0].width, data.cameras[0].height
    width, height = size or full
    if min(width, height) < MIN_EDGE or width > full[0] or height > full[1]:
        raise InputError(f"{path}: size {width}x{height} is not accepted: from {MIN_EDGE} pixels an edge up to the "
                         f"photographs' {full[0]}x{full[1]}")
    if abs(width * full[1] - height * full[0]) > max(full):  # more than a pixel off on either edge
        raise InputError(f"{path}: size {width}x{height} is not accepted: {width}x{round(width * full[1] / full[0])} has the "
                         f"proportions of the photographs, {full[0]}x{full[1]}")
    return width, height


def divided_scene(name: str, up: np.ndarray, cameras: tuple[Camera, ...], images: np.ndarray, points: np.ndarray,
                  colours: np.ndarray, doubtful: tuple[int, ...] = (), masks: np.ndarray | None = None) -> TrainingScene:
    """The scene with its views divided and its extent measured. It needs at least three views; fields are those of
    `TrainingScene`.

    The choice of validation views does not depend on `doubtful`: doubtful views are then left out of it. If training or
    validation would have no view left, no view is treated as doubtful.
    """
    test = tuple(range(0, len(cameras), TEST_EVERY))
    others = [i for i in range(len(cameras)) if i % TEST_EVERY]
    every = min(VALIDATE_EVERY, max(len(others) // VALIDATE_LEAST, VALIDATE_EVERY_LEAST))
    validation = tuple(others[min(every // 2 - 1, len(others) - 1) :: every])
    train = tuple(i for i in others if i not in validation)
    kept = [tuple(i for i in views if i not in doubtful) for views in (train, validation)]
    if all(kept):
        train, validation = kept
    else:
        doubtful = ()
    positions = np.array([cameras[i].position for i in train])
    extent = EXTENT_MARGIN * float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    if extent == 0:  # all training cameras are in one place, so the points say how large the scene is
        extent = float(np.linalg.norm(points - positions[0], axis=1).mean()) if len(points) else 1.0
    return TrainingScene(name=name, up=up, cameras=cameras, images=images, train=train, validation=validation, test=test,
                         extent=extent, points=points, colours=colours, doubtful=doubtful, masks=masks)


def _embedded(width: int, height: int, views: int) -> TrainingScene:
    """The embedded scene: ray-traced photographs, which are cached, and surface points in place of SfM points."""
    if min(width, height) < MIN_EDGE:
        raise InputError(f"size {width}x{height} is not accepted for the embedded scene: both must be at least {MIN_EDGE}")
    cameras = tuple(embedded_cameras(width, height, views))
    return divided_scene("embedded", UP, cameras, *photographs_and_points(cameras, EMBEDDED_POINTS))
