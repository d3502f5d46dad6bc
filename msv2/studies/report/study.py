"""Combines the reports on area, energy and performance into one page: build/report/report.{html,md,json}, with plots and JSON.

    msv2 study run report                     the embedded scene
    msv2 study run report PATH                another scene
    msv2 study run report all                 the embedded scene, those of MSV2_DATA and build/train, and Full HD frames
    msv2 study run report --area measured     synthesises the machine again (MSV2_PDK; an hour where nothing is cached)
    msv2 study run report --screenshots       also looks at the page in headless Chromium, at two widths

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
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size
from msv2.studies.memory import LPDDR3
from msv2.studies.page import write_page
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from msv2.studies.report.overview import draw_frames, html, markdown
from msv2.studies.web.look import take_screenshots
from msv2.studies.web.maker import write_html
from spec.command_line import command_parser
from spec.config import CONFIGS
from spec.errors import InputError
from spec.overrides import config_record
from spec.paths import REPORTS, ROOT

PARTS = ("performance", "area", "energy")
"""The chapters, each of which is a report of its own."""

ALL = "all"
"""In place of a scene: every scene that is there."""

SOURCES = ("spec", "golden", "rtl", "perf", "synth")
MODEL = REPORTS / "model.json"


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run report", __doc__)
    parser.add_argument("scene", nargs="*", metavar="SCENE",
                        help=f"scenes, as for `msv2 study run performance`, or '{ALL}' (default: {EMBEDDED})")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="size of the frames (default: 640x360)")
    parser.add_argument("--area", default="kept", choices=("kept", "measured"),
                        help="kept: the areas in reports/area.json (default); measured: synthesise again")
    parser.add_argument("--screenshots", action="store_true", help="also write OUT/screenshots/report_*.png")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "report", metavar="DIR",
                        help="output folder (default: build/report)")
    args = parser.parse_args(argv)
    args.scene = [] if args.scene == [ALL] else args.scene or [EMBEDDED]
    return args


def run(*command: str) -> None:
    """Runs one of the project's commands and shows its output. Raises InputError where it fails."""
    print(f"$ python {' '.join(command)}", flush=True)
    if subprocess.run([sys.executable, *command], cwd=ROOT).returncode:
        raise InputError(f"python {' '.join(command)} failed")


def git(*command: str) -> str:
    """The output of a git command; "" where it fails."""
    return subprocess.run(["git", "-C", str(ROOT), *command], capture_output=True, text=True, check=False).stdout.strip()


def gather(args: argparse.Namespace, out: Path, progress: Progress) -> None:
    """Makes the three reports in the folder."""
    width, height = parse_size(args.size)
    out = Path(os.path.relpath(out, ROOT))
    with progress.step("performance"):
        run("-m", "msv2.studies", "performance", *args.scene, "--size", args.size, "--out", str(out))
    frame = ("--size", args.size, "--gaze", f"{width / 2:g},{height / 2:g}", "--levels", "4", "--levels-from", RANDOM)
    gaze = frame if args.scene else ()
    with progress.step("energy"):
        run("-m", "msv2.studies", "energy", *args.scene[:1], *gaze, "--out", str(out))
    with progress.step("area"):
        if args.area == "measured":
            run("-m", "msv2.studies", "area", "--out", str(out))
        else:
            for path in (REPORTS / "area.json", REPORTS / "area.md", REPORTS / "area.png"):
                if path.is_file():  # an installed wheel has the numbers only
                    shutil.copyfile(path, ROOT / out / path.name)


def read(path: Path) -> dict | None:
    """A report's JSON; None where it is missing."""
    return json.loads(path.read_text()) if path.is_file() else None


def summary(performance: Mapping, energy: Mapping, area: Mapping | None, model: Mapping | None) -> dict[str, object]:
    """The content of report.json: numbers of the three reports, and where they come from."""
    build = area["builds"]["1ghz"] if area else {}
    frames = [{"scene": f["scene"], "size": f["size"], "work": f["work"], "memory": f["memory"],
               "energy_mj_per_frame": f["chip_mj"], "dram_mj_per_frame": f["dram_mj"]} for f in energy["frames"]]
    speedup, mj = {}, {}
    for row in performance["means"]:
        speedup.setdefault(row["machine"], {})[row["memory"]] = {"frame": row["speedup"], "render": row["speedup_render"]}
    for frame in performance["frames"]:
        mj[frame["name"]] = {run["machine"]: run["chip_mj"] for run in frame["runs"]
                             if run["chip_mj"] is not None and run["memory"] == LPDDR3}
    return {
        "commit": git("rev-parse", "HEAD"), "changed": bool(git("status", "--porcelain", "--", *SOURCES)),
        "config": config_record(CONFIGS[performance["config"]]), "clock_hz": performance["clock_hz"],
        "size": performance["size"], "area_mm2_16nm": build.get("mm2_16nm"),
        "area_mm2_16nm_without_warp_memories": build.get("mm2_16nm_without_warp_memories"),
        "area_source": area and f"reports/area.json, commit {area['commit']}",
        "energy_mj_per_frame": mj, "energy_frames": frames,
        "model_error_total": model and model["summary"]["model_error_total"],
        "model_error_source": model and f"reports/model.json, commit {git('log', '-1', '--format=%h', '--', str(MODEL))}",
        "speedup": speedup, "goals": performance["goals"], "beside_paper": performance["beside_paper"],
        "full_hd": performance["full_hd"]}


def chapter(text: str, out: Path) -> str:
    """A report's page as a chapter. Links into the project are changed to lead out of the report's folder."""
    return text.strip().replace("](../", f"]({Path(os.path.relpath(ROOT, out)).as_posix()}/")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; 1 if the screenshots show a fault of the page."""
    args = _arguments(argv)
    parse_size(args.size)
    out = make_folder(args.out)
    shown = "+".join(Path(scene).stem for scene in args.scene) or ALL
    progress = Progress(f"report_{shown}_{args.size}", ["performance", "energy", "area", "picture", "page"])
    gather(args, out, progress)
    performance = read(out / "performance.json")
    with progress.step("picture"):
        frame = draw_frames((args.scene or [EMBEDDED])[0], args.size, out)
    with progress.step("page"):
        content = summary(performance, read(out / "energy.json"), read(out / "area.json"), read(MODEL)) | {"frame": frame}
        write_report(out / "report.json", content, [__name__, *(f"msv2.studies.{name}.study" for name in PARTS)],
                     {"arguments": args}, [*(out / f"{name}.json" for name in PARTS), MODEL])
        pages = {name: out / f"{name}.md" for name in PARTS}
        chapters = {name: chapter(path.read_text(), out) for name, path in pages.items() if path.is_file()}
        write_page(out / "report.md", markdown(content, performance, chapters))
        write_html(out / "report.html", html(content, performance, chapters))
    print(f"wrote {out / 'report.html'}, report.md, report.json; the page shows the pictures beside it")
    return 0 if not args.screenshots or take_screenshots(out / "report.html", make_folder(out / "screenshots")) else 1
