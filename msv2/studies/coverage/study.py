"""`msv2 study run coverage`: which bits of the units change in both directions while their quick suites are played.

The simulators are built once more with Verilator's counts of changes. Results are kept in build/coverage by unit, so that an
interrupted study continues. docs/stability.md tells more.

examples:
  msv2 study run coverage
  msv2 study run coverage --unit tile_merge_unit     one unit; the bits that stay as they are are printed
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msv2.cases import toggles
from msv2.cases.mutants.targets import TARGETS, Target, named
from msv2.studies import page
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.paths import BUILD, REPORTS

FOLDER = BUILD / "coverage"

SHOWN = 20
"""Holes of a unit that the page shows; the JSON has all."""

HEAD = """# Coverage: bits that change in the quick suites

Written by `msv2 study run coverage`. A bit of a register, port or named wire is covered where it rises and falls while the
unit's quick suite is played. Units inside that have a suite of their own are counted with that one.
"""


def row(target: Target) -> dict[str, Any]:
    """The result of a unit, from an earlier run if nothing has changed."""
    def judged() -> dict[str, Any]:
        found = toggles.toggles_of(target, FOLDER / target.name)
        return {"unit": target.name, "machine": target.machine, "bits": len(found), "covered": sum(found.values()),
                "holes": toggles.holes(found)}

    return kept(FOLDER / "kept", f"{target.name}-{fingerprint([toggles.__name__, target.module], target)}", judged)


def share(sums: Mapping[str, Any]) -> str:
    """The covered of all bits, in per cent."""
    return f"{100 * sums['covered'] / max(sums['bits'], 1):.1f} %"


def total(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The sums of all units."""
    bits, covered = (sum(row[key] for row in rows) for key in ("bits", "covered"))
    return {"bits": bits, "covered": covered, "share": round(covered / max(bits, 1), 4)}


def pages(rows: Sequence[Mapping[str, Any]]) -> str:
    """The page of the report."""
    sums = total(rows)
    table = page.table(["unit", "machine", "bits", "covered", "share"],
                       [[row["unit"], f"`{row['machine']}`", row["bits"], row["covered"], share(row)] for row in rows], left=2)
    lines = []
    for row in rows:
        lines += [[row["unit"], f"`{hole}`"] for hole in row["holes"][:SHOWN]]
        if len(row["holes"]) > SHOWN:
            lines.append([row["unit"], f"and {len(row['holes']) - SHOWN:,} more, which are in the JSON"])
    holes = page.table(["unit", "bits that stay as they are"], lines, empty="None.")
    summary = f"{sums['covered']:,} of {sums['bits']:,} bits of {len(rows)} units are covered ({share(sums)})."
    return f"{HEAD}\n{summary}\n\n{table}\n\n## Holes\n\n{holes}"


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
        tqdm.write(f"{target.name}: {rows[-1]['covered']} of {rows[-1]['bits']} bits ({share(rows[-1])})")
        for hole in rows[-1]["holes"] if args.unit else ():
            tqdm.write(f"  {hole}")
    if not args.unit:
        modules = [__name__, toggles.__name__, *{target.module for target in TARGETS}]
        write_report(args.out.with_suffix(".json"), {**total(rows), "rows": rows}, modules, args)
        page.write_page(args.out, pages(rows))
    return 0
