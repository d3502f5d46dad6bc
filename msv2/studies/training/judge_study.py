"""What FovVideoVDP, a judge that no stage of training reads, says of finished runs: frames with the gaze in the centre, and
each level alone, seen at the eccentricity where its region begins.

    msv2 study run judge build/train/fern build/train/bonsai --keep     judge.{json,md}
    msv2 study run judge build/train/fern-M --add --keep                adds a run's rows to the kept ones, or replaces them

The package pyfvvdp is needed (the extra `judge`); its licence CC BY-NC 4.0 forbids commercial use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from golden.diff import import_torch
from golden.scenes.files import read_json
from msv2.studies.destination import newest
from msv2.studies.page import table, write_page
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.constants import REGION_START_DEG
from spec.errors import run_command_line
from spec.paths import REPORTS


def page(rows: Sequence[Mapping[str, Any]]) -> str:
    """The report as a page."""
    def name(row: Mapping[str, Any]) -> list[Any]:
        return [f"{row['scene']}, {row['size']}", row["variant"] + (f", {row['baseline']}" if row["baseline"] else ""),
                row["seed"], row["views"]]

    heads = ["scene", "variant", "seed", "test views"]
    return "\n".join([
        "# What an independent judge says of trained models", "",
        "Written by `msv2 study run judge`. FovVideoVDP (Mantiuk et al. 2021) compares each picture with its photograph, in "
        "JOD: 10 is a picture that nobody tells from it, and one less is told by 75 % of the observers. No stage of training "
        "reads it. Means over the test views.", "", "## Frames", "",
        "The frame spans the display's 90 degrees, and the gaze is in its centre. SMFR's levels are random subsets of L1 with "
        "the same points, which are not trained.", "",
        table([*heads, "dense", "L1 everywhere", "foveated", "foveated less dense", "SMFR", "SMFR less dense"],
              [[*name(row), *(f"{row['frames'][key]:.2f}" for key in ("dense", "l1", "foveated")),
                f"{row['frames']['foveated'] - row['frames']['dense']:+.2f}", f"{row['frames']['smfr']:.2f}",
                f"{row['frames']['smfr'] - row['frames']['dense']:+.2f}"] for row in rows]), "", "## Levels", "",
        "Each level's whole frame, in pixels of the paper's display, with its centre at the eccentricity where the level's "
        "region begins; in brackets by how much it is above L1's, seen from the same place.", "",
        table([*heads, *(f"L{i} at {start:g} degrees" for i, start in enumerate(REGION_START_DEG, 1))],
              [[*name(row), *(f"{level['jod']:.2f} ({level['jod'] - level['l1_jod']:+.2f})" for level in row["levels"])]
               for row in rows]), ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns its exit status."""
    parser = command_parser("msv2 study run judge", __doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a finished run of `msv2 train`")
    parser.add_argument("--add", action="store_true", help="leave the report's rows of other runs in it")
    args = parser.parse_args(argv)
    import_torch()
    from msv2.studies.training.judge import NAMED, row_of

    path, folders = REPORTS / "judge.json", args.runs
    found = [row_of(folder) for folder in folders]
    old = read_json(newest(path)) if args.add and newest(path).is_file() else None
    if old:
        new = [[row[name] for name in NAMED] for row in found]
        found += [row for row in old["rows"] if [row[name] for name in NAMED] not in new]
    found.sort(key=lambda row: [str(row[name]) for name in NAMED])
    write_report(path, {"rows": found}, [__name__, "golden.train"], {"runs": folders},
                 [folder / "report.json" for folder in folders], earlier=old)
    write_page(REPORTS / "judge.md", page(found))
    print(page(found))
    return 0


if __name__ == "__main__":
    run_command_line(main)
