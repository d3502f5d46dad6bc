"""`msv2 study run tradeoff`: the cost of accuracy in time, with plots, tables and recommendations."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size, write_json
from msv2.studies.kept import fingerprint
from msv2.studies.tradeoff import crops, hard, measure, report, simulation, tables, training
from msv2.studies.tradeoff.choose import BUDGETS, candidate_parts, frontier, recommended, with_losses
from msv2.studies.tradeoff.jobs import run_all
from msv2.studies.tradeoff.knobs import BASE, DEFAULT, Setting, combined, single, word_bits
from msv2.studies.tradeoff.scene import SceneRequest, load
from msv2.studies.web.look import take_screenshots
from spec.command_line import choice, command_parser
from spec.config import CONFIGS
from spec.errors import InputError
from spec.paths import IN_CHECKOUT, REPORTS

EPILOG = """\
Writes OUT/NAME.md, NAME.json, NAME.html, and a PNG with a CSV beside it of machine, simulation and training. What was measured
is kept in WORK by settings and sources: after Ctrl-C the same command goes on. docs/tradeoff.md explains the columns.
With --pages it measures nothing, and writes the pages and their pictures anew from a report that is kept.

examples:
  msv2 study run tradeoff                                                 the embedded scene
  msv2 study run tradeoff build/train/fern --size 252x189                 a finished run, against its photographs
  msv2 study run tradeoff build/train/fern --variant M=build/train/fern-M    and another variant of it
  msv2 study run tradeoff truck.splat --size 320x180 --jobs 4
  msv2 study run tradeoff --knob "support radius" --knob "SH degree"      only some knobs
  msv2 study run tradeoff --rtl --size 64x48                              the simulation's picture with the RTL in it
  msv2 study run tradeoff --pages reports/tradeoff.json --screenshots     the pages of a kept report, looked at in Chromium
  msv2 study run tradeoff --scheduler tcp://10.0.0.1:8786   over a Dask cluster (the extra 'cluster')
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed command line."""
    parser = command_parser("msv2 study run tradeoff", __doc__, EPILOG)
    add = parser.add_argument
    add("scene", nargs="?", default=EMBEDDED, metavar="SCENE",
        help="a model, the folder of a finished training run, or embedded (default)")
    add("--size", default="192x108", metavar="WxH", help="size of the frames (default: 192x108)")
    add("--views", type=int, default=2, metavar="N", help="number of views, spread over the test views (default: 2)")
    add("--variant", action="append", default=[], metavar="NAME=PATH", help="another model of the same world with four levels")
    add("--knob", action="append", default=[], metavar="KNOB", help="measure only this knob; can be repeated (default: all)")
    add("--units-per-metre", type=float, default=1.0, metavar="S", help="scale of the scene for two eyes (default: 1)")
    add("--runs", default="build/train", metavar="DIR,DIR", help="folders of finished training runs (default: build/train)")
    add("--rtl", action="store_true", help="also simulate the first view in RTL (minutes; choose a small size)")
    add("--rtl-config", default="tiny", metavar="NAME",
        help="configuration for the picture of the RTL simulation (default: tiny)")
    add("--rtl-size", default="64x48", metavar="WxH", help="frame size for that picture (default: 64x48)")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="number of processes (default: one per core)")
    add("--scheduler", metavar="ADDRESS", help="address of a Dask cluster to use instead of local processes")
    add("--work", default="build/tradeoff/kept", metavar="DIR", help="cache of measurements")
    add("--out", default="build/tradeoff", metavar="DIR", help="output folder (default: build/tradeoff)")
    add("--pages", type=Path, metavar="JSON", help="only write the pages of this report; SCENE is needed for their crops")
    add("--screenshots", action="store_true", help="also look at the page in Chromium: OUT/screenshots/NAME_*.png")
    add("--name", default="tradeoff", help="name of the output files (default: tradeoff)")
    return parser.parse_args(argv)


def scene_request(args: argparse.Namespace) -> SceneRequest:
    """The scene on which the command line asks to measure.

    Raises:
        InputError: a size, a variant or a scale is not valid.
    """
    choice("config", args.rtl_config, CONFIGS)
    parse_size(args.size)
    parse_size(args.rtl_size)
    variants = [tuple(text.split("=", 1)) for text in args.variant]
    if any(len(variant) != 2 or not all(variant) for variant in variants):
        raise InputError(f"variant {args.variant!r} is not accepted: NAME=PATH is")
    if not 0 < args.units_per_metre < float("inf"):
        raise InputError(f"units per metre {args.units_per_metre!r} is not accepted: a positive number is")
    return SceneRequest(args.scene, args.size, args.views, tuple(variants), args.units_per_metre, args.work)


def sweep(
    work: Callable[..., dict[str, Any]], calls: Sequence[tuple[object, ...]], keys: Sequence[str], args: argparse.Namespace,
    what: str,
) -> list[dict[str, Any]]:
    """The results of `work` for every call, in order. Kept results are read; others are computed and kept."""
    folder = make_folder(Path(args.work) / what)
    found: dict[str, dict[str, Any]] = {}
    for key in dict.fromkeys(keys):
        path = folder / f"{key}.json"
        try:
            found[key] = read_json(path)
        except InputError:
            pass  # not measured yet, or damaged
    todo = [key for key in dict.fromkeys(keys) if key not in found]
    missing = [calls[keys.index(key)] for key in todo]
    results = run_all(work, missing, jobs=args.jobs, scheduler=args.scheduler)
    for index, result in tqdm(results, total=len(todo), desc=what, unit="point", disable=None):
        found[todo[index]] = result
        write_json(folder / f"{todo[index]}.json", result)
    print(f"{what}: {len(set(keys))} points, {len(todo)} measured now", file=sys.stderr)
    return [found[key] for key in keys]


def machine_rows(request: SceneRequest, settings: Sequence[Setting], args: argparse.Namespace) -> list[dict[str, Any]]:
    """The rows of settings, with their quality, their costs and the hard cases that they break."""
    scene = load(request)
    made = fingerprint([measure.__name__]), fingerprint([hard.__name__])
    measured = sweep(measure.tried, [(request, s) for s in settings],
                     [fingerprint((), made[0], scene.identity(s.variant), request.size, request.units_per_metre, s)
                      for s in settings], args, "frames")
    cases = sweep(hard.hard_cases, [(s,) for s in settings], [fingerprint((), made[1], hard.identity(s)) for s in settings],
                  args, "hard")
    areas = report.known_areas(REPORTS / "area.json")
    rows = []
    for setting, quality, stable in zip(settings, measured, cases, strict=True):
        rows.append({
            "knob": setting.knob, "value": setting.value, "parts": [list(part) for part in setting.parts],
            "threshold_deg": setting.threshold_deg, "variant": setting.variant, "in_rtl": setting.in_rtl,
            "word_bits": word_bits(setting.config), "functions": setting.functions,
            "area_mm2": None if setting.obb else areas.get(setting.config.with_(name=BASE.name)),
            **quality, **stable})
    return rows


def marked(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with losses. Hard cases that the default breaks itself do not count for other settings."""
    default = next(row for row in rows if row["knob"] == DEFAULT)
    for row in rows:
        row["broken"] = {name: why for name, why in row["broken"].items() if row is default or name not in default["broken"]}
    with_losses(rows)
    frontier(rows)
    return rows


