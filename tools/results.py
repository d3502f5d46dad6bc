"""Run what the README's tables rest on, keep the numbers in reports/, and write the tables.

    python tools/results.py                    everything (about 20 minutes); scenes in MSV2_DATA, liberties in MSV2_PDK
    python tools/results.py --only frames      one part: accuracy, frames, synthesis, bench
    python tools/results.py --only tables      only rewrite the tables from reports/
    python tools/results.py --check            exit 1 where the README differs from what reports/ give
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from golden.scenes.request import write_json  # noqa: E402
from spec.errors import InputError, run_command_line  # noqa: E402
from tools.tables import fill_readme  # noqa: E402

REPORTS = ROOT / "reports"
FRAMES = (
    ("embedded", "128x128", None, "default"), ("embedded", "128x128", "64,64", "default"),
    ("embedded", "128x128", "64,64", "tiny"),
    ("truck.splat", "256x144", None, "default"), ("truck.splat", "256x144", "128,72", "default"),
    ("rock_sh3", "192x108", "96,54", "default"),
)
"""Whole frames through the RTL array: scene, size, gaze (with four levels) and machine."""

FRAME_KEYS = ("scene", "camera", "size", "gaze", "levels", "config", "bit_exact", "pixels_checked", "tiles", "entries", "ops",
              "skipped", "mismatches", "cycles", "stalls", "cycles_per_s")
"""What reports/frames.json keeps of frame.json."""

SYNTHESISED = ("pixel_core", "vrc_row")
"""Units of the area table."""

SYNTHESIS_KEYS = ("area_um2", "area_per_core_um2", "cells", "clock_ps", "slack_ps", "zero_slack_ps", "derated_ps")


def data_folder() -> Path:
    """The folder of captured scenes."""
    return Path(os.environ.get("MSV2_DATA", ROOT / ".." / "shared" / "data")) / "trained"


def run(*command: str) -> None:
    """Runs one of the project's commands, showing its output; InputError where it fails."""
    print(f"$ {' '.join(command)}", flush=True)
    if subprocess.run([sys.executable, *command], cwd=ROOT).returncode:
        raise InputError(f"{' '.join(command)} failed")


def measure_frames() -> None:
    """reports/frames.json: every frame of FRAMES whose scene is there."""
    rows, out = [], ROOT / "build" / "results" / "frame"
    for scene, size, gaze, config in FRAMES:
        path = scene if scene == "embedded" else str(data_folder() / scene)
        if scene != "embedded" and not Path(path).exists():
            print(f"skipped: {scene} (no such scene in MSV2_DATA)")
            continue
        foveated = ["--gaze", gaze, "--levels", "4"] if gaze else []
        run("-m", "tb.frame", path, "--part", "array", "--size", size, "--config", config, "--out", str(out), *foveated)
        row = json.loads((out / "frame.json").read_text())
        kept = {key: row[key] for key in FRAME_KEYS}
        rows.append({**kept, "scene": Path(scene).stem})
    write_json(REPORTS / "frames.json", {"rows": rows})


def measure_synthesis() -> None:
    """reports/synthesis.json: area and slack of SYNTHESISED in ASAP7; skipped without MSV2_PDK."""
    if "MSV2_PDK" not in os.environ:
        print("skipped: synthesis (MSV2_PDK names no liberty folder)")
        return
    rows, out = [], ROOT / "build" / "results" / "synth"
    for unit in SYNTHESISED:
        run("-m", "synth", "--unit", unit, "--tech", "asap7", "--clock-ps", "1000", "--out", str(out))
        report = json.loads((out / f"{unit}-asap7.json").read_text())
        variants = {name: _numbers(variant) for name, variant in report["variants"].items()}
        named = {key: report[key] for key in ("unit", "config", "node", "cell_list", "yosys", "sta")}
        rows.append({**named, **_numbers(report), "variants": variants})
    write_json(REPORTS / "synthesis.json", {"rows": rows})


def _numbers(report: dict) -> dict:
    return {key: report[key] for key in SYNTHESIS_KEYS if key in report}


def measure_bench() -> None:
    """reports/bench.json: the embedded scene, and the truck where it is there."""
    truck = data_folder() / "truck.splat"
    scenes = ["embedded", *([str(truck)] if truck.exists() else [])]
    run("golden/bench.py", *scenes, "--size", "640x360", "--repeat", "9", "--out", str(REPORTS))


PARTS = {
    "accuracy": lambda: run("golden/accuracy.py", "--out", str(REPORTS)), "frames": measure_frames,
    "synthesis": measure_synthesis, "bench": measure_bench, "tables": lambda: None,
}


def main() -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=list(PARTS), help="one part instead of all")
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 where the README is stale")
    args = parser.parse_args()
    if not args.check:
        REPORTS.mkdir(exist_ok=True)
        for name in [args.only] if args.only else PARTS:
            PARTS[name]()
    return fill_readme(ROOT / "README.md", REPORTS, check=args.check)


if __name__ == "__main__":
    run_command_line(main)
