"""Measures the integer golden renderer against the float64 oracle scene by scene, for reports/accuracy.json and .md."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.captured import scene_argument
from golden.scenes.gaze import Display, foveation_map, no_foveation
from golden.scenes.level_source import RANDOM
from golden.scenes.levels import smfr_levels
from golden.scenes.load import EMBEDDED, TRAINED
from golden.scenes.request import Request, add_request_arguments, make_folder, resolve
from msv2.studies.page import table, write_page
from msv2.studies.record import write_report
from msv2.studies.scenes import MODELS
from spec.command_line import command_parser
from spec.config import PAPER, V3
from spec.paths import REPORTS

BUDGETS_DB = {"wide": 60.0, "compact": 58.0}
"""The PSNR that the golden renderer must reach against the oracle, before 8-bit rounding, by the format of the records."""

TRAINED_BUDGETS_DB = {"wide": 56.0, "compact": 53.0}
"""The same for TRAINED, whose model uses the formats up to their ends. All of its Gaussians have harmonics of degree 3 and most
have four levels, and compact records round harmonics of degree 2 and 3 to codes of 5 bits (which costs the most) and the base
colours, scales and rotations of Gaussians with four levels to codes that are one to three bits shorter. One Gaussian has a
colour of 2.5, which saturates at 2 in every machine: against an oracle whose colours end there, wide records reach 63.4 dB
where they now miss the other scenes' budget."""

TRAINED_VIEWS = "0,2,3,5,16"
"""Views of TRAINED: the worst of its 24 for wide records, where the colour saturates (2), and for compact ones (16); and two
with a Gaussian beyond the guard band (3 and 5), which covered the frame with a veil before such Gaussians were culled."""

VIEWS = "0,3"
"""Views of the other scenes."""

MACHINES = (PAPER, V3)
"""The machines whose golden renderers are measured."""


def measure(request: Request, name: str, gazing: bool) -> list[dict[str, object]]:
    """The rows of a view: golden renderers against oracle for the request's camera, with or without a gaze in the centre.

    A row's `mean_error` is the mean of all colours less that of the oracle's, both clamped to [0, 1].
    """
    camera, model = request.camera, request.model
    display = Display(camera.width, camera.height)
    if gazing:
        model = smfr_levels(model) if model.levels == 1 else model
        foveation = foveation_map(display, (camera.width / 2, camera.height / 2), model.levels)
    else:
        foveation = no_foveation(display)
    oracle = render_oracle(model, camera, foveation=foveation, weights="plane")
    exact = render_oracle(model, camera, foveation=foveation, weights="exact") if gazing else oracle
    rows = []
    for machine in MACHINES:
        golden = pipeline.render(model, camera, config=machine, foveation=foveation)
        both = np.isfinite(golden.depth) & (oracle.depth < golden.registers.depth_far / 2)  # farther splats may saturate
        depth_error = np.abs(golden.depth[both] / oracle.depth[both] - 1)
        rows.append({
            "machine": machine.name, "records": machine.records, "scene": name, "camera": camera.name,
            "size": [camera.width, camera.height], "gaze": gazing, "splats": len(model),
            "sh_degree": model.sh_degree, "entries": len(golden.entries.splat), "coverage": float(oracle.coverage.mean()),
            "psnr_vs_oracle_db": psnr_vs(golden.image, oracle.image),
            "max_abs_error": max_abs_error(golden.image, oracle.image),
            "mean_error": float(np.clip(golden.image, 0, 1).mean() - np.clip(oracle.image, 0, 1).mean()),
            "psnr_vs_exact_levels_db": psnr_vs(golden.image, exact.image),
            "depth_error_p99": float(np.percentile(depth_error, 99)) if both.any() else None,
        })
    return rows


def budget_db(row: Mapping[str, object]) -> float:
    """The budget of a row."""
    return (TRAINED_BUDGETS_DB if row["scene"] == TRAINED else BUDGETS_DB)[str(row["records"])]


def of_scenes(rows: Sequence[dict[str, object]], *, trained: bool) -> list[dict[str, object]]:
    """The rows of TRAINED, or those of the other scenes."""
    return [row for row in rows if (row["scene"] == TRAINED) == trained]


def worst_db(rows: Sequence[dict[str, object]], records: str) -> float | None:
    """The lowest PSNR against the oracle among rows of machines with such records; None if there are none."""
    return min((float(r["psnr_vs_oracle_db"]) for r in rows if r["records"] == records), default=None)


def _worst(rows: Sequence[dict[str, object]], budgets: Mapping[str, float]) -> str:
    """The worst rows of each format of records, and their budgets."""
    return ", ".join(f"{db:.1f} dB with {records} records (budget {budget:.0f} dB)" for records, budget in budgets.items()
                     if (db := worst_db(rows, records)) is not None)


