"""Reads LLFF data sets: `poses_bounds.npy` beside a folder of photographs."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera, checked
from golden.scenes.colmap import find_images, read_points
from golden.scenes.conventions import camera_from_llff, up_of_cameras
from golden.scenes.dataset import Dataset, fit_to_images
from golden.scenes.files import read_bytes
from spec.errors import InputError

PHOTOGRAPHS = (".jpg", ".jpeg", ".png")


def load_llff(folder: Path) -> Dataset:
    """Loads the set in an LLFF folder. The rows of `poses_bounds.npy` belong to the photographs in the order of their names.

    A row is a 3x5 matrix (the pose, then height, width and focal length of the full-size photograph) followed by the scene's
    nearest and farthest depth. Points come from `sparse/0/points3D.bin` where it exists.

    Raises:
        InputError: the poses are malformed, or the number of photographs is not that of the poses.
    """
    path = folder / "poses_bounds.npy"
    try:
        rows = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
        poses = np.asarray(rows, np.float64)[:, :15].reshape(-1, 3, 5)
    except InputError:
        raise
    except Exception as error:  # numpy parses the header as Python, so a broken one raises nearly anything
        raise InputError(f"{path}: is not an array of 17 numbers a view ({error})") from error
    if rows.shape[1] != 17 or not np.isfinite(poses).all() or (poses[:, :, 4] < 1).any():
        raise InputError(f"{path}: shape {rows.shape}; (N, 17), finite, sizes and focal lengths from 1 on, is accepted")
    photographs = find_images(folder)
    images = sorted(p for p in photographs.iterdir() if p.suffix.lower() in PHOTOGRAPHS) if photographs else []
    if len(images) != len(poses):
        raise InputError(f"{path}: {len(poses)} poses, {len(images)} photographs in {photographs or folder}; one each needed")
    cameras = fit_to_images([_camera(pose, image) for pose, image in zip(poses, images, strict=True)], images)
    lone = folder / "sparse" / "0" / "points3D.bin"
    points, colours = read_points(lone) if lone.exists() else (np.empty((0, 3)), np.empty((0, 3), np.uint8))
    return Dataset(
        cameras=cameras, images=tuple(images), points=points, point_colours=colours,
        up=up_of_cameras(np.stack([camera.rotation for camera in cameras])), name=folder.absolute().name,
        depths=_depths(np.asarray(rows, np.float64)[:, 15:]),
    )


def _depths(bounds: np.ndarray) -> tuple[float, float] | None:
    """Nearest and farthest depth over all rows (N, 2); None if they bound nothing."""
    near, far = float(bounds[:, 0].min()), float(bounds[:, 1].max())
    return (near, far) if np.isfinite(bounds).all() and 0 < near < far else None


def _camera(pose: np.ndarray, image: Path) -> Camera:
    rotation, translation = camera_from_llff(pose)
    height, width, focal = pose[:, 4]
    camera = Camera(rotation=rotation, translation=translation, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
                    width=round(width), height=round(height), name=image.name)
    return checked(camera, f"pose of {image}")
