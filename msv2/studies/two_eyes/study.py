"""`msv2 study run two_eyes`: what a second eye costs on `v3` where both eyes come from one set of lists, and what its pixels
lose by the first eye's order: two_eyes.{json,md}.

examples:
  msv2 study run two_eyes                              all frames
  msv2 study run two_eyes embedded --size 320x180      one frame
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder
from msv2.studies.memory import MEMORY_NAMES
from msv2.studies.page import write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from msv2.studies.two_eyes import headset, measure
from msv2.studies.two_eyes.page import GAIN_GOAL, SHARE_GOAL, page, summary
from msv2.studies.v3 import frames


def measured(args: argparse.Namespace) -> dict[str, Any]:
    """The report's numbers; pixels are measured in frames of the first size alone.

    Raises:
        InputError: a scene that the command line names is missing.
    """
    todo, missing = frames.chosen(args)
    rows, paper, shifts, quality = [], [], [], []
    progress = Progress("two_eyes", [subject.name for subject in todo])
    for subject in todo:
        with progress.step(subject.name):
            for machine, config in measure.MACHINES.items():
                for memory in MEMORY_NAMES:
                    rows += measure.cycle_rows(subject, machine, memory, config)
            paper += [measure.paper_row(subject, memory) for memory in MEMORY_NAMES]
            shifts.append(measure.shift_row(subject))
            if subject.size == todo[0].size:
                quality += [measure.quality_row(subject, camera) for camera in measure.CAMERAS]
    wide = not args.scene and not args.size  # a run that names frames asks for no others
    return {"missing": missing, "headset": headset.rows() if wide else [], "headset_missing": headset.missing(),
            "goals": {"second_eye_share": SHARE_GOAL, "two_eyes_gain": GAIN_GOAL, "headset_fps": headset.GOAL_FPS,
                      "headset_slow_fps": headset.SLOW_GOAL_FPS},
            "summary": summary(rows, paper), "paper": paper, "shifts": shifts, "quality": quality, "frames": rows}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = frames.frame_arguments("two_eyes", __doc__, argv)
    out = make_folder(args.out)
    content = measured(args)
    scenes = [scene_file(scene) for scene in args.scene or frames.SCENES if scene != EMBEDDED]
    write_report(out / "two_eyes.json", content, [__name__],
                 {"arguments": args, "machines": measure.MACHINES | headset.MACHINES},
                 [headset.TIMING, *filter(None, scenes)])
    write_page(out / "two_eyes.md", page(content))
    for found in content["summary"].values():
        numbers = ((name, found[name]) for name in ("second_eye_share", "two_eyes_gain"))
        print(f"{found['machine']}, {found['memory']}: " + ", ".join(
            f"{name} {'not measured' if value is None else f'{value:.3f}'}" for name, value in numbers))
    return 0
