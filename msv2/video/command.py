"""`msv2 video`: a film of a scene along a camera path, drawn by the integer renderer, with the machine's numbers below."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean
from zlib import crc32

from tqdm import tqdm

from golden.scenes.camera_file import camera_text
from golden.scenes.files import read_json
from golden.scenes.pictures import save_png
from golden.scenes.request import (
    make_folder,
    write_json,
)
from msv2.video.caption import captioned
from msv2.video.film import parse_formats, write_film
from msv2.video.path import ORBIT, WANDER, Step, camera_path, read_gazes, wandering_gaze
from msv2.viewer.numbers import Numbers
from msv2.viewer.session import Session
from msv2.viewer.session_arguments import add_session_arguments, session_of
from msv2.viewer.state import OVERLAYS, State
from spec.command_line import add_out_argument, choice, command_parser
from spec.errors import InputError, run_command_line
from spec.overrides import config_record
from spec.paths import BUILD, short_path
from spec.private import output_folder
from spec.sources import fingerprint, sources_of

MOST_FRAMES = 10_000
NEAR_CAMERAS = 40.0
"""Degrees that the orbit swings in a scene with cameras of its own."""

EXAMPLES = """\
The numbers below a frame are those that msv2 perf gives for it. Frames that a run has drawn are kept in OUT/frames: an
interrupted run goes on where it stopped. The viewer (msv2 view) exports cameras; a folder of them is a path.

examples:
  %(prog)s                                            once around the project's scene
  %(prog)s truck.splat --sweep 40 --levels 4 --gaze-path wander --size 640x360
  %(prog)s room.ply --path cameras/ --frames 240 --fps 30 --format mp4
  %(prog)s rock_sh3/ --gaze-path eyes.csv --levels 4 --show levels
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = command_parser("msv2 video", __doc__, EXAMPLES)
    add_session_arguments(parser)
    group = parser.add_argument_group("the film")
    add = group.add_argument
    add("--path", default=ORBIT, metavar=f"{ORBIT}|FILE", help="a turn around what the camera looks at, or cameras: a JSON "
        'file {"cameras": [...]} or a folder of camera files (default: orbit)')
    add("--sweep", type=float, metavar="DEG",
        help=f"angle of the orbit; less than 360 swings to both sides and back (default: 360, or {NEAR_CAMERAS:g} where the "
             "scene has its own cameras, because it is sure to look right near them only)")
    add("--gaze-path", metavar=f"{WANDER}|FILE", help="the gaze over time: wander, or a CSV file time,x,y with values in 0..1")
    add("--frames", type=int, default=48, metavar="N", help="number of frames (default: 48)")
    add("--fps", type=float, default=12.0, metavar="F", help="frames a second (default: 12)")
    add("--format", metavar="webp,gif,mp4", help="one or more formats (default: webp, and mp4 where ffmpeg is found)")
    add("--quality", type=int, default=80, metavar="Q", help="quality of WebP, 1..100 (default: 80)")
    add("--show", default="none", metavar="|".join(OVERLAYS), help="what is drawn over the frames (default: none)")
    add("--no-numbers", action="store_true", help="leave out the strip with the machine's numbers")
    add_out_argument(parser, "build/video/NAME")
    return parser.parse_args(argv)


def check(args: argparse.Namespace) -> None:
    """Refuses values of which no film can be made.

    Raises:
        InputError: the message names the value and what is accepted.
    """
    choice("overlay", args.show, OVERLAYS)
    for name, value, low, high in (("frames", args.frames, 1, MOST_FRAMES), ("fps", args.fps, 0.1, 100),
                                   ("sweep", args.sweep or 0, 0, 360), ("quality", args.quality, 1, 100)):
        if not low <= value <= high:
            raise InputError(f"{name} {value:g} is not accepted: {low:g}..{high:,} is")


def steps_of(args: argparse.Namespace, session: Session) -> list[Step]:
    """The film's frames: the camera's path, and the gaze of the gaze path, of the camera path's file, or of `--gaze`.

    Raises:
        InputError: a file is not accepted.
    """
    first, count = session.state.camera, args.frames
    sweep = (NEAR_CAMERAS if session.has_cameras else 360.0) if args.sweep is None else args.sweep
    path = camera_path(args.path, count, first, session.up, session.focus_distance(first), sweep)
    if args.gaze_path == WANDER:
        gazes = wandering_gaze(first.width, first.height, count)
    elif args.gaze_path:
        gazes = read_gazes(Path(args.gaze_path), first.width, first.height, count)
    else:
        gazes = [step.gaze or session.state.gaze for step in path]
    return [Step(step.camera, gaze) for step, gaze in zip(path, gazes, strict=True)]


