"""Measures the levels that models without trained levels get: their quality against the full model, and their intersections.

    msv2 study run untrained_levels              every scene that is present; fills the table of docs/levels.md
    msv2 study run untrained_levels truck        one scene; with scenes named, only the JSON file is written
    msv2 study run untrained_levels --pictures   also draws the frames of each scene side by side, in build/untrained_levels

A frame has four levels and the gaze in its centre, and is rendered by the integer golden renderer. It is compared with the
frame of the full model, both rounded to 8 bits, over the whole frame. The cameras are on the project's orbit of 8 cameras, and
one is 38 degrees above the horizon instead of 20. Levels are fitted to other cameras.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from golden.kernels import compile_seconds
from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.camera_options import ORBIT_VIEWS
from golden.scenes.captured import scene_argument
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.level_fit import enhanced_levels
from golden.scenes.level_source import ENHANCED, RANDOM, SPREAD
from golden.scenes.levels import smfr_levels, spread_levels
from golden.scenes.load import load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.pictures import save_png
from golden.scenes.request import make_folder
from msv2.cli.demo import panel_picture
from msv2.studies import page
from msv2.studies.record import write_report
from msv2.studies.scenes import MODELS
from spec.command_line import choice, command_parser
from spec.config import PAPER
from spec.errors import InputError
from spec.paths import BUILD, DOCS, REPORTS

WIDTH, HEIGHT = 640, 360

CAMERAS = {"orbit 0": (0, 20.0), "orbit 3": (3, 20.0), "from above": (1, 38.0)}
"""By name: the index on the orbit of ORBIT_VIEWS cameras, and the elevation in degrees."""

MAKERS = {RANDOM: smfr_levels, SPREAD: spread_levels, ENHANCED: enhanced_levels}

PAGE, TABLE = DOCS / "levels.md", "untrained_levels"

PICTURES = BUILD / "untrained_levels"


def rounded(image: np.ndarray) -> np.ndarray:
    """Colours (..., 3) as a display of 8 bits shows them, float64 in 0..1."""
    return np.round(np.clip(image, 0, 1) * 255) / 255


def camera_of(model: GaussianModel, name: str, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Camera:
    """The camera of CAMERAS with this name."""
    index, elevation = CAMERAS[name]
    return orbit_camera(model, index, ORBIT_VIEWS, *size, elevation_deg=elevation)


def full_frame(model: GaussianModel, camera: Camera) -> np.ndarray:
    """(H, W, 3): the frame of level 1 everywhere, rounded to 8 bits."""
    return rounded(pipeline.render(model, camera, config=PAPER).image)


def compare(full: np.ndarray, leveled: GaussianModel, camera: Camera) -> tuple[float, int, np.ndarray]:
    """PSNR in dB of the foveated frame against the full one, its intersections, and the frame (H, W, 3), rounded to 8 bits."""
    foveation = foveation_map(Display(camera.width, camera.height), (camera.width / 2, camera.height / 2), leveled.levels)
    frame = pipeline.render(leveled, camera, config=PAPER, foveation=foveation)
    shown = rounded(frame.image)
    return psnr_vs(shown, full), len(frame.entries.splat), shown


def measure(name: str, model: GaussianModel, pictures: Path | None) -> Iterator[dict[str, object]]:
    """One row for each source of levels; draws the frames of the first camera into `pictures`, unless it is None."""
    cameras = {camera: camera_of(model, camera) for camera in CAMERAS}
    full = {camera: full_frame(model, cameras[camera]) for camera in CAMERAS}
    first = next(iter(CAMERAS))
    panels = [("full model", full[first])]
    for source, make in MAKERS.items():
        begin = time.process_time() - compile_seconds()
        leveled = make(model)
        seconds = time.process_time() - compile_seconds() - begin
        row: dict[str, object] = {"scene": name, "points": len(model), "source": source, "cpu_seconds": seconds,
                                  "points_by_level": [int((leveled.quality_bound > level).sum()) for level in range(4)]}
        for camera in CAMERAS:
            psnr, intersections, shown = compare(full[camera], leveled, cameras[camera])
            row[camera] = {"psnr_db": psnr, "intersections": intersections}
            if camera == first:
                panels.append((f"{source}: {psnr:.1f} dB, {intersections:,} intersections", shown))
        print(f"{name}, {source}: {_cells(row)[2:]}", flush=True)
        yield row
    if pictures:
        save_png(make_folder(pictures) / f"{name}.png", panel_picture(panels, 2))


def _cells(row: Mapping) -> list[str]:
    cameras = [f"{row[name]['psnr_db']:.1f} dB, {row[name]['intersections']:,}" for name in CAMERAS]
    return [row["scene"], row["source"], *cameras, f"{row['cpu_seconds']:.1f} s"]


def table(rows: Sequence[Mapping]) -> str:
    """The table of docs/levels.md."""
    return page.table(("scene", "`--levels-from`", *CAMERAS, "processor time"), map(_cells, rows), left=2)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = command_parser("msv2 study run untrained_levels", __doc__)
    parser.add_argument("scenes", nargs="*", default=[], metavar="SCENE", help=f"scenes (default: {', '.join(MODELS)})")
    parser.add_argument("--pictures", action="store_true", help=f"draw the frames, in {PICTURES.parent.name}/{PICTURES.name}")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR", help="output folder (default: reports)")
    args = parser.parse_args(argv)
    places = {name: scene_argument(choice("scene", name, MODELS)) for name in args.scenes or MODELS}
    missing = [name for name, place in places.items() if place is None]
    if missing and args.scenes:
        raise InputError(f"scene {missing[0]!r} is not accepted: MSV2_DATA does not have it")
    rows = [row for name, place in places.items() if place
            for row in measure(name, load_scene(place).model, PICTURES if args.pictures else None)]
    report = {"size": [WIDTH, HEIGHT], "levels": 4, "rows": rows}
    write_report(make_folder(args.out) / "untrained_levels.json", report, [__name__], {"arguments": args, "machine": PAPER},
                 [place for place in places.values() if place])
    print(table(rows))
    return 0 if args.scenes or missing else page.fill(PAGE, {TABLE: lambda: table(rows)}, complete=True)