def as_markdown(rows: list[dict[str, object]]) -> str:
    """The table of reports/accuracy.md."""
    cells = []
    for r in rows:
        cells.append([f"{r['scene']}, {r['camera']}", "centre" if r["gaze"] else "none", r["sh_degree"], r["machine"],
                 f"{r['entries']:,}", f"{r['psnr_vs_oracle_db']:.1f} dB", f"{r['max_abs_error']:.3f}",
                 f"{1e4 * r['mean_error']:+.1f}e-4", f"{r['psnr_vs_exact_levels_db']:.1f} dB" if r["gaze"] else "-",
                 "-" if r["depth_error_p99"] is None else f"{100 * r['depth_error_p99']:.3f} %"])
    parts = ((f"Worst, {TRAINED}: " if trained else "Worst: ", _worst(of_scenes(rows, trained=trained), budgets))
             for trained, budgets in ((False, BUDGETS_DB), (True, TRAINED_BUDGETS_DB)))
    worst = " ".join(f"{head}{found}." for head, found in parts if found)
    why = (f" {TRAINED} has budgets of its own: harmonics of degree 3 in codes of 5 bits, and the shorter codes of Gaussians "
           "with four levels, cost its compact records 6 to 14 dB; and where a colour of 2.5 is seen, which saturates at 2, "
           "wide records lose 7 dB." if of_scenes(rows, trained=True) else "")
    note = (f"{worst}{why} {V3.name} has compact records and skips chunks; its entries differ because its splats do. Mean "
            "error: the mean colour less the oracle's. Colours clamped to [0, 1], before 8-bit rounding; with a gaze "
            "the oracle is given the same level planes. Depth: pixels nearer than half the depth scale; splats beyond 4 times "
            "the 99th percentile of z saturate, which shows where a distant sky leaks into a pixel (embedded).")
    head = ("scene, view", "gaze", "SH", "machine", "entries", "golden vs oracle", "worst pixel", "mean error",
            "vs exact levels", "depth error, p99")
    return f"{table(head, cells)}\n\n{note}\n"


def over_scenes(
    name: str, description: str, argv: Sequence[str] | None, rows_of: Callable[[Request, str], list[dict[str, object]]],
    more: Mapping[str, str] | None = None,
) -> tuple[list[dict[str, object]], argparse.Namespace]:
    """Runs the command line of a measurement.

    Args:
        name: the name of the study.
        description: the description of the command.
        argv: the arguments; None for those of the process.
        rows_of: makes the rows of a request without a gaze and of the scene's name.
        more: further scenes to measure by default, each with its views.

    Returns:
        The rows of all requested scenes and cameras, and the parsed arguments, in which `scenes` lists the measured scenes.
    """
    parser = command_parser(f"msv2 study run {name}", description, "example: MSV2_DATA=data %(prog)s --size 640x360")
    add_request_arguments(parser, size="640x360")
    parser.set_defaults(levels_from=RANDOM)
    further = "".join(f"; {views} of {scene}" for scene, views in (more or {}).items())
    parser.add_argument("--views", help=f"camera indices (default: {VIEWS}{further})")
    parser.add_argument("--out", default=str(REPORTS), metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    args.scenes = [args.scene]
    if args.scene == EMBEDDED:
        args.scenes = [*filter(None, map(scene_argument, MODELS)), *(more or ())]
    rows = []
    for scene in tqdm(args.scenes, desc=name, unit="scene"):
        for view in (args.views or (more or {}).get(scene, VIEWS)).split(","):
            request = resolve(argparse.Namespace(**{**vars(args), "scene": scene, "camera": view, "gaze": "none"}))
            rows += rows_of(request, Path(scene).stem)
    return rows, args


def keep(args: argparse.Namespace, name: str, module: str, report: dict[str, object], page: str) -> None:
    """Writes NAME.json and NAME.md into the requested folder, and prints the page.

    Args:
        args: the arguments from `over_scenes`.
        name: the name of the report.
        module: the dotted name of the study's module.
        report: the content of the JSON file.
        page: the text of the Markdown file.
    """
    out = make_folder(args.out)
    write_report(out / f"{name}.json", report, [module], {"arguments": args, "machine": PAPER}, args.scenes)
    write_page(out / f"{name}.md", page)
    print(page)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 when a view misses the budget."""
    rows, args = over_scenes("accuracy", __doc__, argv, lambda request, scene: [
        row for gazing in (False, True) for row in measure(request, scene, gazing)], {TRAINED: TRAINED_VIEWS})
    record = {"budgets_db": BUDGETS_DB, "trained_budgets_db": TRAINED_BUDGETS_DB, "rows": rows}
    keep(args, "accuracy", __name__, record, as_markdown(rows))
    return int(any(r["psnr_vs_oracle_db"] < budget_db(r) for r in rows))
