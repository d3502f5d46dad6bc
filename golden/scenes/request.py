"""The arguments of a frame, the same for every command line: scene, camera, size, gaze, levels, background, two eyes,
effects."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.camera_file import file_gaze
from golden.scenes.camera_options import ORBIT, add_camera_arguments, choose_camera
from golden.scenes.files import atomic_output
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.level_source import RANDOM, add_levels_from, leveled
from golden.scenes.load import EMBEDDED, load_scene
from golden.scenes.model import MAX_LEVELS, GaussianModel
from golden.scenes.stereo import EYES
from golden.scenes.streamed import add_detail_argument
from spec.constants import ECC_THRESHOLD_DEG, IPD_METRES
from spec.effects import EFFECTS
from spec.errors import InputError

MAX_SIZE = 8192
"""Largest width and height of a frame that any renderer takes, in pixels; a machine may be configured for narrower rows."""


@dataclass(frozen=True)
class Request:
    """What a user asked to see, resolved into a model, a camera and a foveation map.

    Attributes:
        model: the Gaussians, with as many levels as asked for.
        camera: the camera, with the frame's size.
        foveation: tile levels and blend planes; without a gaze, level 1 everywhere.
        background: red, green and blue in [0, 1].
        record: the request as values for JSON; it is written beside every picture.
        cameras: the cameras that were stored with the scene.
    """

    model: GaussianModel
    camera: Camera
    foveation: FoveationMap
    background: tuple[float, float, float]
    record: dict[str, object]
    cameras: tuple[Camera, ...] = ()


class _Given(argparse.Action):
    """Stores a positional argument that can also be given as an option: without the argument, the option's value is left as
    it is."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option_string: str | None = None,
    ) -> None:
        if values is not self.default:
            setattr(namespace, self.dest, values)


def add_scene_argument(parser: argparse.ArgumentParser, what: str, default: str = EMBEDDED) -> None:
    """Adds the scene as `SCENE` or `--scene SCENE`; `what` names what is accepted besides `default`, a scene of the project."""
    parser.add_argument("scene", nargs="?", default=default, action=_Given, metavar="SCENE",
                        help=f"{what}, or '{default}' (default)")
    parser.add_argument("--scene", default=default, metavar="SCENE", help="the same as the argument SCENE")


def add_request_arguments(parser: argparse.ArgumentParser, size: str | None = None, scene: str = EMBEDDED) -> None:
    """Adds the arguments that `resolve` reads.

    Args:
        parser: the command line's parser.
        size: the default frame size as "WxH"; None means the size that the camera has.
        scene: the default scene. Commands that show a scene to a user take the trained one; studies and benchmarks keep the
            procedural one, so that their numbers stay.
    """
    default_size = size or "the camera's, else 640x360"
    other = f"model file or folder, '{EMBEDDED}'" if scene != EMBEDDED else "model file or folder"
    add_scene_argument(parser, other, scene)
    add_detail_argument(parser)
    parser.add_argument("--size", default=size, metavar="WxH", help=f"frame size (default: {default_size})")
    parser.add_argument("--gaze", metavar="X,Y|none",
                        help="the gazed pixel; it turns foveation on (default: that of the camera's JSON file, else none)")
    parser.add_argument("--levels", type=int, default=None, metavar="N",
                        help="foveation levels, 1..4 (default: the model's)")
    add_levels_from(parser)
    parser.add_argument("--background", default="0,0,0", metavar="R,G,B", help="background colour, in [0, 1] (default: 0,0,0)")
    parser.add_argument("--seed", type=int, default=0, help="seed of what is random in making levels (default: 0)")
    add_camera_arguments(parser)


