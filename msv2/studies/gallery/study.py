"""Draws the gallery: one frame of a scene plain, foveated, with its levels, its depth, for two eyes, and its error.

    msv2 study run gallery                     docs/gallery.md with docs/images/gallery_*.jpg, and the README's pictures
    msv2 study run gallery SCENE               another scene, a path or a captured scene's name: build/gallery/NAME/gallery.html
    msv2 study run gallery SCENE --screenshots also looks at that page in headless Chromium, at two widths

The README's pictures are `foveated.png`, a frame of four levels by the integer golden renderer, whose every bit is that of the
RTL, beside the levels of its tiles, and `renderers.png`, the panel of the demo: the ray-traced reference, the float64 oracle,
the golden renderer, their difference, the foveated frame and its levels, the depth, and the intersections of each tile.
The film is `film.webp`.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.camera_options import AUTO
from golden.scenes.captured import CAPTURED, scene_argument
from golden.scenes.embedded.scene import embedded_cameras, render_photograph
from golden.scenes.files import atomic_output
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.load import TRAINED, load_scene
from golden.scenes.pictures import depth_picture, levels_picture
from golden.scenes.request import add_scene_argument, make_folder, parse_size
from msv2.cli.demo import ERROR_GAIN, heat_picture, panel_picture
from msv2.studies.destination import place
from msv2.studies.gallery import pages
from msv2.studies.gallery.pictures import Shown, load_subject, pictures
from msv2.studies.page import write_page
from msv2.studies.record import input_name
from msv2.studies.tradeoff.scene import first_level
from msv2.studies.web.look import take_screenshots
from msv2.studies.web.maker import write_html
from msv2.video import command as video
from spec.command_line import command_parser
from spec.config import PAPER
from spec.errors import InputError
from spec.paths import BUILD, DOCS

FRAME, PANEL = (480, 270), (192, 144)
"""Sizes in pixels of the frame in `foveated.png` and of each picture in `renderers.png`."""

FOLDER = DOCS / "images"
SIZE = "640x360"
"""Size in pixels of the gallery's pictures."""

SHOWN = TRAINED
"""The scene of docs/gallery.md, as commands take it."""

INTRO = """\
This page shows a frame of the project's own scene in every way in which the machine can draw it.
`msv2 study run gallery` draws the pictures, and `msv2 study run gallery SCENE` draws those of another scene into
`build/gallery`. SCENE is a trained model's file or folder, or the name of a captured scene in `MSV2_DATA`, such as `truck`."""

FILM = ("--size", "320x180", "--frames", "24", "--fps", "8", "--gaze-path", "wander", "--quality", "65",
        "--format", "webp")
"""Options of `msv2 video` for the README's film, `film.webp`, and its still, `film.png`."""

PALETTE = 256
"""Colours of a picture, so that it is small."""


def foveated(size: tuple[int, int]) -> tuple[pipeline.Frame, np.ndarray]:
    """A frame of four levels with the gaze in its centre, and the picture of its levels as (H, W, 3) float in 0..1."""
    gaze = (size[0] / 2, size[1] / 2)
    foveation = foveation_map(Display(*size), gaze)
    frame = pipeline.render(load_scene(SHOWN).model, embedded_cameras(*size)[0], config=PAPER, foveation=foveation)
    return frame, levels_picture(frame.image, foveation)


def frame_and_levels(size: tuple[int, int]) -> np.ndarray:
    """The picture `foveated.png` as uint8."""
    frame, levels = foveated(size)
    return panel_picture([("foveated frame, four levels, the gaze in the centre", frame.image),
                          ("level of each tile: red is the fovea, mixed colours blend", levels)], 2)


def panels(size: tuple[int, int]) -> np.ndarray:
    """The picture `renderers.png` as uint8."""
    model, camera = first_level(load_scene(SHOWN).model), embedded_cameras(*size)[0]
    oracle, golden = render_oracle(model, camera), pipeline.render(model, camera, config=PAPER)
    frame, levels = foveated(size)
    return panel_picture([
        ("ray-traced reference", render_photograph(camera).astype(np.float64)), ("oracle (float64)", oracle.image),
        ("golden = RTL (integers)", golden.image),
        (f"|golden - oracle| x {ERROR_GAIN}", ERROR_GAIN * np.abs(golden.image - oracle.image)),
        ("foveated, four levels", frame.image), ("levels of the tiles", levels), ("depth", depth_picture(golden.depth)),
        ("intersections of a tile (log)", heat_picture(frame))], 4)


