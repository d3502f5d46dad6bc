"""Reads cameras from JSON: `transforms.json` of nerfstudio and Blender, `cameras.json` of the INRIA trainer."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.camera import Camera, checked
from golden.scenes.conventions import UP_BY_FORMAT, camera_from_opencv, camera_from_opengl
from golden.scenes.dataset import Dataset, fit_to_images, image_size
from golden.scenes.files import atomic_output, is_file, number_of, read_any_json, read_bytes, read_json
from golden.scenes.lens import without_distortion
from golden.scenes.ply import parse_header, read_vertices
from spec.errors import InputError

CAMERAS = "cameras.json"
"""The file in which trainers leave their cameras beside a model."""

DISTORTION = ("k1", "k2", "k3", "p1", "p2")
"""Coefficients of a lens that is undistorted; nerfstudio's k4 is that of a polynomial which OpenCV's model does not have."""


def load_transforms(path: Path) -> Dataset:
    """Loads the set in a `transforms.json`, nerfstudio's (`fl_x` for the file or for each frame) or Blender's
    (`camera_angle_x`).

    If none of the photographs exists, the set has none, and the file must give the frame size. Points come from nerfstudio's
    `ply_file_path`.

    Raises:
        InputError: an entry is missing or malformed, a lens is a fisheye or has a fourth radial coefficient, or only some of
            the photographs exist.
    """
    meta = read_json(path)
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(f"{path}: frames is {str(frames)[:40]}; a list of frames is needed")
    frames = sorted(frames, key=lambda frame: str(frame.get("file_path")))
    images = [_image_path(path, frame) for frame in frames]
    found = [is_file(image) for image in images]
    if any(found) and not all(found):
        raise InputError(f"{images[found.index(False)]}: does not exist, but {sum(found)} of {len(images)} photographs do")
    entries = [{**meta, **frame} for frame in frames]
    distorted = [_camera(path, entry, image, all(found)) for entry, image in zip(entries, images, strict=True)]
    cameras, lenses = without_distortion(
        distorted, [{key: number_of(path, entry, key, 0.0) for key in DISTORTION} for entry in entries])
    points, colours = _points(path.parent / _text(path, meta, "ply_file_path")) if "ply_file_path" in meta else _no_points()
    return Dataset(cameras=cameras, images=tuple(images) if all(found) else None, points=points, point_colours=colours,
                   up=np.array(UP_BY_FORMAT["nerfstudio"]), name=path.absolute().parent.name, lenses=lenses,
                   masks=_masks(path, frames))


def _masks(path: Path, frames: list[dict[str, Any]]) -> tuple[Path | None, ...] | None:
    """The masks that frames name (nerfstudio's `mask_path`); None if none does."""
    named = tuple(path.parent / str(frame["mask_path"]) if frame.get("mask_path") else None for frame in frames)
    return named if any(named) else None


def _text(path: Path, entry: dict[str, Any], key: str) -> str:
    name = entry.get(key)
    if not isinstance(name, str) or not name:
        raise InputError(f"{path}: {key} is {name!r:.60}; the name of a file is needed")
    return name


def _image_path(path: Path, frame: dict[str, Any]) -> Path:
    image = path.parent / _text(path, frame, "file_path")
    return image if image.suffix else image.with_suffix(".png")  # Blender writes names without a suffix


def _pose(path: Path, entry: dict[str, Any]) -> np.ndarray:
    try:
        pose = np.array(entry.get("transform_matrix"), np.float64)
    except (TypeError, ValueError, OverflowError):
        pose = np.empty(0)
    if pose.shape not in ((3, 4), (4, 4)) or not np.isfinite(pose).all():
        raise InputError(f"{path}: transform_matrix of {entry['file_path']} is {str(entry.get('transform_matrix'))[:60]}; "
                         "a finite 3x4 or 4x4 matrix is needed")
    rotation = pose[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise InputError(f"{path}: transform_matrix of {entry['file_path']} is not rigid; rotation and translation are needed")
    return pose


def _camera(path: Path, entry: dict[str, Any], image: Path, image_exists: bool) -> Camera:
    fourth = number_of(path, entry, "k4", 0.0)
    if fourth or entry.get("is_fisheye") or "FISHEYE" in str(entry.get("camera_model", "")):
        what = f"distorted with k4 = {fourth:g}" if fourth else "a fisheye"
        raise InputError(f"{path}: the lens of {image.name} is {what}; a pinhole, or a lens with {', '.join(DISTORTION)}, is "
                         "accepted (colmap image_undistorter makes pinholes of others, then import its model)")
    rotation, translation = camera_from_opengl(_pose(path, entry))
    size = image_size(image) if image_exists else (0, 0)
    width, height = round(number_of(path, entry, "w", size[0])), round(number_of(path, entry, "h", size[1]))
    if width < 1 or height < 1:
        raise InputError(f"{path}: frame of {image.name} is {width}x{height} and {image} is missing; w and h are needed")
    if "fl_x" in entry:
        fx = number_of(path, entry, "fl_x")
        fy = number_of(path, entry, "fl_y", fx)
    else:
        angle = number_of(path, entry, "camera_angle_x")
        if not 0 < angle < math.pi:
            raise InputError(f"{path}: camera_angle_x is {angle:g}; an angle in 0..pi is needed")
        fx = fy = width / 2 / math.tan(angle / 2)
    camera = Camera(rotation=rotation, translation=translation, fx=fx, fy=fy, cx=number_of(path, entry, "cx", width / 2),
                    cy=number_of(path, entry, "cy", height / 2), width=width, height=height, name=image.name)
    checked(camera, f"{path}: {image.name}")
    return fit_to_images([camera], [image])[0] if image_exists else camera


def _points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    data = read_bytes(path)
    vertices = read_vertices(path, data, parse_header(data, path))
    missing = [key for key in ("x", "y", "z", "red", "green", "blue") if key not in vertices.dtype.names]
    if missing:
        raise InputError(f"{path}: property {missing[0]!r} is missing; x y z red green blue are needed")
    return (np.stack([vertices[key].astype(np.float64) for key in "xyz"], axis=1),
            np.stack([vertices[key].astype(np.uint8) for key in ("red", "green", "blue")], axis=1))


def _no_points() -> tuple[np.ndarray, np.ndarray]:
    return np.empty((0, 3)), np.empty((0, 3), np.uint8)


def load_inria_cameras(path: Path) -> tuple[Camera, ...]:
    """Loads a `cameras.json` of the INRIA trainer: camera to world in OpenCV axes, principal point in the middle unless `cx`
    and `cy` say otherwise.

    Raises:
        InputError: the file is not such a list of cameras.
    """
    entries = read_any_json(path)
    try:
        return tuple(checked(_inria_camera(entry), f"{path}: camera {index}") for index, entry in enumerate(entries))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not a cameras.json of a 3DGS trainer ({error!r:.200})") from error


def _inria_camera(entry: dict[str, Any]) -> Camera:
    pose = np.column_stack([np.array(entry["rotation"], np.float64), np.array(entry["position"], np.float64)])
    with np.errstate(invalid="ignore"):  # of an infinite position; the camera is checked
        rotation, translation = camera_from_opencv(pose)
    width, height = int(entry["width"]), int(entry["height"])
    return Camera(rotation=rotation, translation=translation, fx=float(entry["fx"]), fy=float(entry["fy"]),
                  cx=float(entry.get("cx", width / 2)), cy=float(entry.get("cy", height / 2)), width=width, height=height,
                  name=str(entry.get("img_name", entry.get("id", "camera"))))


def save_inria_cameras(cameras: Sequence[Camera], path: Path) -> None:
    """Writes cameras as the INRIA trainer's `cameras.json`, with the entries `cx` and `cy` added, which other tools ignore.

    `load_inria_cameras` returns the same cameras, up to the rounding of a matrix product, with the default near plane.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    entries = [
        {"id": index, "img_name": camera.name, "width": camera.width, "height": camera.height,
         "position": camera.position.tolist(), "rotation": camera.rotation.T.tolist(),
         "fy": float(camera.fy), "fx": float(camera.fx), "cx": float(camera.cx), "cy": float(camera.cy)}
        for index, camera in enumerate(cameras)]
    with atomic_output(path) as file:
        file.write((json.dumps(entries) + "\n").encode())
