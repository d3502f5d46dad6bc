"""What training reaches: a row for each scene and variant from finished runs of golden/train.py, on test views of good pose.

    msv2 study run training_headline build/train/bonsai build/train/fern     writes training_headline.json
    msv2 study run training_headline build/train/fern-M --add --keep         adds a row to the kept ones, or replaces it

Runs that differ in their seed alone share a row, which holds their means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.files import read_json
from msv2.studies.destination import newest
from msv2.studies.page import table
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.errors import InputError, run_command_line
from spec.paths import REPORTS

NAMED = ("scene", "size", "variant", "gate", "pooling", "iterations")
"""What the runs of a row have in common."""


def numbers(report: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of one run that a row averages. All are of the judged test views; the cut counts the integer renderer's
    intersections of whole frames."""
    points, levels, entries = report["points"], report["levels"], report["entries_per_frame"]
    width, height = report["size"]
    return {
        "dense_psnr_db": report["psnr_dense"], "dense_psnr_all_db": report["psnr_dense_all"],
        "l1_psnr_share": report["psnr_l1"] / report["psnr_dense"], "cut": entries["dense"] / entries["l1"],
        "cut_foveated": entries["dense"] / entries["foveated"] if "foveated" in entries else None,
        "storage_over_l1": report["storage"]["overhead_percent"] / 100,
        "points_share": [count / points["levels"][0] for count in points["levels"]],
        "l1_points_of_dense": points["levels"][0] / points["dense"],
        "points_per_pixel": points["dense"] / (width * height), "l1_points_per_pixel": points["levels"][0] / (width * height),
        "hvsq_over_l1_gate": [row["excess_percent"] / 100 for row in levels],
        "hvsq_over_l1_test": [row["excess_test_percent"] / 100 for row in levels]}


def rows(reports: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of runs' reports, in the order of their first run.

    Raises:
        InputError: a report was written by an earlier version, or a seed comes twice in a row.
    """
    groups: dict[tuple[object, ...], list[Mapping[str, Any]]] = {}
    for report in reports:
        if "psnr_dense_all" not in report:
            raise InputError(f"the report of a run of {report['scene']} is of an earlier version: train it anew")
        options = report["options"]
        named = {"scene": report["scene"], "size": "{}x{}".format(*report["size"])}
        named |= {name: options[name] for name in NAMED[2:]}
        groups.setdefault(tuple(named[name] for name in NAMED), []).append(report)
    result = []
    for named, runs in groups.items():
        seeds = [run["options"]["seed"] for run in runs]
        if len(set(seeds)) < len(seeds):
            raise InputError(f"seed {seeds} of {named[0]} is not accepted: runs of one row must have different seeds")
        each = [numbers(run) for run in runs]
        result.append(dict(zip(NAMED, named, strict=True)) | {"seeds": seeds} | {
            key: None if each[0][key] is None else np.mean([one[key] for one in each], axis=0).tolist() for key in each[0]})
    return result


def _others(old: Sequence[dict[str, Any]], new: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The old rows that no new one replaces; a new one also replaces one with another number of iterations."""
    same = [name for name in NAMED if name != "iterations"]
    named = [[row[name] for name in same] for row in new]
    return [row for row in old if [row[name] for name in same] not in named]


def text(found: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a Markdown table."""
    def shares(values: Sequence[float], form: str = "{:.0f} %") -> str:
        return ", ".join(form.format(100 * value) for value in values[1:])

    return table(
        ["scene", "variant", "seeds", "points a pixel: dense, L1", "dense PSNR dB", "L1, of dense", "intersections: dense / L1",
         "dense / foveated", "points of L2, L3, L4 in L1's", "storage over L1's", "HVSQ over L1's, gate views", "test views"],
        [[f"{row['scene']}, {row['size']}", row["variant"], len(row["seeds"]),
          f"{row['points_per_pixel']:.2f}, {row['l1_points_per_pixel']:.2f}", f"{row['dense_psnr_db']:.2f}",
          f"{100 * row['l1_psnr_share']:.2f} %", f"{row['cut']:.2f}",
          "" if row["cut_foveated"] is None else f"{row['cut_foveated']:.2f}", shares(row["points_share"]),
          f"{100 * row['storage_over_l1']:+.1f} %", shares(row["hvsq_over_l1_gate"], "{:+.0f} %"),
          shares(row["hvsq_over_l1_test"], "{:+.0f} %")] for row in found])


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns its exit status."""
    parser = command_parser("msv2 study run training_headline", __doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a finished run of `msv2 train`")
    parser.add_argument("--add", action="store_true", help="leave the report's rows of other scenes, sizes and options in it")
    args = parser.parse_args(argv)
    folders, path = args.runs, REPORTS / "training_headline.json"
    found = rows([read_json(folder / "report.json") for folder in folders])
    old = read_json(newest(path)) if args.add and newest(path).is_file() else None
    if old:
        found = sorted([*found, *_others(old["rows"], found)], key=lambda row: [row[name] for name in NAMED])
    write_report(path, {"rows": found}, [__name__, "golden.train"], {"runs": folders},
                 [folder / "report.json" for folder in folders], earlier=old)
    print(text(found))
    return 0


if __name__ == "__main__":
    run_command_line(main)
