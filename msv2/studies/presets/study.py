"""`msv2 study run presets`: what accuracy buys on `v3`, on scenes of SH degree 3: presets.{json,md}.

examples:
  msv2 study run presets                        the embedded scene, and rock_sh3 of MSV2_DATA
  msv2 study run presets embedded --size 64x48  one scene
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size
from msv2.studies.page import write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.presets import measure, page
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.config import PRESETS, V3
from spec.paths import REPORTS


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run presets", __doc__)
    parser.add_argument("scene", nargs="*", metavar="SCENE",
                        help=f"'embedded', a model file or a scene of MSV2_DATA (default: {', '.join(measure.SIZES)})")
    parser.add_argument("--size", metavar="WxH", help="size of the frames (default: that of the scene)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    if args.size:
        parse_size(args.size)
    out = make_folder(args.out)
    scenes = args.scene or [scene for scene in measure.SIZES if scene == EMBEDDED or scene_file(scene)]
    progress, rows, foveated = Progress("presets", list(scenes)), [], []
    for scene in scenes:
        with progress.step(scene):
            size = args.size or measure.SIZES.get(scene, measure.FOVEATED)
            rows += measure.rows(measure.load(scene, size))
            foveated += measure.foveated_rows(scene, args.size or measure.FOVEATED)
    content = {"missing": [] if args.scene else [scene for scene in measure.SIZES if scene not in scenes], "rows": rows,
               "foveated": foveated, "goals": page.goals(rows)}
    write_report(out / "presets.json", content, [__name__], {"arguments": args, "machines": {V3.name: V3, **PRESETS}},
                 [scene_file(scene) for scene in scenes if scene != EMBEDDED])
    write_page(out / "presets.md", page.page(content))
    for goal in content["goals"]:
        print(f"{goal['goal']}: {goal['found']:.3f} by {goal['choice']} (wanted {goal['wanted']:g})")
    return 0
