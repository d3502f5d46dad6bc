"""The effect of the display's pixels on the levels: compares runs of golden/train.py whose --pooling-width differs.

    msv2 study run pooling build/train/fern build/train/fern-pooled     writes reports/pooling.json
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from golden.scenes.files import read_json
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.errors import run_command_line
from spec.paths import REPORTS


def row(folder: Path) -> dict[str, object]:
    """The kept numbers of a run's report.

    Raises:
        InputError: the run has no report.
    """
    report = read_json(folder / "report.json")
    return {
        "scene": report["scene"], "size": report["size"], "pooling_width": report["options"]["pooling-width"],
        "points": report["points"]["levels"], "storage_overhead_percent": report["storage"]["overhead_percent"],
        "cut_foveated": report["entries_per_frame"]["dense"] / report["entries_per_frame"]["foveated"]}


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    parser = command_parser("msv2 study run pooling", __doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a finished run of `msv2 train`")
    folders = parser.parse_args(argv).runs
    write_report(REPORTS / "pooling.json", {"rows": [row(folder) for folder in folders]}, [__name__, "golden.train"],
                 {"runs": folders}, [folder / "report.json" for folder in folders])


if __name__ == "__main__":
    run_command_line(main)
