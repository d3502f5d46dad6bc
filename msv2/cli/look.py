"""A contact sheet: a scene from eight cameras, each with the numbers that bring it back in any other command.

Without cameras of its own, a scene is shown from the camera that `--camera auto` takes, from five around it, from above, and
from close by. A scene with cameras is shown from four of its own and from four of those. look.png has the numbers printed on
it, and look.json holds them with what was measured: the coverage of each picture, and the share of the subject that it shows.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from golden.kernels import compile_note
from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.camera_options import (
    AUTO,
    add_camera_arguments,
    framing_record,
    given_fov,
    orientation_of,
    parse_point,
)
from golden.scenes.default_camera import fitted
from golden.scenes.eight_cameras import eight_cameras
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.load import EMBEDDED, TRAINED, Scene, load_scene
from golden.scenes.orbit import FOV_DEG
from golden.scenes.orientation import LOW, Orientation, axis_name
from golden.scenes.pictures import save_png, to_bytes
from golden.scenes.request import add_scene_argument, parse_size, write_json
from spec.command_line import add_out_argument, command_parser
from spec.config import PAPER
from spec.errors import InputError, run_command_line
from spec.paths import BUILD, short_path
from spec.private import output_folder

EXAMPLES = """\
examples:
  %(prog)s truck.splat                      eight cameras, in build/look/truck/look.png
  %(prog)s room.ply --up +z                 the same with z upwards
  %(prog)s truck.splat --look-at 0,0.2,0    around another point
"""
COLUMNS = 4
SIZE = "320x180"
CAPTION, TITLE = 38, 44
"""Heights in pixels of the text below each picture and above the sheet."""
OWN = 4
"""Number of a scene's own cameras on its sheet."""
PALE, DARK = (235, 235, 235), (24, 24, 24)


@dataclass(frozen=True)
class Shown:
    """One picture of a sheet.

    Attributes:
        title: what it shows.
        options: the command line options that bring this camera back.
        camera: the camera.
        record: numbers for JSON.
    """

    title: str
    options: str
    camera: Camera
    record: dict[str, object]


def shown_cameras(scene: Scene, args: argparse.Namespace, size: tuple[int, int]) -> tuple[Orientation, list[Shown]]:
    """The orientation of a scene and its eight cameras.

    Args:
        scene: the scene.
        args: `up`, `look_at` and `fov`.
        size: width and height of a picture in pixels.

    Raises:
        InputError: an argument is malformed.
    """
    orientation = orientation_of(scene, args.up)
    target = None if args.look_at is None else parse_point("look-at", args.look_at)
    common = "".join(f" --{name} {value}" for name, value in (
        ("up", None if args.up == AUTO else args.up), ("look-at", args.look_at), ("fov", args.fov)) if value is not None)
    framed = eight_cameras(
        scene.model, orientation.up, aspect=size[1] / size[0], fov_deg=given_fov(args) or FOV_DEG, target=target)
    around = [Shown(title, f"--orbit {found.standpoint.orbit}{common}", found.standpoint.camera(*size), framing_record(found))
              for title, found in framed]
    if not scene.cameras:
        return orientation, around
    chosen = np.unique(np.linspace(0, len(scene.cameras) - 1, OWN).round().astype(int))
    own = [Shown(scene.cameras[i].name, f"--camera {i}", fitted(scene.cameras[i], *size), {}) for i in chosen]
    return orientation, (own + [around[i] for i in (0, 3, 6, 7)] + [around[i] for i in (1, 2, 4, 5)])[: len(around)]


def rendered(scene: Scene, shown: Shown) -> tuple[np.ndarray, dict[str, object]]:
    """A camera's picture, (H, W, 3) uint8, and its numbers for JSON."""
    camera = shown.camera
    frame = pipeline.render(scene.model, camera, config=PAPER, foveation=no_foveation(Display(camera.width, camera.height)))
    coverage = float((1 - frame.transmittance).mean())
    return to_bytes(frame.image), {
        "title": shown.title, "options": shown.options, **shown.record, "estimated_coverage": shown.record.get("coverage"),
        "coverage": round(coverage, 4), "entries": len(frame.entries.splat)}


def sheet(title: list[str], pictures: list[tuple[list[str], np.ndarray]]) -> np.ndarray:
    """The contact sheet, uint8, with two lines of text above and two below each picture."""
    height, width = pictures[0][1].shape[:2]
    rows = -(-len(pictures) // COLUMNS)
    page = Image.new("RGB", (COLUMNS * width, TITLE + rows * (height + CAPTION)), DARK)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(13)
    for line, text in enumerate(title):
        draw.text((6, 4 + 18 * line), text, fill=PALE, font=font)
    for i, (lines, picture) in enumerate(pictures):
        x, y = i % COLUMNS * width, TITLE + i // COLUMNS * (height + CAPTION)
        page.paste(Image.fromarray(picture), (x, y))
        for line, text in enumerate(lines):
            draw.text((x + 6, y + height + 2 + 16 * line), text, fill=PALE, font=font)
    return np.asarray(page)


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = command_parser("python -m msv2 look", __doc__, EXAMPLES)
    add_scene_argument(parser, f"model file or folder, '{EMBEDDED}'", TRAINED)
    parser.add_argument("--size", default=SIZE, metavar="WxH", help=f"size of each picture (default: {SIZE})")
    add_camera_arguments(parser)
    add_out_argument(parser, "build/look/NAME")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    args = parse_arguments(argv)
    for name, value in (("camera", None if args.camera == AUTO else args.camera), ("orbit", args.orbit)):
        if value is not None:
            raise InputError(f"--{name} {value} is not accepted: msv2 look chooses eight cameras, msv2 render draws one")
    size = parse_size(args.size)
    begin, scene = time.perf_counter(), load_scene(args.scene)
    orientation, cameras = shown_cameras(scene, args, size)
    found = [rendered(scene, shown) for shown in cameras]
    up = f"up is {axis_name(orientation.up)}, confidence {orientation.confidence:.0%}, by {orientation.source}"
    if orientation.confidence < LOW and orientation.runner_up is not None:
        up += f"; if this lies or stands on its head, try --up {axis_name(orientation.runner_up)[:2]}"
    title = [f"{scene.model.name}: {len(scene.model):,} splats; {up}",
             f"copy the numbers to msv2 render {args.scene}, frame, perf or view"]
    captions = [([shown.options, _caption(shown, numbers)], picture)
                for shown, (picture, numbers) in zip(cameras, found, strict=True)]
    with output_folder(args.out, BUILD / "look" / scene.model.name) as out:
        save_png(out / "look.png", sheet(title, captions))
        write_json(out / "look.json", {
            "scene": str(args.scene), "splats": len(scene.model), "size": list(size), "orientation": orientation.record,
            "cameras": [numbers for _, numbers in found], "seconds": time.perf_counter() - begin})
    print(f"{short_path(out / 'look.png')}: eight cameras; {up}{compile_note()}")
    for shown in cameras:
        print(f"  {shown.title:<14} {shown.options}")
    return 0


def _caption(shown: Shown, numbers: dict[str, object]) -> str:
    seen = numbers.get("seen")
    shows = f"shows {seen:.0%}, " if isinstance(seen, float) else ""
    return f"{shown.title}: {shows}covers {numbers['coverage']:.0%}"


if __name__ == "__main__":
    run_command_line(main)
