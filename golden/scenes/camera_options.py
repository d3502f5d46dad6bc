"""The options that choose a frame's camera, and the camera that they choose.

    --camera auto             the scene's first camera; a scene without cameras is framed (`golden.scenes.default_camera`)
    --camera orbit            the first camera of the benchmarks' orbit (`golden.scenes.orbit`)
    --camera 3                one of the scene's cameras, or of the eight on that orbit if the scene has none
    --camera IMG_0042.JPG     the camera of this photograph
    --camera FILE.json        a camera from a file
    --orbit 30,20,3.5         a camera by azimuth, elevation and distance around the middle of the scene, or around --look-at
    --up, --look-at, --fov    change what these cameras assume
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.camera_file import load_camera
from golden.scenes.default_camera import Framing, as_wide, choose_framing, fitted
from golden.scenes.load import EMBEDDED, PROJECT_SCENES, TRAINED, Scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import FOV_DEG, orbit_camera
from golden.scenes.orientation import AXES, LOW, Orientation, axis_name, axis_vector, find_orientation
from golden.scenes.standpoint import Standpoint
from golden.scenes.subject import find_subject
from spec.command_line import nearest
from spec.errors import InputError

AUTO, ORBIT = "auto", "orbit"
ORBIT_VIEWS = 8
"""Number of cameras on the orbit from which `--camera INDEX` chooses when a model has no cameras of its own."""
DEFAULT_SIZE = (640, 360)
"""Frame size in pixels of a camera that no file describes."""
MAX_FOV_DEG = 170.0
_NEGATIVE = re.compile(r"^-(\d|\.\d|[xyz]$)")
_OPTIONS = ("orbit", "up", "look_at")


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds `--camera`, `--orbit`, `--fov`, `--up` and `--look-at`, which `choose_camera` reads."""
    group = parser.add_argument_group("camera", "without a name, a scene's first camera, or one that frames the scene's "
                                      "subject; msv2 look SCENE shows eight and their numbers")
    group.add_argument("--camera", default=AUTO, metavar="auto|orbit|INDEX|NAME|FILE",
                       help="auto (default), the benchmarks' orbit, the index or the name of one of the scene's cameras (the "
                            "index of one of eight on the orbit if it has none), or a JSON file")
    group.add_argument("--orbit", metavar="A,E,D",
                       help="azimuth and elevation in degrees, distance in world units, around the scene's middle or --look-at")
    group.add_argument("--fov", type=float, metavar="DEG",
                       help=f"horizontal field of view (default: the camera's, else {FOV_DEG:g})")
    group.add_argument("--up", metavar="auto|+x|-x|+y|-y|+z|-z",
                       help="the scene's up direction (default: auto, from file, cameras and model)")
    group.add_argument("--look-at", metavar="X,Y,Z", help="the point to look at, in world units (default: the scene's middle)")
    parser._negative_number_matcher = _NEGATIVE  # argparse would take "-y" and "-30,20,4" for options, not for values


def parse_orbit(text: str) -> tuple[float, float, float]:
    """Azimuth and elevation in degrees and distance in world units of "A,E,D".

    Raises:
        InputError: the text has another form, the elevation is beyond 90 degrees or the distance is not above 0.
    """
    azimuth, elevation, distance = _numbers("orbit", text)
    if abs(elevation) > 90 or distance <= 0:
        raise InputError(f"orbit {text!r} is not accepted: azimuth, elevation in -90..90 and a distance above 0 are")
    return azimuth, elevation, distance


def parse_up(text: str | None) -> np.ndarray | None:
    """(3,) the unit vector of an axis such as "-y"; None for "auto" and None.

    Raises:
        InputError: it is neither.
    """
    if text is None or text == AUTO:
        return None
    name = text if text[:1] in "+-" else f"+{text}"
    if name not in AXES:
        raise InputError(f"up {text!r} is not accepted: choose one of auto, {', '.join(AXES)}")
    return axis_vector(name)


def parse_point(name: str, text: str) -> np.ndarray:
    """(3,) the point "X,Y,Z" in world units.

    Raises:
        InputError: the text holds anything but three finite numbers; the message calls the value `name`.
    """
    return np.array(_numbers(name, text))