def add_effect_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds `--effects` and `--depth`, which `golden.msv2_ref.plan.work_for` reads."""
    group = parser.add_argument_group("effects", "the effects that the scene and the request need are found and printed")
    group.add_argument("--effects", default="auto", metavar="auto|all|none|LIST",
                       help="auto runs the effects that are needed; all, or a list of " + ",".join(EFFECTS) + ", runs more on "
                       "neutral data, which changes no pixel; a list without a needed effect is refused (default: auto)")
    group.add_argument("--depth", action="store_true", help="compute a depth for every pixel")


ON, OFF = "on", "off"
"""Values of --second-sweep."""

OWN, SHARED = "own", "shared"
"""Values of --eye-colours: whether each eye of a joint frame has colours of its own, or both those of the source."""

_EYE_DEFAULTS = {
    "ecc_thresh": ECC_THRESHOLD_DEG, "ipd": IPD_METRES, "units_per_metre": None, "source": EYES[0], "gaze_right": None,
    "eye_colours": OWN, "second_sweep": ON}


def add_stereo_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of a frame for two eyes."""
    group = parser.add_argument_group("two eyes", "the camera is the source eye's; --gaze is the left eye's gaze, or the "
                                      "source's if --gaze-right is not given")
    group.add_argument("--stereo", action="store_true",
                       help="render one eye and warp it into the other, or, on machines with lists by super-tile, render both "
                       "from one set of lists")
    group.add_argument("--ecc-thresh", type=float, metavar="DEG",
                       help=f"eccentricity beyond which tiles may be warped (default: {ECC_THRESHOLD_DEG:g})")
    group.add_argument("--ipd", type=float, metavar="M", help=f"distance between the eyes in metres (default: {IPD_METRES})")
    group.add_argument("--units-per-metre", type=float, metavar="S",
                       help="scale of the scene; `msv2 study run metric_scale` computes it (default: the scene's, else 1)")
    group.add_argument("--source", metavar="left|right", help="the eye that is rendered as a whole (default: left)")
    group.add_argument("--gaze-right", metavar="X,Y",
                       help="the pixel at which the right eye looks (default: both eyes look at the same point)")
    group.add_argument("--eye-colours", metavar="own|shared",
                       help="on machines with lists by super-tile, whether the second eye has the first one's colours "
                       "(default: own)")
    group.add_argument("--second-sweep", metavar="on|off",
                       help="on machines with lists by super-tile that warp the second eye, whether tiles with holes are "
                       "rendered (default: on)")


def parse_request(*argv: str) -> argparse.Namespace:
    """The arguments of a request and of its eyes, for programs that ask for frames themselves. Without --camera
    and --levels-from, these are frames of the orbit with random levels, on which all kept reports were measured.

    Args:
        argv: as on a command line.

    Raises:
        InputError: see `take_stereo_arguments`.
    """
    parser = argparse.ArgumentParser()
    add_request_arguments(parser)
    add_stereo_arguments(parser)
    parser.set_defaults(camera=ORBIT, levels_from=RANDOM)
    args = parser.parse_args(argv)
    take_stereo_arguments(args)
    return args


def take_stereo_arguments(args: argparse.Namespace, *, joint: bool = False, warps: bool | None = None) -> None:
    """Fills in the defaults of the arguments for two eyes and sorts the gazes by eye.

    With `--source right`, `args.gaze` becomes the source eye's gaze and `args.gaze_target` the other eye's.

    Args:
        args: the arguments.
        joint: whether the frame is a joint one (`spec.joint`); in any other, the second eye is warped.
        warps: whether the second eye of a joint frame is warped (`spec.joint_warp`); None: where it is not a joint one.

    Raises:
        InputError: an argument for two eyes is given without --stereo, or one of warped frames for a joint one or the other way
            round; or the source eye is neither left nor right.
    """
    warps = not joint if warps is None else warps
    if args.stereo and not warps and args.ecc_thresh is not None:
        raise InputError(f"--ecc-thresh {args.ecc_thresh:g} is not accepted: this machine renders both eyes whole; configs "
                         "'paper' and 'v3_eyes_warp' warp the second one")
    if args.stereo and not (joint and warps) and args.second_sweep is not None:
        raise InputError(f"--second-sweep {args.second_sweep} is not accepted where no eye of a joint frame is warped: config "
                         "'v3_eyes_warp' takes it")
    if args.stereo and not joint and args.eye_colours is not None:
        raise InputError(f"--eye-colours {args.eye_colours} is not accepted where the second eye is warped: `msv2 render` with "
                         "config 'v3' takes it")
    for name, default in _EYE_DEFAULTS.items():
        if getattr(args, name) is None:
            setattr(args, name, default)
        elif not args.stereo:
            raise InputError(f"--{name.replace('_', '-')} {getattr(args, name)} is not accepted without --stereo")
    if args.second_sweep not in (ON, OFF):
        raise InputError(f"second sweep {args.second_sweep!r} is not accepted: choose one of {ON}, {OFF}")
    if args.eye_colours not in (OWN, SHARED):
        raise InputError(f"eye colours {args.eye_colours!r} are not accepted: choose one of {OWN}, {SHARED}")
    if args.source not in EYES:
        raise InputError(f"source eye {args.source!r} is not accepted: choose one of {', '.join(EYES)}")
    args.gaze_target = args.gaze_right
    if args.source == "right" and args.gaze_right is not None:
        left = None if (args.gaze or "none").lower() == "none" else args.gaze
        args.gaze, args.gaze_target = args.gaze_right, left