def draw_gallery(scene: str, size: str, camera: str) -> tuple[list[Shown], list[bytes]]:
    """Draws the gallery's pictures of a scene. Returns them, and their JPEG files."""
    shown, files = [], []
    for one in pictures(load_subject(scene, size, camera)):
        shown.append(one)
        files.append(pages.jpeg(one))
        print(f"{one.name}: {len(files[-1]) / 1024:.0f} KB", flush=True)
    return shown, files


def write_pictures(shown: Sequence[Shown], files: Sequence[bytes], folder: Path, prefix: str) -> list[Path]:
    """Writes the pictures as FOLDER/PREFIXname.jpg, and returns their paths."""
    paths = [folder / f"{prefix}{one.name}.jpg" for one in shown]
    for path, data in zip(paths, files, strict=True):
        with atomic_output(place(path)) as file:
            file.write(data)
    return paths


def write_document(size: str, document: Path, folder: Path) -> None:
    """Draws SHOWN, and writes its page and its pictures.

    Raises:
        InputError: the pictures are larger than the documentation takes.
    """
    shown, files = draw_gallery(SHOWN, size, AUTO)
    total = sum(map(len, files))
    if total > pages.MOST_BYTES:
        raise InputError(f"size {size!r} is not accepted: the pictures take {total:,} bytes, and at most {pages.MOST_BYTES:,} "
                         "may lie in docs/images; a smaller size is")
    written = write_pictures(shown, files, folder, "gallery_")
    paths = [Path(os.path.relpath(path, document.parent)).as_posix() for path in written]
    write_page(document, pages.as_markdown(shown, paths, "Gallery", SHOWN, INTRO))
    print(f"wrote {document}")


def write_scene(args: argparse.Namespace, out: Path) -> int:
    """Draws another scene, and writes its pages; 1 if screenshots are asked for and show a fault of the page."""
    shown, files = draw_gallery(args.scene, args.size, args.camera)
    written = write_pictures(shown, files, out, "")
    title, paths = f"Gallery of {out.name}", [path.name for path in written]
    named = input_name(args.scene) if Path(args.scene).exists() else args.scene
    made = f"`msv2 study run gallery {named}` draws these pictures."
    write_page(out / "gallery.md", pages.as_markdown(shown, paths, title, named, made))
    write_html(out / "gallery.html", pages.as_html(shown, paths, title, named))
    print(f"wrote {out / 'gallery.html'}, which shows the pictures beside it, and gallery.md")
    return 0 if not args.screenshots or take_screenshots(out / "gallery.html", make_folder(out / "screenshots")) else 1


def write_film(folder: Path) -> None:
    """Draws the README's film and one frame of it."""
    video.main([SHOWN, *FILM, "--out", str(BUILD / "gallery" / "film")])
    for name, made in (("film.webp", "film.webp"), ("film.png", "frames/00000.png")):
        with atomic_output(place(folder / name)) as file:
            file.write((BUILD / "gallery" / "film" / made).read_bytes())


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: draws the pictures and writes the pages."""
    parser = command_parser("msv2 study run gallery", __doc__)
    add_scene_argument(parser, "a model file or folder, the name of a captured scene", SHOWN)
    parser.add_argument("--size", metavar="WxH",
                        help=f"size of a frame (default: {SIZE}; of foveated.png {FRAME[0]}x{FRAME[1]})")
    parser.add_argument("--camera", default=AUTO, metavar="auto|orbit|INDEX|FILE", help="as for `msv2 render` (default: auto)")
    parser.add_argument("--screenshots", action="store_true", help="write build/gallery/NAME, and look at its page in Chromium")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="output folder (default: build/reports, --keep: docs/images; another scene or camera: "
                             "build/gallery/NAME)")
    args = parser.parse_args(argv)
    size = parse_size(args.size) if args.size else FRAME
    args.size = args.size or SIZE
    if args.scene in CAPTURED and not Path(args.scene).exists():
        args.scene = scene_argument(args.scene) or args.scene
    if args.scene != SHOWN or args.camera != AUTO or args.screenshots:
        name = Path(args.scene).name.partition(".")[0] or "scene"
        return write_scene(args, make_folder(args.out or BUILD / "gallery" / name))
    out = make_folder(args.out or FOLDER)
    write_document(args.size, out.parent / "gallery.md" if args.out is None else out / "gallery.md", out)
    for name, made in (("foveated", frame_and_levels(size)), ("renderers", panels(PANEL))):
        path = place(out / f"{name}.png")
        with atomic_output(path) as file:
            Image.fromarray(made).quantize(PALETTE).save(file, format="PNG", optimize=True)
        print(f"{path}: {path.stat().st_size / 1024:.0f} KB")
    write_film(out)
    return 0