def _numbers(name: str, text: str) -> tuple[float, float, float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise InputError(f"{name} {text!r} is not accepted: 3 numbers separated by commas are")
    return values[0], values[1], values[2]


def orientation_of(scene: Scene, up: str | None = None) -> Orientation:
    """The scene's up: the one that a user asks for, or the one that `find_orientation` finds.

    Raises:
        InputError: `up` is no axis.
    """
    asked = parse_up(up)
    if asked is not None:
        return Orientation(asked, 1.0, "option", {"asked": str(up)})
    return find_orientation(scene.model, scene.cameras)


def choose_camera(
    args: argparse.Namespace, scene: Scene, size: tuple[int, int] | None,
) -> tuple[Camera, dict[str, object]]:
    """The camera that parsed arguments describe, and what was chosen for the user, as values for JSON.

    Args:
        args: `camera`, and where they exist `orbit`, `fov`, `up` and `look_at`.
        scene: the scene.
        size: width and height in pixels, None for the camera's own.

    Raises:
        InputError: an argument has a value that names no camera, or two of them contradict each other.
    """
    name, fov = args.camera, given_fov(args)
    given = [option for option in _OPTIONS if getattr(args, option, None) not in (None, AUTO)]
    if given and name != AUTO:
        raise InputError(f"--{given[0].replace('_', '-')} is not accepted with --camera {name}: leave out one of the two")
    if name == AUTO and (given or not scene.cameras):
        return _framed(args, scene, *(size or DEFAULT_SIZE), fov or FOV_DEG)
    camera = _named(name, scene, size)
    if fov is not None:
        focal = camera.width / 2 / math.tan(math.radians(fov) / 2)
        camera = replace(camera, fx=focal, fy=camera.fy * focal / camera.fx)
    return camera, {}


def given_fov(args: argparse.Namespace) -> float | None:
    """The horizontal field of view in degrees that the arguments ask for, None where they do not.

    Raises:
        InputError: it is not between 0 and MAX_FOV_DEG.
    """
    fov: float | None = getattr(args, "fov", None)
    if fov is not None and not 0 < fov <= MAX_FOV_DEG:
        raise InputError(f"fov {fov:g} is not accepted: more than 0 and at most {MAX_FOV_DEG:g} degrees are")
    return fov


def _framed(
    args: argparse.Namespace, scene: Scene, width: int, height: int, fov_deg: float,
) -> tuple[Camera, dict[str, object]]:
    orientation = orientation_of(scene, getattr(args, "up", None))
    orbit, look_at = getattr(args, "orbit", None), getattr(args, "look_at", None)
    target = None if look_at is None else parse_point("look-at", look_at)
    record: dict[str, object] = {"orientation": orientation.record}
    if orbit is None:
        found = choose_framing(scene.model, orientation.up, aspect=height / width, fov_deg=fov_deg, target=target)
        standpoint, record["standpoint"] = found.standpoint, framing_record(found)
    else:
        target = middle_of(scene.model) if target is None else target
        standpoint = Standpoint(target, orientation.up, *parse_orbit(orbit), fov_deg)
        record["standpoint"] = standpoint_record(standpoint)
    if orientation.confidence < LOW and orientation.runner_up is not None:
        print(f"up is {axis_name(orientation.up)} with a confidence of {orientation.confidence:.0%}; if the picture lies or "
              f"stands on its head, try --up {axis_name(orientation.runner_up)[:2]}", file=sys.stderr)
    return standpoint.camera(width, height), record


def middle_of(model: GaussianModel) -> np.ndarray:
    """(3,) the point that `--orbit` goes around, world units; the same that `choose_framing` looks at."""
    from golden.scenes.coarse import Discs

    discs = Discs.of(model)
    return find_subject(discs.means, discs.weight).middle


def standpoint_record(standpoint: Standpoint) -> dict[str, object]:
    """A standpoint as values for JSON: `--orbit`, `--look-at` and `--fov` reproduce it, with the same up."""
    point = ",".join(f"{x:.6g}" for x in standpoint.target)
    up = [round(float(x), 6) for x in standpoint.up]
    return {"orbit": standpoint.orbit, "look_at": point, "up": up, "fov_deg": standpoint.fov_deg}


def framing_record(found: Framing) -> dict[str, object]:
    """A standpoint and how much it shows."""
    shares = {"seen": found.seen, "contained": found.contained, "coverage": found.coverage, "obstruction": found.obstruction}
    return {**standpoint_record(found.standpoint), **{name: round(value, 3) for name, value in shares.items()}}


def _named(name: str, scene: Scene, size: tuple[int, int] | None) -> Camera:
    model, cameras = scene.model, scene.cameras
    if name == AUTO:
        camera = cameras[0]
        if model.name == EMBEDDED:  # its pixels are those of the kept reports
            return camera.resized(*size) if size else camera
        if model.name == TRAINED:  # the walls end where a fitted frame would begin to show more
            return as_wide(camera, *size) if size else camera
        return fitted(camera, *(size or _moderate(camera)))
    if name != ORBIT and not name.lstrip("-").isdigit():
        camera = _by_name(name, cameras)
        return camera.resized(*size) if size else camera
    index = 0 if name == ORBIT else int(name)
    count = len(cameras) or ORBIT_VIEWS
    if not 0 <= index < count:
        raise InputError(f"camera {name} is not accepted: 0..{count - 1}, 'auto', 'orbit', a camera's name or a JSON file are")
    if cameras and (name != ORBIT or model.name in PROJECT_SCENES):  # the project's cameras are an orbit
        return cameras[index].resized(*size) if size else cameras[index]
    return orbit_camera(model, index, ORBIT_VIEWS, *(size or DEFAULT_SIZE))


def _moderate(camera: Camera) -> tuple[int, int]:
    """The size of a camera's frame, reduced so that no edge is longer than the default's."""
    scale = min(1.0, DEFAULT_SIZE[0] / max(camera.width, camera.height))
    return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


def _by_name(name: str, cameras: Sequence[Camera]) -> Camera:
    """The camera of a photograph, by its name with or without folder and suffix, or the camera in a file."""
    for key in (str, lambda text: Path(text).name, lambda text: Path(text).stem.lower()):
        found = [camera for camera in cameras if key(camera.name) == key(name)]
        if len(found) == 1 and not Path(name).is_file():
            return found[0]
    if Path(name).exists() or not cameras or name.endswith(".json"):
        return load_camera(name)
    raise InputError(f"camera {name!r} is not accepted: auto, orbit, 0..{len(cameras) - 1}, one of the scene's cameras such as "
                     f"{cameras[0].name!r} or a JSON file are{nearest(name, [camera.name for camera in cameras])}")
