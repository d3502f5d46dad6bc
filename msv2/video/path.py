"""Paths of the camera and of the gaze: where the film is from, frame by frame."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from golden.scenes.camera import Camera
from golden.scenes.camera_file import load_cameras
from golden.scenes.files import read_bytes
from spec.errors import InputError

ORBIT, WANDER = "orbit", "wander"
"""The path around what the first camera looks at, and the gaze that wanders over the frame; other names are files."""

Gaze = tuple[float, float]


@dataclass(frozen=True)
class Step:
    """One frame of a film.

    Attributes:
        camera: the camera with the frame's size.
        gaze: the gazed pixel, or None for no foveation.
    """

    camera: Camera
    gaze: Gaze | None


def orbit_path(first: Camera, up: np.ndarray, distance: float, sweep_deg: float, frames: int) -> list[Camera]:
    """Cameras on a circle around the point at `distance` on the first camera's axis.

    Args:
        first: the camera of the first frame; all frames have its size and focal length.
        up: (3,) the circle's axis, a unit vector.
        distance: world units.
        sweep_deg: 360 for a whole turn. A smaller angle swings from the first camera to both sides and back, so that the film
            can be repeated without a jump.
        frames: their number.
    """
    focus = first.position + distance * first.rotation[2]
    shares = np.arange(frames) / frames
    angles = 360 * shares if sweep_deg >= 360 else sweep_deg / 2 * np.sin(2 * math.pi * shares)
    cameras = []
    for number, angle in enumerate(angles):
        turn = Rotation.from_rotvec(math.radians(angle) * np.asarray(up, np.float64)).as_matrix()
        rotation = first.rotation @ turn.T
        position = focus + turn @ (first.position - focus)
        cameras.append(replace(first, rotation=rotation, translation=-rotation @ position, name=f"orbit-{number}-of-{frames}"))
    return cameras


def through(keys: Sequence[Camera], frames: int) -> list[Camera]:
    """Cameras on a smooth path through the given ones, which are reached at even spaces of time; one camera stands still.

    Positions and intrinsics follow monotone cubic curves, which do not overshoot, and the orientation turns at constant speed
    between two keys. All frames have the first key's size.
    """
    keys = [camera.resized(keys[0].width, keys[0].height) for camera in keys]
    if len(keys) == 1:
        return [keys[0]] * frames
    times = np.linspace(0, 1, len(keys))
    at = np.linspace(0, 1, frames) if frames > 1 else np.zeros(1)
    turns = Slerp(times, Rotation.from_matrix([camera.rotation for camera in keys]))(at).as_matrix()
    values = np.array([[*camera.position, camera.fx, camera.fy, camera.cx, camera.cy, camera.near] for camera in keys])
    smooth = PchipInterpolator(times, values)(at)
    return [replace(keys[0], rotation=turn, translation=-turn @ row[:3], name=f"path-{number}-of-{frames}",
                    fx=row[3], fy=row[4], cx=row[5], cy=row[6], near=row[7])
            for number, (turn, row) in enumerate(zip(turns, smooth, strict=True))]


def wandering_gaze(width: int, height: int, frames: int) -> list[Gaze]:
    """A gaze that wanders over the middle of the frame on a closed curve, in pixels."""
    angle = 2 * math.pi * np.arange(frames) / frames
    x, y = width * (0.5 + 0.3 * np.sin(angle)), height * (0.5 + 0.22 * np.sin(2 * angle))
    return [(float(column), float(row)) for column, row in zip(x, y, strict=True)]


def read_gazes(path: Path, width: int, height: int, frames: int) -> list[Gaze]:
    """The gaze of each frame from a CSV file with the columns `time,x,y`, interpolated linearly.

    `time` runs from 0 at the first frame to 1 at the last, in rising order; x and y are shares of the frame's width and height
    in 0..1, so that one file serves films of any size.

    Raises:
        InputError: the file has another form or values out of range; the message names the line.
    """
    rows = list(csv.DictReader(read_bytes(path).decode(errors="replace").splitlines()))
    if not rows or set(rows[0]) != {"time", "x", "y"}:
        raise InputError(f"{path}: a gaze path has the header time,x,y and one row or more")
    table = np.array([_gaze_row(path, line, row) for line, row in enumerate(rows, 2)])
    if (np.diff(table[:, 0]) <= 0).any():
        line = int(np.argmax(np.diff(table[:, 0]) <= 0)) + 3
        raise InputError(f"{path}: line {line}: time {table[line - 2, 0]:g} does not rise; rising times are accepted")
    at = np.linspace(0, 1, frames) if frames > 1 else np.zeros(1)
    places = [np.interp(at, table[:, 0], table[:, column]) for column in (1, 2)]
    return [(min(float(x) * width, width - 1e-3), min(float(y) * height, height - 1e-3))
            for x, y in zip(*places, strict=True)]


def _gaze_row(path: Path, line: int, row: dict[str, str]) -> list[float]:
    try:
        values = [float(row[name]) for name in ("time", "x", "y")]
    except (TypeError, ValueError):
        values = []
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        raise InputError(f"{path}: line {line}: {dict(row)} is not accepted: three numbers in 0..1 are")
    return values


def camera_path(name: str, frames: int, first: Camera, up: np.ndarray, distance: float, sweep_deg: float) -> list[Step]:
    """The film's cameras, and the gazes that a path's file gives.

    Args:
        name: ORBIT, or a file or folder that `load_cameras` reads.
        frames: their number.
        first, up, distance, sweep_deg: see `orbit_path`; the first camera also gives the size of all frames.

    Raises:
        InputError: the file is not accepted, or only some of its cameras have a gaze.
    """
    if name == ORBIT:
        return [Step(camera, None) for camera in orbit_path(first, up, distance, sweep_deg, frames)]
    keys = load_cameras(name)
    cameras = through([camera.resized(first.width, first.height) for camera, _ in keys], frames)
    gazes = [gaze and (gaze[0] / camera.width, gaze[1] / camera.height) for camera, gaze in keys]
    if not any(gazes):
        return [Step(camera, None) for camera in cameras]
    if not all(gazes):
        raise InputError(f"{name}: camera {gazes.index(None)} has no gaze, but others have; all or none are accepted")
    at = np.linspace(0, 1, frames) if frames > 1 else np.zeros(1)
    x, y = (np.interp(at, np.linspace(0, 1, len(gazes)), [gaze[axis] for gaze in gazes]) for axis in (0, 1))
    return [Step(camera, (float(column) * first.width, float(row) * first.height))
            for camera, column, row in zip(cameras, x, y, strict=True)]
