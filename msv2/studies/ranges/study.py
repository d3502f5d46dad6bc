"""`python -m msv2.cases ranges`: which values the records of real frames take."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from golden.msv2_ref.pipeline import render
from golden.scenes.request import resolve, write_json
from msv2.studies.ranges.ranges import Profiles, markdown, picture, profile
from spec.config import AcceleratorConfig
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import ROOT

EPILOG = """\
Writes ranges.json, ranges.md and ranges.png: of every field of every record the least and the largest value, how many lie at
the format's limit, and how many bits are spare. Without scenes: the embedded one, and those of MSV2_DATA where it is set.
Each scene is rendered without a gaze and with one in the frame's middle (four levels).

examples:
  python -m msv2.cases ranges
  python -m msv2.cases ranges truck.splat --size 1280x720
"""

TRAINED = ("truck.splat", "rock_sh3", "garden_large")
"""Folders and files of MSV2_DATA/trained that are taken without being named."""



def default_scenes() -> list[str]:
    """The embedded scene, and the trained ones that are there."""
    data = os.environ.get("MSV2_DATA")
    paths = [Path(data) / "trained" / name for name in TRAINED] if data else []
    return ["embedded", *(str(path) for path in paths if path.exists())]


def measure(scenes: Sequence[str], size: str, config: AcceleratorConfig) -> tuple[Profiles, dict[str, dict[str, int]]]:
    """Profiles over all scenes, and each scene's clipped and dropped values."""
    profiles: Profiles = {}
    clipped = {}
    for scene in scenes:
        for gaze, levels in (("none", None), ("middle", 4)):
            where = "none" if gaze == "none" else ",".join(str(int(part) // 2) for part in size.split("x"))
            request = resolve(argparse.Namespace(
                scene=scene, size=size, camera="orbit", gaze=where, levels=levels, background="0,0,0", seed=0))
            frame = render(request.model, request.camera, config=config, foveation=request.foveation,
                           background=request.background)
            name = f"{Path(scene).stem} {size}{', four levels' if levels else ''}"
            clipped[name] = profile(frame, profiles)
            print(f"{name}: {len(frame.entries.splat):,} pairs", flush=True)
    return profiles, clipped


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(
        prog="python -m msv2.cases", description=__doc__, epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("ranges",), help="ranges: value ranges of records")
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="model files, folders, or `embedded`")
    parser.add_argument("--size", default="640x360", help="frame size (default: 640x360)")
    add_config_arguments(parser, "paper")
    parser.add_argument("--out", default="build/stability", metavar="DIR", help="output folder (default: build/stability)")
    parser.add_argument("--keep", action="store_true", help="write into reports/ instead")
    args = parser.parse_args(argv)
    config = config_from(args)
    profiles, clipped = measure(args.scenes or default_scenes(), args.size, config)
    out = ROOT / "reports" if args.keep else Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    fields = [p.row for p in profiles.values()]
    write_json(out / "ranges.json", {
        "size": args.size, "config": config.name, "configuration": config_record(config), "scenes": clipped, "fields": fields})
    (out / "ranges.md").write_text(markdown(profiles, clipped), encoding="utf-8")
    picture(fields, out / "ranges.png")
    tight = [f"{p.record}.{p.field}" for p in profiles.values() if p.at_low + p.at_high]
    print(f"{out / 'ranges.md'}: {len(profiles)} fields; with values at the format's limit: {', '.join(tight) or 'none'}")
    return 0
