"""Measures the ranges of values in the records of real frames, for ranges.json, ranges.md and ranges.png."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from golden.msv2_ref.pipeline import render
from golden.scenes.captured import scene_argument
from golden.scenes.level_source import RANDOM
from golden.scenes.request import make_folder, parse_request, resolve
from msv2.studies.page import write_page
from msv2.studies.ranges.ranges import Profiles, markdown, picture, profile
from msv2.studies.record import write_report
from msv2.studies.scenes import MODELS
from spec.command_line import command_parser
from spec.config import AcceleratorConfig
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import REPORTS

EPILOG = """\
Writes ranges.json, ranges.md and ranges.png: for every field of every record the smallest and the largest value, the
number of values at the format's limit, and the number of spare bits. If no scene is named, the embedded scene and those of
MSV2_DATA are used. Each scene is rendered without a gaze, and with a gaze in the centre of the frame (four levels).

examples:
  msv2 study run ranges
  msv2 study run ranges truck.splat --size 1280x720
"""


def default_scenes() -> list[str]:
    """The embedded scene, and the captured scenes that are present."""
    return list(filter(None, map(scene_argument, MODELS)))


def measure(scenes: Sequence[str], size: str, config: AcceleratorConfig) -> tuple[Profiles, dict[str, dict[str, int]]]:
    """Profiles over all scenes, and for each scene the numbers of clipped values and dropped intersections."""
    profiles: Profiles = {}
    clipped = {}
    for scene in scenes:
        for gaze, levels in (("none", None), ("middle", 4)):
            where = "none" if gaze == "none" else ",".join(str(int(part) // 2) for part in size.split("x"))
            more = ("--levels", str(levels), "--levels-from", RANDOM) if levels else ()
            request = resolve(parse_request(scene, "--size", size, "--gaze", where, *more))
            frame = render(request.model, request.camera, config=config, foveation=request.foveation,
                           background=request.background)
            name = f"{Path(scene).stem} {size}{', four levels' if levels else ''}"
            clipped[name] = profile(frame, profiles)
            print(f"{name}: {len(frame.entries.splat):,} pairs", flush=True)
    return profiles, clipped


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = command_parser("msv2 study run ranges", __doc__, EPILOG)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="model files, folders, or `embedded`")
    parser.add_argument("--size", default="640x360", help="frame size (default: 640x360)")
    add_config_arguments(parser, "paper")
    parser.add_argument("--out", default=REPORTS, metavar="DIR", help="output folder (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    config, scenes = config_from(args), args.scenes or default_scenes()
    profiles, clipped = measure(scenes, args.size, config)
    out = make_folder(args.out)
    fields = [p.row for p in profiles.values()]
    report = {"size": args.size, "config": config.name, "configuration": config_record(config), "scenes": clipped,
              "fields": fields}
    write_report(out / "ranges.json", report, [__name__], {"arguments": args, "machine": config}, scenes)
    write_page(out / "ranges.md", markdown(profiles, clipped))
    picture(fields, out / "ranges.png")
    tight = [f"{p.record}.{p.field}" for p in profiles.values() if p.at_low + p.at_high]
    print(f"{out / 'ranges.md'}: {len(profiles)} fields; with values at the format's limit: {', '.join(tight) or 'none'}")
    return 0
