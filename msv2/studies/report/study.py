"""Combines the reports on area, energy and performance into one: build/report/report.{html,md,json}, with plots and JSON.

    msv2 study run report                     the embedded scene, and those of MSV2_DATA and build/train
    msv2 study run report embedded            one scene
    msv2 study run report --area measured     synthesises the machine again (MSV2_PDK; an hour where nothing is cached)

The area is taken from reports/area.json unless --area says otherwise, so that no liberty files are needed; the page says so.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from golden.scenes.level_source import RANDOM
from golden.scenes.request import make_folder, parse_size
from msv2.studies.page import write_html, write_page
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.config import CONFIGS
from spec.errors import InputError
from spec.memory import DRAM_BYTES_PER_CYCLE
from spec.paths import REPORTS, ROOT

PARTS = ("performance", "area", "energy")
"""The chapters, each of which is a report of its own."""

SOURCES = ("spec", "golden", "rtl", "perf", "synth")
MODEL = REPORTS / "model.json"


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run report", __doc__)
    parser.add_argument("scene", nargs="*", metavar="SCENE", help="scenes, as for `msv2 study run performance`")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="size of the frames (default: 640x360)")
    parser.add_argument("--area", default="kept", choices=("kept", "measured"),
                        help="kept: the areas in reports/area.json (default); measured: synthesise again")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "report", metavar="DIR",
                        help="output folder (default: build/report)")
    return parser.parse_args(argv)


def run(*command: str) -> None:
    """Runs one of the project's commands and shows its output. Raises InputError where it fails."""
    print(f"$ python {' '.join(command)}", flush=True)
    if subprocess.run([sys.executable, *command], cwd=ROOT).returncode:
        raise InputError(f"python {' '.join(command)} failed")


def git(*command: str) -> str:
    """The output of a git command; "" where it fails."""
    return subprocess.run(["git", "-C", str(ROOT), *command], capture_output=True, text=True, check=False).stdout.strip()


def gather(args: argparse.Namespace, out: Path) -> None:
    """Makes the three reports in the folder."""
    width, height = parse_size(args.size)
    out = Path(os.path.relpath(out, ROOT))
    run("-m", "msv2.studies", "performance", *args.scene, "--size", args.size, "--out", str(out))
    frame = ("--size", args.size, "--gaze", f"{width / 2:g},{height / 2:g}", "--levels", "4", "--levels-from", RANDOM)
    gaze = frame if args.scene else ()
    run("-m", "msv2.studies", "energy", *args.scene[:1], *gaze, "--out", str(out))
    if args.area == "measured":
        run("-m", "msv2.studies", "area", "--out", str(out))
        return
    for path in REPORTS.glob("area.*"):
        shutil.copyfile(path, ROOT / out / path.name)


def read(path: Path) -> dict | None:
    """A report's JSON; None where it is missing."""
    return json.loads(path.read_text()) if path.is_file() else None


def summary(performance: Mapping, energy: Mapping, area: Mapping | None, model: Mapping | None) -> dict[str, object]:
    """The content of report.json: numbers of the three reports, and where they come from."""
    build = area["builds"]["1ghz"] if area else {}
    frames = [{"scene": f["scene"], "size": f["size"], "work": f["work"], "energy_mj_per_frame": f["chip_mj"],
               "dram_mj_per_frame": f["dram_mj"]} for f in energy["frames"]]
    speedup, mj = {}, {}
    for row in performance["means"]:
        memory = "unlimited" if row["bytes_per_cycle"] is None else f"{row['bytes_per_cycle']:g}"
        speedup.setdefault(row["machine"], {})[memory] = {"frame": row["speedup"], "render": row["speedup_render"]}
    for frame in performance["frames"]:
        mj[frame["name"]] = {run["machine"]: run["chip_mj"] for run in frame["runs"]
                             if run["chip_mj"] is not None and run["bytes_per_cycle"] == DRAM_BYTES_PER_CYCLE}
    return {
        "commit": git("rev-parse", "HEAD"), "changed": bool(git("status", "--porcelain", "--", *SOURCES)),
        "config": repr(CONFIGS[performance["config"]]), "clock_hz": performance["clock_hz"], "size": performance["size"],
        "area_mm2_16nm": build.get("mm2_16nm"),
        "area_mm2_16nm_without_warp_memories": build.get("mm2_16nm_without_warp_memories"),
        "area_source": area and f"reports/area.json, commit {area['commit']}",
        "energy_mj_per_frame": mj, "energy_frames": frames,
        "model_error_total": model and model["summary"]["model_error_total"],
        "model_error_source": model and f"reports/model.json, commit {git('log', '-1', '--format=%h', '--', str(MODEL))}",
        "speedup": speedup, "goals": performance["goals"], "full_hd": performance["full_hd"]}


def chapter(text: str, out: Path) -> str:
    """A report's page as a chapter. Links into the project are changed to lead out of the report's folder."""
    return text.strip().replace("](../", f"]({Path(os.path.relpath(ROOT, out)).as_posix()}/")


def markdown(content: Mapping, chapters: Sequence[str]) -> str:
    """The whole page: a header, then the reports."""
    area, error = content["area_mm2_16nm"], content["model_error_total"]
    kept = (f"The area is {area:.3f} mm² at 16 nm, {content['area_mm2_16nm_without_warp_memories']:.3f} without the warp "
            f"unit's memories ({content['area_source']})." if area else
            "No area: there is no reports/area.json (`make report-area`).")
    checked = (f" The cycle model's worst error of a frame's total is {100 * error:.2f} % ({content['model_error_source']})."
               if error is not None else "")
    return "\n\n".join([
        "# Report", f"Commit {content['commit'][:12]}{', changed' if content['changed'] else ''}; frames of {content['size']}. "
        f"{kept}{checked} Numbers: [report.json](report.json); of the chapters: "
        + ", ".join(f"[{name}.json]({name}.json)" for name in PARTS) + ".",
        f"```\n{content['config']}\n```", *chapters]) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    out = make_folder(args.out)
    gather(args, out)
    content = summary(read(out / "performance.json"), read(out / "energy.json"), read(out / "area.json"), read(MODEL))
    inputs = [out / f"{name}.json" for name in PARTS]
    write_report(out / "report.json", content, [__name__, *(f"msv2.studies.{name}.study" for name in PARTS)],
                 {"arguments": args}, [*inputs, MODEL])
    pages = [out / f"{name}.md" for name in PARTS]
    text = markdown(content, [chapter(path.read_text(), out) for path in pages if path.is_file()])
    write_page(out / "report.md", text)
    write_html(out / "report.html", "Report", text)
    print(f"wrote {out / 'report.html'}, report.md, report.json")
    return 0
