"""Runs the hard cases on all renderers, and writes the results as stability.json, a page stability.md and a picture
stability.png.

    msv2 study run stability                                    everything (half an hour), into build/stability
    msv2 study run stability --keep                             the same, and also into reports/
    msv2 study run stability --columns oracle,golden --no-faults    a minute; needs neither torch nor a simulator

`python -m msv2.cases` runs the cases. Except for --keep, all options are options of that command.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from golden.scenes.files import read_json
from golden.scenes.request import make_folder
from msv2.cases import command
from msv2.cases.case import COLUMNS
from msv2.cases.report import HEADINGS
from msv2.studies.destination import keeping
from msv2.studies.page import table, write_page
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.record import write_report
from spec.paths import REPORTS

MODULES = ("msv2.studies.stability.study", "msv2.cases.command", command.GRADIENTS)
FOLDER = "build/stability"


def summary(report: Mapping[str, Any]) -> str:
    """A line with the numbers of cases and seeded faults, of failed cases and of caught faults."""
    faults = report["faults"]
    caught = f"; {report['seeded_faults_caught']} of {len(faults)} seeded faults caught" if faults else ""
    return f"{len(report['results'])} cases, {report['failed']} failed{caught}; {report['seconds'] / 60:.1f} minutes"


def markdown(report: Mapping[str, Any]) -> str:
    """The page stability.md. All of its content is also in stability.json."""
    names = [name for name in COLUMNS if name in report["columns"]]
    rows = []
    for case, found in report["results"].items():
        outcomes = [found["columns"].get(name, {}).get("outcome", "") for name in names]
        worst = "" if found["worst_error_255"] is None else f"{found['worst_error_255']:.3f}"
        rows.append([case, found["what"], *outcomes, worst])
    faults = [[fault["name"], HEADINGS[fault["column"]], fault["case"], "yes" if fault["caught"] else "NO"]
              for fault in report["faults"]]
    return "\n".join([
        "# Stability", "", "Written by `make stability`, explained in [docs/stability.md](../docs/stability.md).", "",
        f"{summary(report)}.", "",
        table(["case", "what", *(HEADINGS[name] for name in names), "worst error, 1/255"], rows), "",
        "## Seeded faults", "", table(["guard dropped", "in", "case that must fail", "caught"], faults)])


def picture(report: Mapping[str, Any], path: Path) -> bool:
    """The table as a picture: a square for each outcome, a bar for the worst error; False where matplotlib is not installed."""
    pyplot = find_pyplot()
    if pyplot is None:
        return False
    colours = {"pass": "#4c9f70", "FAIL": "#c8402f", "-": "#dddddd"}
    rows, columns = report["results"], [name for name in COLUMNS if name in report["columns"]]
    figure, (grid, bars) = pyplot.subplots(
        1, 2, figsize=(9, 0.2 * len(rows) + 1.2), sharey=True, width_ratios=(len(columns), 4))
    for y, row in enumerate(rows.values()):
        for x, name in enumerate(columns):
            if name in row["columns"]:
                grid.add_patch(pyplot.Rectangle((x, y - 0.45), 0.92, 0.9, color=colours[row["columns"][name]["outcome"]]))
    grid.set_xlim(0, len(columns))
    grid.set_ylim(len(rows) - 0.5, -0.5)
    grid.set_xticks([x + 0.46 for x in range(len(columns))], [HEADINGS[name] for name in columns])
    grid.set_yticks(range(len(rows)), list(rows), fontsize=7)
    grid.xaxis.tick_top()
    grid.tick_params(length=0)
    bars.barh(range(len(rows)), [row["worst_error_255"] or 0.0 for row in rows.values()], color="#49708a", height=0.7)
    bars.set_xscale("symlog", linthresh=0.01)
    bars.set_xlabel("worst difference to the oracle's image, 1/255")
    bars.axvline(0.5, color="#999999", linewidth=0.8)
    for side in ("top", "right"):
        bars.spines[side].set_visible(False)
    for side in ("top", "right", "bottom", "left"):
        grid.spines[side].set_visible(False)
    figure.tight_layout()
    save_figure(figure, path)
    return True


def write(report: Mapping[str, Any], folder: Path, options: Sequence[str], earlier: Mapping[str, Any] | None = None) -> None:
    """Writes stability.json with its provenance, stability.md, and, if matplotlib is installed, stability.png."""
    write_report(make_folder(folder) / "stability.json", report, MODULES, {"cases": options}, earlier=earlier)
    write_page(folder / "stability.md", markdown(report))
    picture(report, folder / "stability.png")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 if a case fails or a seeded fault is not caught."""
    parser = argparse.ArgumentParser(prog="msv2 study run stability", description=__doc__, add_help=False,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--out", type=Path, default=Path(FOLDER), metavar="DIR", help=f"output folder (default: {FOLDER})")
    args, cases = parser.parse_known_args(argv)
    if args.help:
        parser.print_help()
        return command.main(["--help"])
    kept = args.out / "stability.json"
    earlier = read_json(kept) if "--add" in cases and kept.exists() else None
    status = command.main([*cases, "--out", str(args.out)])
    report = read_json(kept)
    for folder in (args.out, *[REPORTS] * keeping()):
        write(report, folder, cases, earlier)
    return status
