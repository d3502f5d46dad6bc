"""Measures the threshold of selective warping: quality, tiles, intersections and cycles of frames of two eyes, and the
threshold that follows from them."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from golden.diff import import_torch
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder
from msv2.studies.page import write_page
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.constants import ECC_THRESHOLD_DEG, IPD_METRES, REGION_START_DEG
from spec.errors import InputError

THRESHOLDS = tuple(float(start) for start in REGION_START_DEG)
"""The thresholds of the paper: the starts of the regions, 0, 18, 27 and 33 degrees."""

EXAMPLES = """examples:
  msv2 study run threshold                                        the embedded scene
  msv2 study run threshold build/train/bonsai@640x426 --train-v1  a finished run of golden/train.py, and v1's levels
  beside it
  msv2 study run threshold truck.splat --units-per-metre 0.15 --rtl all   cycles of the first pose by the RTL too

A run's folder or model.ply is judged by the run's dense model and seen from its test views; the v1 model that picks the
threshold is RUN-v1/model.ply, as golden/train.py --no-opacity-enhancement writes it; --train-v1 makes it of the run's own L1.
Any other model gets untrained levels where it has none and no v1 model. After Ctrl-C the same command goes on. Writes
OUT/NAME.json, NAME.md and NAME.png.
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed command line."""
    parser = command_parser("msv2 study run threshold", __doc__, EXAMPLES)
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE[@WxH]", help="models, folders of training runs, or embedded (default: embedded)")
    add("--size", default="640x360", metavar="WxH", help="frame size of scenes that are given without one (default: 640x360)")
    add("--poses", type=int, default=2, metavar="N",
        help="number of poses of each scene, spread evenly over its views (default: 2)")
    add("--thresholds", default=",".join(f"{t:g}" for t in THRESHOLDS), metavar="DEG,DEG",
        help="eccentricity thresholds (default: %(default)s)")
    add("--ipd", type=float, default=IPD_METRES, metavar="M", help="distance between the eyes in metres (default: %(default)s)")
    add("--units-per-metre", type=float, metavar="S", help="scale of all scenes (default: known or assumed, by name)")
    add("--v1", metavar="MODEL", help="the v1 model, if there is only one scene (default: RUN-v1/model.ply)")
    add("--train-v1", action="store_true", help="train the v1 model where a run has none (as long as three levels of the run)")
    add("--rtl", default="none", metavar="all|NAME,NAME",
        help="scenes whose first pose is also simulated in RTL, at 18 degrees (minutes)")
    add("--rtl-eyes", action="store_true", help="simulate also each eye of that pose alone (more minutes)")
    add("--work", default="build/table-ecc/kept", metavar="DIR", help="cache of measurements")
    add("--out", default="build/table-ecc", metavar="DIR", help="folder of NAME.json, NAME.md and NAME.png")
    add("--name", default="table_ecc", help="name of those files (default: table_ecc)")
    return parser.parse_args(argv)


def chosen_thresholds(text: str) -> tuple[float, ...]:
    """The thresholds in degrees, in ascending order.

    Raises:
        InputError: a part is not a number in 0..180.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = [math.nan]
    for value in values:
        if not 0 <= value <= 180:
            raise InputError(f"thresholds {text!r} are not accepted: numbers in 0..180 degrees, separated by commas, are")
    return tuple(sorted(set(values)))


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns its exit status."""
    args = parse_arguments(argv)
    thresholds = chosen_thresholds(args.thresholds)
    for name, value in (("IPD", args.ipd), ("units per metre", args.units_per_metre)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} {value!r} is not accepted: a positive number is")
    if args.v1 and len(args.scenes) != 1:
        raise InputError(f"--v1 {args.v1} is not accepted with {len(args.scenes)} scenes: one is")
    if args.rtl != "none" and ECC_THRESHOLD_DEG not in thresholds:
        raise InputError(f"--rtl is not accepted without the threshold {ECC_THRESHOLD_DEG:g}: it is simulated at that one")
    import_torch()
    from golden.training.chain import Interrupted

    out, records = make_folder(args.out), []
    try:
        for text in args.scenes or [EMBEDDED]:
            records.append(measured(args, text, thresholds))
            write(out, args, records)
    except (Interrupted, KeyboardInterrupt):
        print("\ninterrupted; the same command goes on", file=sys.stderr)
        return 130
    print((out / f"{args.name}.md").read_text())
    return 0


def measured(args: argparse.Namespace, text: str, thresholds: Sequence[float]) -> dict[str, Any]:
    """The record of a scene. Poses that were measured earlier are not measured again."""
    from msv2.studies.kept import fingerprint, kept
    from msv2.studies.threshold.measure import TableWords, measure_pose
    from msv2.studies.threshold.rtl import rtl_pose
    from msv2.studies.threshold.scenes import named, table_scene
    from msv2.studies.threshold.v1_model import train_v1

    path, size = named(text, args.size)
    work = Path(args.work)
    scene = table_scene(path, size, args.poses, args.units_per_metre, args.v1)
    if scene.v1 is None and scene.run is not None and args.train_v1:
        print(f"{scene.name}: training v1's levels in {work / 'v1'}", file=sys.stderr)
        scene = table_scene(path, size, args.poses, args.units_per_metre, str(train_v1(scene.run / "model.ply", work / "v1")))
    if scene.units["scale"] == "assumed":
        print(f"warning: {scene.name}: {scene.metres:g} units per metre are assumed: {scene.units['reason']}", file=sys.stderr)
    pair = {"units_per_metre": scene.metres, "ipd_metres": args.ipd}
    poses, words = [], None
    for camera in tqdm(scene.cameras, desc=scene.name, unit="pose", disable=None):
        key = fingerprint(["msv2.studies.threshold.measure"], scene.model, scene.reference, scene.v1, camera, pair,
                          tuple(thresholds))

        def make(camera: Any = camera) -> dict[str, object]:
            nonlocal words
            words = words or TableWords.of(scene)
            return measure_pose(words, camera, thresholds, **pair)

        poses.append(kept(work / "poses", key, make))
        print(f"{scene.name}: {len(poses)} of {len(scene.cameras)} poses", file=sys.stderr)
    record = {"scene": scene.name, "levels": scene.levels, "points": len(scene.model), "judged_by": scene.judged_by,
              "v1_points": None if scene.v1 is None else len(scene.v1), "units": scene.units, "ipd_metres": args.ipd,
              "poses": poses}
    if args.rtl == "all" or scene.name in args.rtl.split(","):
        gazes = tuple(tuple(gaze) for gaze in poses[0]["gaze"])
        record["rtl"] = rtl_pose(scene.model, scene.cameras[0], gazes, ECC_THRESHOLD_DEG, work / "rtl", **pair,
                                 alone=args.rtl_eyes, step=lambda what: print(f"{scene.name}: RTL, {what}", file=sys.stderr))
    return record


def write(out: Path, args: argparse.Namespace, records: list[dict[str, Any]]) -> None:
    """Writes the files for the scenes so far; the plot only where matplotlib is installed."""
    from msv2.studies.threshold.plot import save_plot
    from msv2.studies.threshold.summary import over_poses, picked, rendered
    from msv2.studies.threshold.text import markdown

    summaries = [{**record, "means": over_poses(record["poses"]), "both_rendered": rendered(record["poses"], "rendered"),
                  "v1_rendered": rendered(record["poses"], "v1"), "picked": picked(record["poses"])} for record in records]
    scenes = [text.partition("@")[0] for text in args.scenes]
    write_report(out / f"{args.name}.json", {"scenes": summaries},
                 [__name__, "msv2.studies.threshold.measure", *["tb.frame.__main__"] * (args.rtl != "none")],
                 {"arguments": args}, scenes)
    write_page(out / f"{args.name}.md", markdown(records, f"{args.name}.png"))
    save_plot(records, out / f"{args.name}.png")
