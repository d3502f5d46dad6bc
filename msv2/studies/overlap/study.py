"""`msv2 study run overlap`: what frames in a row take where the first phase of each runs beside the second phase of the one
before: overlap.{json,md}. The cycle model alone; `msv2 study run frames_overlap` plays frames in a row through the RTL.

examples:
  msv2 study run overlap                              all frames
  msv2 study run overlap embedded --size 320x180      one frame
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder
from msv2.studies.memory import MEMORY_NAMES
from msv2.studies.overlap import measure
from msv2.studies.overlap.page import GOALS, page, summary
from msv2.studies.page import write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from msv2.studies.v3 import frames, supertiles


def measured(args: argparse.Namespace) -> dict[str, Any]:
    """The report's numbers.

    Raises:
        InputError: a scene that the command line names is missing.
    """
    todo, missing = frames.chosen(args)
    moving = supertiles.captured(todo)
    progress = Progress("overlap", [*(subject.name for subject in todo), *(f"turns: {subject.name}" for subject in moving)])
    rows, paper, overflow = [], [], []
    for subject in todo:
        with progress.step(subject.name):
            for memory in MEMORY_NAMES:
                rows += measure.rows(subject, memory)
                paper.append(measure.paper_row(subject, memory))
    for subject in sorted(moving, key=lambda subject: subject.scene):  # a scene's model is prepared once
        with progress.step(f"turns: {subject.name}"):
            overflow += supertiles.overflow_rows(subject, measure.TURNS)
    return {"missing": missing, "goals": GOALS, "summary": summary(rows, paper), "paper": paper, "overflow": overflow,
            "frames": rows}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = frames.frame_arguments("overlap", __doc__, argv)
    out = make_folder(args.out)
    content = measured(args)
    scenes = [scene_file(scene) for scene in args.scene or frames.SCENES if scene != EMBEDDED]
    write_report(out / "overlap.json", content, [__name__],
                 {"arguments": args, "machines": {name: config for name, (config, _) in measure.MACHINES.items()}},
                 [*filter(None, scenes)])
    write_page(out / "overlap.md", page(content))
    for name, found in content["summary"].items():
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in found.items() if value is not None))
    return 0