def resolve(args: argparse.Namespace) -> Request:
    """Loads the scene and makes the request that parsed arguments describe.

    Raises:
        InputError: an argument has a value of which no frame can be made.
    """
    size = parse_size(args.size) if args.size else None
    background = parse_numbers("background", args.background, 3)
    if not all(0 <= c <= 1 for c in background):
        raise InputError(f"background {args.background!r} is not accepted: three numbers in 0..1 are")
    gaze = None if (args.gaze or "none").lower() == "none" else parse_numbers("gaze", args.gaze, 2)
    if args.levels is not None and not 1 <= args.levels <= MAX_LEVELS:
        raise InputError(f"levels {args.levels} is not accepted: 1..{MAX_LEVELS} are")
    if args.seed < 0:
        raise InputError(f"seed {args.seed} is not accepted: 0 or more is")

    scene = load_scene(args.scene, getattr(args, "lod", None))
    model, source = leveled(scene.model, args)
    levels = min(args.levels or model.levels, model.levels)
    camera, chosen = choose_camera(args, scene, size)
    if args.gaze is None:
        gaze = file_gaze(args.camera, camera)
    display = Display(camera.width, camera.height)
    foveation = no_foveation(display) if gaze is None else foveation_map(display, tuple(gaze), levels)
    record = {
        "scene": str(args.scene), "camera": camera.name, "size": [camera.width, camera.height], "gaze": gaze, "levels": levels,
        "background": background, "seed": args.seed, **source, **chosen,
    }
    if scene.detail is not None:
        record |= {"lod": vars(scene.detail)}
        print(f"{args.scene}: {scene.detail.note}", file=sys.stderr)
    return Request(model, camera, foveation, tuple(background), record, scene.cameras)


def parse_size(text: str) -> tuple[int, int]:
    """Parses "WxH" into (width, height).

    Raises:
        InputError: the text has another form, or a size is outside 1..MAX_SIZE.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()) or not (1 <= int(width) <= MAX_SIZE and 1 <= int(height) <= MAX_SIZE):
        raise InputError(f"size {text!r} is not accepted: WxH with both in 1..{MAX_SIZE} is")
    return int(width), int(height)


def parse_numbers(name: str, text: str, count: int) -> list[float]:
    """Parses `count` finite numbers that are separated by commas.

    Raises:
        InputError: the text holds anything else; the message calls the value `name`.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(v) < float("inf") for v in values):
        raise InputError(f"{name} {text!r} is not accepted: {count} numbers separated by commas are")
    return values


def make_folder(path: Path | str) -> Path:
    """Creates a folder with its parents and returns its path.

    Raises:
        InputError: a file of that name exists, or the place is not writable.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output folder {path} is not accepted ({error.strerror}): a writable place is") from error
    return path


def write_json(path: Path, content: dict[str, object]) -> None:
    """Writes JSON that appears complete or not at all; infinities and NaNs become null."""
    text = json.dumps(content, indent=1, default=float)
    text = json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1)
    with atomic_output(path) as file:
        file.write((text + "\n").encode())
