"""`msv2 study run v3`: what the steps from `paper` to `v3` give: bytes, cycles and energy of frames, how well depth buckets
fit, and the loss against photographs: v3.{json,md}. On the way lies `v3_records`, without lists by super-tile.

The photographs need finished runs of fern and bonsai in build/train (`make train`) and their data sets. Where a run is missing,
its rows in reports/v3.json stay as they are; without any, they are left out.

examples:
  msv2 study run v3                                   all frames, orders and photographs
  msv2 study run v3 embedded --size 320x180           one frame
  msv2 study run v3 --orders 0 --photographs 0        the frames alone
  msv2 study run v3 --anew --keep                     nothing: goals, steps and page of the kept rows, beside today's reports
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size
from msv2.studies.energy.table import TABLE, load_table
from msv2.studies.overlap import page as overlap_page
from msv2.studies.page import write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from msv2.studies.v3 import frames, orders, photographs, summary, supertiles
from msv2.studies.v3.page import page
from spec.command_line import command_parser
from spec.config import V3, V3_EYES_LARGE, V3_PACKED, V3_STREAMS, V3_STREAMS_PACKED
from spec.errors import InputError
from spec.paths import REPORTS

REPORT, EYES, OVERLAP, MACHINES = (REPORTS / f"{name}.json" for name in ("v3", "two_eyes", "overlap", "performance"))
"""The report itself, and those of which it shows numbers: joint frames, overlapped phases, and machines like GSCore."""

SUPERTILES = {V3: (V3, V3_PACKED), V3_STREAMS: (V3_STREAMS_PACKED,)}
"""The machines with lists by super-tile, by the one whose traces they take."""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run v3", __doc__)
    frames.add_subjects(parser)
    parser.add_argument("--orders", default="1", choices=("0", "1"),
                        help="compare the orders of the model, on frames of the first size; with 0 and all scenes, those of "
                        "the kept report stay (default: 1)")
    parser.add_argument("--photographs", default="1", choices=("0", "1"),
                        help="measure against photographs; with 0 and all scenes, those of the kept report stay (default: 1)")
    parser.add_argument("--turns", default="1", choices=("0", "1"),
                        help="measure how well bounds of depth buckets suit the next frame; with 0 and all scenes, those of "
                        "the kept report stay (default: 1)")
    parser.add_argument("--anew", action="store_true",
                        help="measure nothing: summarise the rows of the kept report anew, and write its page")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def measure(args: argparse.Namespace, old: Mapping[str, Any]) -> dict[str, Any]:
    """The report's numbers. Photographs whose run is missing, and parts that are not asked for, have those of the report `old`.

    Raises:
        InputError: a scene that the command line names is missing.
    """
    todo, missing = frames.chosen(args)
    runs, missing_runs = photographs.runs_here() if args.photographs == "1" else ({}, [])
    ordered = [subject for subject in todo if subject.size == todo[0].size] if args.orders == "1" else []
    moving = supertiles.captured(todo) if args.turns == "1" else []
    progress = Progress("v3", [*(subject.name for subject in todo), *(f"turns: {subject.name}" for subject in moving),
                               *(f"orders: {subject.name}" for subject in ordered),
                               *(f"photographs: {scene}" for scene in runs)])
    table, rows, order_rows, photo_rows, overflow = load_table(), [], [], [], []
    for subject in todo:
        with progress.step(subject.name):
            for name, config in frames.MACHINES.items():
                trace = frames.traced(subject, config)
                rows += [frames.frame_row(subject, name, memory, trace, config, table) for memory in frames.MEMORIES]
            for traced, configs in SUPERTILES.items():
                trace = supertiles.super_traced(subject, traced)
                rows += [supertiles.super_row(subject, memory, trace, table, config)
                         for config in configs for memory in frames.MEMORIES]
    for subject in sorted(moving, key=lambda subject: subject.scene):  # a scene's model is prepared once
        with progress.step(f"turns: {subject.name}"):
            overflow += supertiles.overflow_rows(subject)
    for subject in ordered:
        with progress.step(f"orders: {subject.name}"):
            order_rows += orders.order_rows(subject)
    for scene, run in runs.items():
        with progress.step(f"photographs: {scene}"):
            photo_rows += photographs.photo_rows(scene, run)
    names = [subject.name for subject in ordered]
    photo_rows += _kept(old, missing_runs if args.photographs == "1" else [row["scene"] for row in old.get("photographs", ())])
    if args.turns == "0" and old:
        overflow = old["steps"]["supertiles"]["overflow"]
    if args.orders == "0" and old:
        names, order_rows = old["ordered"], old["order_frames"]
    return summarised({
        "clock_hz": frames.CLOCK_HZ, "missing": missing,
        "missing_runs": [scene for scene in missing_runs if scene not in {row["scene"] for row in photo_rows}],
        "ordered": names, "goals": [], "steps": {}, "frames": rows, "photographs": photo_rows,
        "orders": [], "order_frames": order_rows}, overflow)


def summarised(content: Mapping[str, Any], overflow: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A report's content with goals, steps and means of its rows, and with what stands in other reports beside them."""
    rows, photo_rows = content["frames"], content["photographs"]
    return {**content, "goals": summary.goals(rows, photo_rows, overflow),
            "steps": {**summary.steps(rows, photo_rows, overflow, _beside(EYES, "summary"), _beside(MACHINES, "steps")),
                      **_overlap_step()},
            "orders": summary.order_means(content["order_frames"])}


def _beside(report: Path, key: str) -> Any:
    """A part of another report; empty without it."""
    return read_json(report).get(key, {}) if report.is_file() else {}


def _overlap_step() -> dict[str, Any]:
    """The step of overlapped phases, from their report, if that is there."""
    found = _beside(OVERLAP, "summary")
    return {"overlap": overlap_page.steps(found, V3_STREAMS_PACKED.name, V3_EYES_LARGE.name)} if found else {}


def _kept(old: Mapping[str, Any], scenes: Sequence[str]) -> list[Mapping[str, Any]]:
    """The photographs of these scenes in a report."""
    return [row for row in old.get("photographs", ()) if row["scene"] in scenes]


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    for size in args.size:
        parse_size(size)
    out = make_folder(args.out)
    old = read_json(REPORT) if REPORT.is_file() and not args.scene else {}
    if args.anew and not old:
        raise InputError(f"--anew is not accepted: {REPORT} is not there, or a scene is named")
    content = measure(args, old) if not args.anew else summarised(
        {key: value for key, value in old.items() if key != "provenance"}, old["steps"]["supertiles"]["overflow"])
    scenes = [scene_file(scene) for scene in args.scene or frames.SCENES if scene != EMBEDDED]
    machines = frames.MACHINES | {config.name: config for configs in SUPERTILES.values() for config in configs}
    write_report(out / "v3.json", content, [__name__], {"arguments": args, "machines": machines},
                 [TABLE, EYES, OVERLAP, MACHINES, *filter(None, scenes),
                  *(run / "model.ply" for run in photographs.runs_here()[0].values())],
                 earlier=old if args.anew or "0" in (args.orders, args.turns, args.photographs) or _kept(
                     old, photographs.runs_here()[1]) else None)
    write_page(out / "v3.md", page(content))
    for goal in content["goals"]:
        found = "not measured" if goal["found"] is None else f"{goal['found']:.4f}"
        print(f"{goal['goal']}: {found} (wanted {'at least' if goal['least'] else 'at most'} {goal['wanted']:g})")
    return 0
