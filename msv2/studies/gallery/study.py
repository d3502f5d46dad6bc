"""Draws the README's pictures of the embedded scene: docs/images/foveated.png and docs/images/renderers.png.

    msv2 study run gallery                     seconds; needs no simulator
    msv2 study run gallery --size 480x270      larger pictures

`foveated.png` is a frame of four levels by the integer golden renderer, whose every bit is that of the RTL, beside the levels
of its tiles. The levels are random subsets of the points, as large as the levels that training keeps on this scene by
reports/training.json. `renderers.png` is the panel of the demo: the ray-traced reference, the float64 oracle, the golden
renderer, their difference, the foveated frame and its levels, the depth, and the intersections of each tile.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras, render_reference
from golden.scenes.files import atomic_output, read_json
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.levels import smfr_levels
from golden.scenes.model import GaussianModel
from golden.scenes.pictures import depth_picture, levels_picture
from golden.scenes.request import make_folder, parse_size
from msv2.cli.demo import ERROR_GAIN, heat_picture, panel_picture
from msv2.studies.destination import place
from msv2.studies.training.labels import OURS
from spec.command_line import command_parser
from spec.config import PAPER
from spec.paths import DOCS, REPORTS

FRAME, PANEL = (480, 270), (192, 144)
"""Sizes in pixels of the frame in `foveated.png` and of each picture in `renderers.png`."""

FOLDER, TRAINING = DOCS / "images", REPORTS / "training.json"
PALETTE = 256
"""Colours of a picture, so that it is small."""


def leveled(model: GaussianModel) -> GaussianModel:
    """The model with random nested subsets as levels, each with the share of the points that training leaves in it."""
    found = read_json(TRAINING)["scenes"][0]["comparison"]
    percent = next(row["points_percent"] for row in found if row["method"] == OURS)
    return smfr_levels(model, counts=[round(len(model) * share / 100) for share in percent])


def foveated(size: tuple[int, int]) -> tuple[pipeline.Frame, np.ndarray]:
    """A frame of four levels with the gaze in its centre, and the picture of its levels as (H, W, 3) float in 0..1."""
    gaze = (size[0] / 2, size[1] / 2)
    foveation = foveation_map(Display(*size), gaze)
    frame = pipeline.render(
        leveled(cached_embedded_model()), embedded_cameras(*size)[0], config=PAPER, foveation=foveation)
    return frame, levels_picture(frame.image, foveation)


def frame_and_levels(size: tuple[int, int]) -> np.ndarray:
    """The picture `foveated.png` as uint8."""
    frame, levels = foveated(size)
    return panel_picture([("foveated frame, four levels, the gaze in the centre", frame.image),
                          ("level of each tile: red is the fovea, mixed colours blend", levels)], 2)


def panels(size: tuple[int, int]) -> np.ndarray:
    """The picture `renderers.png` as uint8."""
    model, camera = cached_embedded_model(), embedded_cameras(*size)[0]
    oracle, golden = render_oracle(model, camera), pipeline.render(model, camera, config=PAPER)
    frame, levels = foveated(size)
    return panel_picture([
        ("ray-traced reference", render_reference(camera)[0].astype(np.float64)), ("oracle (float64)", oracle.image),
        ("golden = RTL (integers)", golden.image),
        (f"|golden - oracle| x {ERROR_GAIN}", ERROR_GAIN * np.abs(golden.image - oracle.image)),
        ("foveated, four levels", frame.image), ("levels of the tiles", levels), ("depth", depth_picture(golden.depth)),
        ("intersections of a tile (log)", heat_picture(frame))], 4)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: draws both pictures and writes them."""
    parser = command_parser("msv2 study run gallery", __doc__)
    parser.add_argument("--size", default="x".join(map(str, FRAME)), metavar="WxH",
                        help="size of the foveated frame (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=FOLDER, metavar="DIR",
                        help="output folder (default: build/reports; --keep: docs/images)")
    args = parser.parse_args(argv)
    size, out = parse_size(args.size), make_folder(args.out)
    for name, made in (("foveated", frame_and_levels(size)), ("renderers", panels(PANEL))):
        path = place(out / f"{name}.png")
        with atomic_output(path) as file:
            Image.fromarray(made).quantize(PALETTE).save(file, format="PNG", optimize=True)
        print(f"{path}: {path.stat().st_size / 1024:.0f} KB")
    return 0
