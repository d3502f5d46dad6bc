"""`msv2 study run frames_overlap`: frames in a row through the RTL of a machine whose phases overlap, of a camera that turns
and of one that stands still: frames_overlap.{json,md}. Every pixel and every event is compared with the integer renderer, and
the period of frames with the cycle model.

examples:
  msv2 study run frames_overlap                                        all frames on v3_overlap
  msv2 study run frames_overlap embedded --size 64x48 --config tiny_overlap
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from golden.msv2_ref import pipeline
from golden.scenes.captured import scene_argument
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_request, resolve
from msv2.studies.page import table, write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from perf.model import MemoryModel
from perf.overlap import simulate_overlap
from perf.supertiles_trace import super_trace
from spec.config import MACHINES, V3_OVERLAP, AcceleratorConfig
from spec.errors import InputError
from spec.paths import REPORTS
from tb.top.device import machine
from tb.top.overlap_player import Row, play_rows
from tb.top.plan_overlap import in_a_row, row_problems, turned
from tb.top.planned import planned
from tb.top.stimuli import Case

VIEWS = ((EMBEDDED, "192x128"), ("truck", "256x144"), ("rock_sh3", "192x108"))
"""Scenes and sizes where the command line names none."""

STILL, TURNS = 5, (0.0, 2.0, 4.0)
"""Frames of the camera that stands still, of which the last three have the bounds of steady frames, and the degrees by which
the other camera has turned in each of its frames."""


def _cases(config: AcceleratorConfig, scene: str, size: str) -> tuple[list[Case], list[Case]]:
    """The golden frames of the camera that stands still, and of the one that turns."""
    width, height = (int(part) for part in size.split("x"))
    asked = resolve(parse_request(scene_argument(scene), "--size", size, "--gaze", f"{width // 2},{height // 2}", "--levels",
                                  str(config.levels), "--levels-from", "random"))
    frames = [pipeline.render(asked.model, turned(asked.camera, degrees), config=config, foveation=asked.foveation,
                              background=asked.background) for degrees in TURNS]
    return [Case("still", frames[0], None, False)] * STILL, [
        Case(f"turned {degrees:g}", frame, None, False) for degrees, frame in zip(TURNS, frames, strict=True)]


def row_of(config: AcceleratorConfig, scene: str, size: str, folder: Path) -> dict[str, Any]:
    """The numbers of a scene, JSON-ready."""
    still, turning = (in_a_row(cases) for cases in _cases(config, scene, size))
    display = {"packed": True} if config.packed else {"display": True}
    rows = [Row(name, [planned(case, **display) for case in cases]) for name, cases in (("still", still), ("turning", turning))]
    results = play_rows(machine(config), rows, folder)
    problems = [text for row, result in zip(rows, results, strict=True) for text in row_problems(row, result)]
    begun = [frame.begun for frame in results[0].frames]
    last = results[0].frames[-1].registers
    alone = replace(config, overlap=False)
    model = simulate_overlap(
        super_trace(still[-1].frame), alone, memory=MemoryModel("ideal"), display=True, packed=config.packed)
    period = begun[-1] - begun[-2]
    return {
        "frame": f"{scene} {size}", "scene": scene, "size": size, "machine": config.name,
        "frames": sum(len(row.frames) for row in rows), "problems": problems, "period": period, "model": model.period,
        "model_over_rtl": model.period / period, "model_first": model.first, "model_second": model.second,
        "cycles": {name: last[f"cycles_{name}_low"] for name in ("total", "table", "geometry", "render")}}


def page(content: dict[str, Any]) -> str:
    """The report as a page."""
    return "\n".join([
        "# Frames in a row with overlapped phases", "",
        "Written by `msv2 study run frames_overlap`. Frames in a row go through the RTL on the ideal memory, each started as "
        "soon as the machine takes it, first of a camera that stands still and then of one that turns. Every pixel and every "
        "event is compared with the integer renderer's. The period is that of the camera that stands still, in cycles, from "
        "one start to the next; the last two columns are the model's phases.", "",
        table(("frame", "machine", "frames", "wrong", "period", "model", "model to RTL", "first phase", "second phase"), [
            (row["frame"], row["machine"], row["frames"], len(row["problems"]), f"{row['period']:,}", f"{row['model']:,}",
             f"{row['model_over_rtl']:.4f}", f"{row['model_first']:,}", f"{row['model_second']:,}")
            for row in content["rows"]])]) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = argparse.ArgumentParser(
        prog="msv2 study run frames_overlap", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", help="one scene; default: those of the report")
    parser.add_argument("--size", default="256x144", metavar="WxH", help="size of that scene's frames (default %(default)s)")
    parser.add_argument("--config", default=V3_OVERLAP.name, help="the machine (default %(default)s)")
    parser.add_argument("--out", type=Path, default=REPORTS, help="folder for the report (default %(default)s)")
    args = parser.parse_args(argv)
    config = MACHINES.get(args.config)
    if config is None or not config.overlap:
        accepted = ", ".join(name for name, found in MACHINES.items() if found.overlap)
        raise InputError(f"config {args.config!r} is not accepted: machines whose phases overlap are {accepted}")
    out = make_folder(args.out)
    views = [(args.scene, args.size)] if args.scene else [view for view in VIEWS if scene_argument(view[0])]
    progress, rows = Progress("frames_overlap", [" ".join(view) for view in views]), []
    for scene, size in views:
        with progress.step(f"{scene} {size}"), tempfile.TemporaryDirectory() as folder:
            rows.append(row_of(config, scene, size, Path(folder)))
    content = {"rows": rows}
    scenes = [scene_file(scene) for scene, _ in views if scene != EMBEDDED]
    write_report(out / "frames_overlap.json", content, [__name__], {"arguments": args, "config": config},
                 [*filter(None, scenes)])
    write_page(out / "frames_overlap.md", page(content))
    wrong = sum(len(row["problems"]) for row in rows)
    for row in rows:
        print(f"{row['frame']}: {row['frames']} frames, {len(row['problems'])} differences, period {row['period']}, "
              f"model to RTL {row['model_over_rtl']:.4f}")
    return int(bool(wrong))