def cells(number: int, count: int, numbers: Numbers) -> list[tuple[str, str]]:
    """What the strip under a frame says: values and their names."""
    return [(f"{number + 1}/{count}", "frame"), (f"{numbers.cycles.entries:,}", "intersections"),
            (f"{numbers.cycles.total:,}", "cycles"),
            (f"{numbers.frames_per_s:,.0f}", f"frames/s at {numbers.energy.clock_hz / 1e9:.3g} GHz"),
            (f"{numbers.energy.total_mj:.3f}", "mJ")]


def draw(session: Session, state: State, number: int, count: int, strip: bool, picture: Path) -> dict[str, object]:
    """Draws one frame, writes it, and returns its numbers; they are written beside it, last, so that they mark it as whole."""
    image = session.picture(state).image
    numbers = session.numbers(state)
    save_png(picture, captioned(image, cells(number, count, numbers) if strip else ()))
    record = {"frame": number, "gaze": state.gaze, "intersections": numbers.cycles.entries, "cycles": numbers.cycles.total,
              "frames_per_s": numbers.frames_per_s, "energy_mj": numbers.energy.total_mj}
    write_json(picture.with_suffix(".json"), record)
    return record


def identity(args: argparse.Namespace, session: Session, steps: Sequence[Step]) -> dict[str, object]:
    """What all frames depend on: a run takes up the frames of an earlier one only where this is the same."""
    told = {name: value for name, value in vars(args).items() if name not in ("out", "format", "fps", "quality")}
    cameras = "".join(camera_text(step.camera, step.gaze) for step in steps)
    return {**json.loads(json.dumps(told, default=str)), "model": model_checksum(session),
            "sources": fingerprint(sources_of(__name__)), "path": crc32(cameras.encode())}


def model_checksum(session: Session) -> int:
    """A checksum of the model's words."""
    words = session.work(session.state).words
    return crc32(words.colour.tobytes(), crc32(words.geometry.tobytes()))


def film(args: argparse.Namespace, session: Session, steps: Sequence[Step], folder: Path) -> list[dict[str, object]]:
    """Draws the frames that `folder` does not hold yet; the numbers of all frames.

    Raises:
        InputError: the folder holds files that no film has left there.
    """
    folder = make_folder(folder)
    wanted, told = identity(args, session, steps), folder / "request.json"
    if not told.exists() and any(folder.iterdir()):
        raise InputError(f"folder {folder} is not accepted for the frames of a film: it holds files of something else")
    if not told.exists() or read_json(told) != wanted:
        for old in (*folder.glob("*.png"), *folder.glob("*.json")):
            old.unlink()
        write_json(told, wanted)
    found = []
    for number, step in enumerate(tqdm(steps, desc="frames", unit="frame")):
        picture = folder / f"{number:05}.png"
        if picture.exists() and picture.with_suffix(".json").exists():
            found.append(read_json(picture.with_suffix(".json")))
            continue
        state = replace(session.state, camera=step.camera, gaze=step.gaze, overlay=args.show)
        found.append(draw(session, state, number, len(steps), not args.no_numbers, picture))
    return found


def main(argv: Sequence[str] | None = None) -> None:
    """The command line's work."""
    args = parse_arguments(argv)
    check(args)
    formats = parse_formats(args.format)
    session = session_of(args)
    steps = steps_of(args, session)
    default = BUILD / "video" / session.name
    with output_folder(args.out or default, default) as out:  # to go on means one certain folder
        write(args, session, steps, formats, out)


def write(args: argparse.Namespace, session: Session, steps: Sequence[Step], formats: Sequence[str], out: Path) -> None:
    """Draws the frames and writes the films and their numbers into the folder `out`."""
    rows = film(args, session, steps, out / "frames")
    pictures = [out / "frames" / f"{number:05}.png" for number in range(len(steps))]
    for form in formats:
        write_film(out / f"film.{form}", pictures, args.fps, args.quality)
    sums = {f"mean_{name}": mean(row[name] for row in rows) for name in rows[0] if name not in ("frame", "gaze")}
    write_json(out / "film.json", {
        "scene": str(args.scene), "size": list(session.state.size), "path": args.path, "gaze_path": args.gaze_path,
        "levels": session.state.levels, "fps": args.fps, "configuration": config_record(session.config), **sums,
        "frames": rows})
    names = ", ".join(f"film.{form} {(out / f'film.{form}').stat().st_size / 1e6:.2f} MB" for form in formats)
    print(f"{short_path(out)}: {names}; on average {sums['mean_cycles']:,.0f} cycles, {sums['mean_energy_mj']:.3f} mJ a frame")


if __name__ == "__main__":
    run_command_line(main)
