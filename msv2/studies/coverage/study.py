"""`msv2 study run coverage`: which bits of the units change in both directions while their quick suites are played, and which
ways are taken at choices: both values of every select, and every case.

The simulators are built once more with Verilator's counts. Results are kept in build/coverage by unit, so that an
interrupted study continues. docs/stability.md tells more.

examples:
  msv2 study run coverage
  msv2 study run coverage --unit tile_merge_unit     one unit; bits that stay and ways not taken are printed
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msv2.cases import choices, counts, toggles
from msv2.cases.mutants.targets import TARGETS, Target, named
from msv2.studies import page
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.paths import BUILD, REPORTS

FOLDER = BUILD / "coverage"

COUNTING = (counts.__name__, toggles.__name__, choices.__name__)
"""The modules that count."""

SHOWN = 20
"""Holes of a unit of either kind that the page shows; the JSON has all."""

HEAD = """# Coverage: bits that change and ways that are taken in the quick suites

Written by `msv2 study run coverage`. A bit of a register, port or named wire is covered where it rises and falls while the
unit's quick suite is played. A way is one value of a select's condition, or one case of several. Lines are those lines of
Python that the Verilog names at its choices, and whole are those at which every way is taken. Units inside that have a suite of
their own are counted with that one.
"""


def row(target: Target) -> dict[str, Any]:
    """The result of a unit, from an earlier run if nothing has changed."""
    def judged() -> dict[str, Any]:
        points, verilog = counts.counted(target, FOLDER / target.name)
        bits, ways = toggles.toggles(points), choices.ways(points, verilog)
        lines = choices.lines_of(ways)
        return {"unit": target.name, "machine": target.machine, "bits": len(bits), "covered": sum(bits.values()),
                "ways": len(ways), "taken": sum(way.taken for way in ways), "lines": len(lines), "whole": sum(lines.values()),
                "holes": toggles.holes(bits), "not_taken": choices.holes(ways)}

    return kept(FOLDER / "kept", f"{target.name}-{fingerprint([*COUNTING, target.module], target)}", judged)


def share(part: int, whole: int) -> str:
    """A part in per cent."""
    return f"{100 * part / max(whole, 1):.1f} %"


def total(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The sums of all units."""
    sums = {key: sum(row[key] for row in rows) for key in ("bits", "covered", "ways", "taken", "lines", "whole")}
    return {**sums, "share": round(sums["covered"] / max(sums["bits"], 1), 4),
            "share_of_ways": round(sums["taken"] / max(sums["ways"], 1), 4)}


def pages(rows: Sequence[Mapping[str, Any]]) -> str:
    """The page of the report."""
    sums = total(rows)
    table = page.table(
        ["unit", "machine", "bits", "covered", "share", "ways", "taken", "share", "lines", "whole"],
        [[row["unit"], f"`{row['machine']}`", row["bits"], row["covered"], share(row["covered"], row["bits"]), row["ways"],
          row["taken"], share(row["taken"], row["ways"]), row["lines"], row["whole"]] for row in rows], left=2)
    summary = (
        f"Of {len(rows)} units, {sums['covered']:,} of {sums['bits']:,} bits are covered "
        f"({share(sums['covered'], sums['bits'])}), {sums['taken']:,} of {sums['ways']:,} ways are taken "
        f"({share(sums['taken'], sums['ways'])}), and all ways at {sums['whole']:,} of {sums['lines']:,} lines.")
    return (f"{HEAD}\n{summary}\n\n{table}\n\n## Bits that stay as they are\n\n{_listed(rows, 'holes')}\n\n"
            f"## Ways that are not taken\n\n{_listed(rows, 'not_taken')}")


def _listed(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    """The first holes of each unit as a table."""
    lines = []
    for row in rows:
        lines += [[row["unit"], f"`{hole}`".replace("|", "\\|")] for hole in row[key][:SHOWN]]
        if len(row[key]) > SHOWN:
            lines.append([row["unit"], f"and {len(row[key]) - SHOWN:,} more, which are in the JSON"])
    return page.table(["unit", "where"], lines, empty="None.")


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run coverage", __doc__.split(": ", 1)[1])
    parser.add_argument("--unit", action="append", default=[], metavar="NAME",
                        help=f"only this unit, and write nothing; can be repeated (of {', '.join(t.name for t in TARGETS)})")
    parser.add_argument("--out", type=Path, default=REPORTS / "coverage.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes coverage.json and the page coverage.md."""
    args = _arguments(argv)
    targets = [named(name) for name in args.unit] or TARGETS
    rows: list[dict[str, Any]] = []
    for target in tqdm(targets, desc="units", disable=not sys.stderr.isatty()):
        rows.append(row(target))
        tqdm.write(f"{target.name}: {rows[-1]['covered']} of {rows[-1]['bits']} bits, "
                   f"{rows[-1]['taken']} of {rows[-1]['ways']} ways")
        for hole in [*rows[-1]["holes"], *rows[-1]["not_taken"]] if args.unit else ():
            tqdm.write(f"  {hole}")
    if not args.unit:
        modules = [__name__, *COUNTING, *{target.module for target in TARGETS}]
        write_report(args.out.with_suffix(".json"), {**total(rows), "rows": rows}, modules, args)
        page.write_page(args.out, pages(rows))
    return 0
