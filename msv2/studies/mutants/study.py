"""`msv2 study run mutants`: puts small faults into the circuits of units, and counts how many the units' quick suites notice.

Each unit is built once with all its mutants, and its suite is played on each of them. A mutant that no run notices is compared
with the sound circuit by SAT; what is equal does not count. docs/stability.md tells more. Results are kept in build/mutants by
unit, so that an interrupted study continues. The study needs the extra `synth`.

examples:
  msv2 study run mutants                                 40 mutants of every unit
  msv2 study run mutants --unit chunk_sorter --count 200 --seed 7
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msv2.cases.formal.circuit import find_abc
from msv2.cases.mutants import equal, judge, mutate
from msv2.cases.mutants.targets import TARGETS, Target, named
from msv2.studies import page
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.errors import InputError
from spec.paths import BUILD, REPORTS
from synth.flow import version

FOLDER = BUILD / "mutants"

COUNT, SEED = 40, 1

HEAD = """# Mutants: small faults in the circuits of units

Written by `msv2 study run mutants`. A mutant inverts one bit of one port of one cell, ties it to 0 or 1, or inverts it where
another bit is 0 or 1. It is killed where a run of the unit's quick suite gives another result, hangs or does not end. A mutant
that survives and is proven to compute the same is equal, and does not count. docs/stability.md tells how it is done.
"""


def row(target: Target, count: int, seed: int) -> dict[str, Any]:
    """The result of a unit, from an earlier run if nothing has changed."""
    key = fingerprint([judge.__name__, mutate.__name__, equal.__name__, target.module], target, count, seed, version())
    with tqdm(total=count, desc=target.name, leave=False, disable=not sys.stderr.isatty()) as bar:
        return kept(FOLDER / "kept", f"{target.name}-{key}",
                    lambda: judge.judge(target, count, seed, FOLDER / target.name, lambda _: bar.update()))


def total(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The sums of all units: `drawn`, `equal`, `judged` (those that are not equal), `killed`, and the share of the killed."""
    drawn, same, killed = (sum(row[key] for row in rows) for key in ("drawn", "equal", "killed"))
    judged = drawn - same
    return {"drawn": drawn, "equal": same, "judged": judged, "killed": killed, "share": round(killed / max(judged, 1), 4)}


def share(row: Mapping[str, Any]) -> str:
    """Killed of those that can be noticed, in per cent."""
    return f"{100 * row['killed'] / max(row['drawn'] - row['equal'], 1):.1f} %"


def pages(rows: Sequence[Mapping[str, Any]], seed: int, missing: Sequence[str] = ()) -> str:
    """The page of the report; `missing` are units that have not been judged yet."""
    sums = total(rows)
    summary = (f"{sums['killed']} of {sums['judged']} mutants of {len(rows)} units are killed ({share(sums)}); {sums['equal']} "
               f"more are equal to the sound circuit. They were drawn with seed {seed}.")
    if missing:
        summary += f" Not judged yet: {', '.join(missing)}."
    table = page.table(
        ["unit", "machine", "mutants", "equal", "killed", "share"],
        [[row["unit"], f"`{row['machine']}`", row["drawn"], row["equal"], row["killed"], share(row)] for row in rows], left=2)
    survivors = page.table(
        ["unit", "what is changed", "made by"],
        [[row["unit"], f"`{each['what']}`", ", ".join(each["lines"][-1:])] for row in rows for each in row["survivors"]],
        empty="None.")
    return f"{HEAD}\n{summary}\n\n{table}\n\n## Survivors\n\n{survivors}"


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run mutants", __doc__.split(": ", 1)[1])
    parser.add_argument("--unit", action="append", default=[], metavar="NAME",
                        help=f"only this unit, and write nothing; can be repeated (of {', '.join(t.name for t in TARGETS)})")
    parser.add_argument("--count", type=int, default=COUNT, metavar="N", help="mutants of each unit (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=SEED, help="selects the mutants (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=REPORTS / "mutants.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    if not 1 <= args.count < 1 << mutate.SELECT_BITS or args.seed < 0:
        raise InputError(f"--count {args.count} --seed {args.seed} is not accepted: 1 to {(1 << mutate.SELECT_BITS) - 1} "
                         "mutants, and a seed from 0 on are")
    return args


def _write(args: argparse.Namespace, rows: Sequence[Mapping[str, Any]], missing: Sequence[str]) -> None:
    """Writes the report with the units that have been judged, so that an interrupted study leaves one, too."""
    content = {**total(rows), "count": args.count, "seed": args.seed, "missing": list(missing), "rows": list(rows)}
    modules = [__name__, "msv2.cases.mutants.forks", *{target.module for target in TARGETS}]
    write_report(args.out.with_suffix(".json"), content, modules, args)
    page.write_page(args.out, pages(rows, args.seed, missing))


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes mutants.json and the page mutants.md."""
    args = _arguments(argv)
    find_abc()
    targets = [named(name) for name in args.unit] or TARGETS
    rows: list[dict[str, Any]] = []
    for target in tqdm(targets, desc="units", disable=not sys.stderr.isatty()):
        rows.append(row(target, args.count, args.seed))
        found = rows[-1]
        tqdm.write(f"{target.name}: {found['killed']} of {found['drawn'] - found['equal']} killed ({share(found)}), "
                   f"{found['equal']} equal")
        for each in found["survivors"] if args.unit else ():
            tqdm.write(f"  {each['number']}: {each['what']}, {', '.join(each['lines'])}")
        sys.stdout.flush()
        if not args.unit:
            _write(args, rows, [target.name for target in targets[len(rows):]])
    return 0
