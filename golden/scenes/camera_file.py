"""Reads and writes one camera, and where the user looks, as a small JSON file, for `--camera FILE`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.camera import Camera, checked
from golden.scenes.files import atomic_output, number_of, read_json
from spec.errors import InputError

GAZE = "gaze"
"""The file's entry that is no property of a camera."""


def camera_text(camera: Camera, gaze: tuple[float, float] | None = None) -> str:
    """The content of a camera's file: every field under its name, and the gaze in pixels of the camera's frame, if any."""
    fields = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(camera).items()}
    return json.dumps(fields | ({} if gaze is None else {GAZE: list(gaze)}), indent=1) + "\n"


def save_camera(camera: Camera, path: Path | str, gaze: tuple[float, float] | None = None) -> None:
    """Writes `camera_text`; `load_camera` returns the camera exactly.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with atomic_output(path) as file:
        file.write(camera_text(camera, gaze).encode())


def file_gaze(path: Path | str, camera: Camera) -> tuple[float, float] | None:
    """The gaze in a camera's file, in pixels of `camera`, whose frame may have another size than the file's.

    Args:
        path: what `--camera` was given; it may be no file at all.
        camera: the camera of the frame.

    Raises:
        InputError: the entry is no pair of numbers; see also `load_camera`.
    """
    path = Path(path)
    if not path.is_file() or GAZE not in (entry := read_json(path)):
        return None
    stored = load_camera(path)
    x, y = _array(path, entry, GAZE, (2,))
    return float(x * camera.width / stored.width), float(y * camera.height / stored.height)


def load_camera(path: Path | str) -> Camera:
    """Loads the camera in a JSON file.

    The file holds `rotation` (3x3, world to camera, OpenCV axes), `translation`, `fx`, `fy`, `width` and `height`. It may hold
    `cx` and `cy` (by default the middle), `near`, `name`, and a `gaze`, which `file_gaze` reads. `translation` and `near` are
    in world units, the rest in pixels.

    Raises:
        InputError: an entry is missing, unknown or impossible.
    """
    path = Path(path)
    return _camera(path, read_json(path))


def load_cameras(path: Path | str) -> list[tuple[Camera, tuple[float, float] | None]]:
    """Loads the cameras of a path, each with its gaze in pixels of its own frame, or None.

    Args:
        path: a JSON object whose only entry `cameras` is a list of what `load_camera` reads from a file; or a folder of such
            files, which are taken in the order of their names.

    Raises:
        InputError: there is no camera, or one of them is not accepted; see `load_camera`.
    """
    path = Path(path)
    if path.is_dir():
        found = [(file, read_json(file)) for file in sorted(path.glob("*.json"))]
    else:
        content = read_json(path)
        listed = content.get("cameras")
        if set(content) != {"cameras"} or not isinstance(listed, list) or not all(isinstance(entry, dict) for entry in listed):
            raise InputError(f"{path}: is not a list of cameras; {{\"cameras\": [camera, ...]}} is accepted, or a folder of "
                             "camera files")
        found = [(path, entry) for entry in listed]
    if not found:
        raise InputError(f"{path}: has no camera; one or more are needed")
    cameras = [_camera(file, entry) for file, entry in found]
    gazes = [tuple(_array(file, entry, GAZE, (2,)).tolist()) if GAZE in entry else None for file, entry in found]
    return list(zip(cameras, gazes, strict=True))


def _camera(path: Path, entry: dict[str, Any]) -> Camera:
    unknown = set(entry) - {*Camera.__dataclass_fields__, GAZE}
    if unknown:
        accepted = ", ".join((*Camera.__dataclass_fields__, GAZE))
        raise InputError(f"{path}: {sorted(unknown)[0]!r} is not an entry of a camera; accepted are {accepted}")
    rotation, translation = _array(path, entry, "rotation", (3, 3)), _array(path, entry, "translation", (3,))
    width, height = (number_of(path, entry, key) for key in ("width", "height"))
    if not (width.is_integer() and height.is_integer()):
        raise InputError(f"{path}: frame size {width:g}x{height:g}; whole numbers from 1 on are accepted")
    camera = Camera(
        rotation=rotation, translation=translation, width=int(width), height=int(height),
        fx=number_of(path, entry, "fx"), fy=number_of(path, entry, "fy"),
        near=number_of(path, entry, "near", Camera.near), cx=number_of(path, entry, "cx", width / 2),
        cy=number_of(path, entry, "cy", height / 2), name=str(entry.get("name", path.stem)))
    return checked(camera, str(path))


def _array(path: Path, entry: dict[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(entry.get(key), np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{path}: {key} is {str(entry.get(key))[:60]}; {'x'.join(map(str, shape))} finite numbers are needed")
    return array
