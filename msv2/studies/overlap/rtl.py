"""`msv2 study run frames_overlap`: frames in a row through the RTL of machines whose phases overlap, of a camera that turns
and of one that stands still: frames_overlap.{json,md}. Every pixel and every event is compared with the integer renderer, and
the period of frames with the cycle model. Rows that were played with the same sources before are not played again.

examples:
  msv2 study run frames_overlap --keep                                 all frames on v3_overlap and v3_eyes_overlap
  msv2 study run frames_overlap --config v3_eyes_overlap --keep        joint frames of two eyes; other rows of the report stay
  msv2 study run frames_overlap embedded --size 64x48 --config tiny_overlap
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from golden.scenes.captured import scene_argument
from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED, TRAINED
from golden.scenes.request import make_folder
from msv2.studies.destination import newest
from msv2.studies.kept import fingerprint, kept
from msv2.studies.overlap.rows import golden_frames, played, rows_of
from msv2.studies.page import table, write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import source_hash, write_report
from msv2.studies.rtl_frame import COMMAND
from spec.config import MACHINES, V3_EYES_OVERLAP, V3_OVERLAP, AcceleratorConfig
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

VIEWS = ((EMBEDDED, "128x96"), (TRAINED, "128x96"), ("truck", "256x144"), ("rock_sh3", "192x108"))
"""Scenes and sizes where the command line names none."""

PLAYED = "msv2.studies.overlap.rows"
"""The module that makes the rows."""


def row_of(config: AcceleratorConfig, scene: str, size: str) -> dict[str, Any]:
    """The numbers of a scene, JSON-ready. They are kept under a key that covers the sources, the machine and the scene."""
    file = _file(scene)
    inputs = None if file is None else (file.stat().st_size, file.stat().st_mtime_ns)

    def made() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            frame = golden_frames(config, scene, size, joint=config.joint)
            rows = rows_of(frame, short=scene not in (EMBEDDED, TRAINED))
            (found,) = played(config, [rows], [config.packed], Path(folder))
        return {"frame": f"{scene} {size}", "scene": scene, "size": size, "machine": config.name, **found}

    return kept(ROOT / "build" / "results" / "overlap",
                f"row-{fingerprint((), source_hash([PLAYED, COMMAND]), config, scene, size, inputs)}", made)


def _file(scene: str) -> Path | None:
    """The file of a captured scene."""
    return None if scene in (EMBEDDED, TRAINED) else scene_file(scene)


def with_rows(old: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a report and new ones, which replace those of the same frames on the same machines."""
    own = {(row["frame"], row["machine"]) for row in rows}
    return [*(other for other in old if (other["frame"], other["machine"]) not in own), *rows]


def page(content: dict[str, Any]) -> str:
    """The report as a page."""
    return "\n".join([
        "# Frames in a row with overlapped phases", "",
        "Written by `msv2 study run frames_overlap`. Frames in a row go through the RTL on the ideal memory, each started as "
        "soon as the machine takes it: eight of the embedded scenes, first of a camera that stands still and then of one that "
        "turns, and three of captured scenes, of which the last has another camera. Every pixel and every event is compared "
        "with the integer renderer's. The period is that of a camera that stands still, in cycles, from one start to the next; "
        "the last two columns are the model's phases.", "",
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
    parser.add_argument("--config", action="append", metavar="NAME", help="a machine; may be given several times (default: "
                        f"{V3_OVERLAP.name} and {V3_EYES_OVERLAP.name})")
    parser.add_argument("--out", type=Path, default=REPORTS, help="folder for the report (default %(default)s)")
    args = parser.parse_args(argv)
    configs = [_overlapped(name) for name in args.config or (V3_OVERLAP.name, V3_EYES_OVERLAP.name)]
    out = make_folder(args.out)
    views = [(args.scene, args.size)] if args.scene else [view for view in VIEWS if scene_argument(view[0])]
    todo = {f"{scene} {size}, {config.name}": (config, scene, size) for config in configs for scene, size in views}
    progress, path, rows = Progress("frames_overlap", list(todo)), out / "frames_overlap.json", []
    old = read_json(newest(path)) if newest(path).is_file() else {}
    for name, of in todo.items():
        with progress.step(name):
            rows.append(row_of(*of))
    content = {"rows": with_rows(old.get("rows", []), rows)}
    write_report(path, content, [__name__, COMMAND], {"arguments": args, **{config.name: config for config in configs}},
                 [file for scene, _ in views if (file := _file(scene))],
                 earlier=old if len(content["rows"]) > len(rows) else None)
    write_page(out / "frames_overlap.md", page(content))
    for row in rows:
        print(f"{row['frame']}, {row['machine']}: {row['frames']} frames, {len(row['problems'])} differences, period "
              f"{row['period']}, model to RTL {row['model_over_rtl']:.4f}")
    return int(any(row["problems"] for row in rows))


def _overlapped(name: str) -> AcceleratorConfig:
    """The machine of this name; InputError where its phases do not overlap."""
    config = MACHINES.get(name)
    if config is None or not config.overlap:
        accepted = ", ".join(name for name, found in MACHINES.items() if found.overlap)
        raise InputError(f"config {name!r} is not accepted: machines whose phases overlap are {accepted}")
    return config