def machine(request: SceneRequest, args: argparse.Namespace) -> list[dict[str, Any]]:
    """All single settings and, for every budget, a combination of the best ones. While a combination exceeds its budget, its
    part with the largest loss is removed."""
    scene = load(request)
    model = scene.leveled[""]
    settings = single(model.sh_degree, scene.levels_named, [name for name, _ in request.variants])
    known = list(dict.fromkeys(s.knob for s in settings))
    if unknown := [knob for knob in args.knob if knob not in known]:
        raise InputError(f"knob {unknown[0]!r} is not accepted: choose of {', '.join(known[1:])}")
    settings = [s for s in settings if not args.knob or s.knob in (DEFAULT, *args.knob)]
    rows = marked(machine_rows(request, settings, args))
    parts = {budget.name: candidate_parts(rows, budget) for budget in BUDGETS}
    open_budgets = [budget for budget in BUDGETS if len(parts[budget.name]) > 1]
    while open_budgets:
        more = [combined(f"for {b.name}, {len(parts[b.name])}", parts[b.name], model.sh_degree, scene.levels_named)
                for b in open_budgets]
        known_parts = {s.parts for s in settings}
        settings += {s.parts: s for s in reversed(more) if s.parts not in known_parts}.values()  # the strictest name
        rows = marked(machine_rows(request, settings, args))
        by_parts = {tuple(map(tuple, row["parts"])): row for row in rows if row["parts"]}
        open_budgets = [b for b in open_budgets if not b.holds(by_parts[tuple(parts[b.name])])]
        for budget in open_budgets:
            parts[budget.name].pop()  # the largest loss
        open_budgets = [b for b in open_budgets if len(parts[b.name]) > 1]
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = parse_arguments(argv)
    request, out = scene_request(args), make_folder(args.out)
    if args.pages is not None:
        return write_pages(read_json(args.pages), args, request)
    rows = machine(request, args)
    small = SceneRequest(args.scene, args.rtl_size if args.rtl else args.size, 1, work=args.work)
    scene, played = load(request), None
    if args.rtl:
        played = simulation.played(small, args.rtl_config)
    simulated = simulation.renderers(small, args.rtl_config, played)
    content = {
        "scene": Path(args.scene).stem, "size": args.size, "views": args.views, "photographs": scene.photographs is not None,
        "levels": scene.levels_named, "points": len(scene.leveled[""]), "machine": rows,
        "recommended": {b.name: recommended(rows, b) for b in BUDGETS},
        "config": BASE.name, "presets": {b.preset: b.name for b in BUDGETS if b.preset},
        "simulation": {"size": small.size, "config": args.rtl_config, "rows": simulated},
        "training": training.runs([Path(folder) for folder in args.runs.split(",")])}
    inputs = [args.scene, *(path for _, path in request.variants), REPORTS / "area.json"]
    report.write(content, out, args.name, {"arguments": args, "machine": BASE}, inputs)
    print(tables.recommendation(content))
    return write_pages(read_json(out / f"{args.name}.json"), args, request)


def write_pages(content: dict[str, Any], args: argparse.Namespace, request: SceneRequest) -> int:
    """Writes the pages of a report's content; 1 if screenshots are asked for and show a fault of the page."""
    shown: list[crops.Crop] = []
    if Path(args.scene).stem == content["scene"]:
        print("rendering the crops", flush=True)
        shown = crops.crops(content, args.scene, request.variants)
    else:
        print(f"no crops: the report is of {content['scene']!r}, and SCENE is {args.scene!r}")
    out = make_folder(args.out)
    report.write_pages(content, out, args.name, shown)
    page = out / f"{args.name}.html"
    print(f"wrote {page}, which contains its pictures, and {args.name}.md")
    if (out.resolve(), args.name) == (REPORTS.resolve(), "tradeoff") and IN_CHECKOUT:
        report.fill_document(content)
    return 0 if not args.screenshots or take_screenshots(page, make_folder(out / "screenshots")) else 1
