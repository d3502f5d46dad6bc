"""`msv2 study run source_mutants`: puts small faults into `spec/` and the integer renderer, and counts what notices them.

Each mutant is judged in a copy of the project: by the hard cases, which compare the integer renderer with the oracle and with
stated values, and by the quick tests of the part. docs/stability.md tells more. Verdicts are kept in build/source_mutants, so
that an interrupted study continues. The exit status is 1 where something notices a mutant that is said to compute the same.

examples:
  msv2 study run source_mutants                              200 mutants of spec, 300 of the integer renderer
  msv2 study run source_mutants --count spec=40 --count golden=150
  msv2 study run source_mutants --part spec --count 40 --seed 7
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msv2.cases.source_mutants import draw, play
from msv2.cases.source_mutants.equal import reason
from msv2.cases.source_mutants.play import PARTS, Judge, Part
from msv2.studies import page
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import write_report
from spec.command_line import choice, command_parser
from spec.errors import InputError
from spec.paths import BUILD, REPORTS, ROOT

FOLDER = BUILD / "source_mutants"

COUNTS, SEED = {"spec": 200, "golden": 300}, 1

HEAD = """# Mutants of Python: small faults in what golden and RTL share, and in the integer renderer

Written by `msv2 study run source_mutants`. A mutant replaces an operator, a constant or a function of a module by another
one. It is noticed where a hard case fails on the integer renderer or on the oracle, or a quick test fails; for the renderer
the cases come first, for spec the tests of its own. docs/stability.md tells how it is done. The share is of those that are
not known to compute the same.
"""


def verdicts(part: Part, count: int, seed: int) -> list[dict[str, Any]]:
    """The verdict of each mutant of a part, from earlier runs where nothing has changed."""
    mutants = draw.draw(part.paths, count, seed, ROOT)
    folders = (*part.first, *part.tests)
    tests = [path.read_bytes() for folder in folders for path in sorted((ROOT / folder).glob("*.py"))]
    modules = [path.removesuffix(".py").replace("/", ".") for path in part.paths]
    state = fingerprint([play.WORKER, draw.__name__, *modules], part, *tests)
    judge: list[Judge] = []

    def judged(mutant: draw.SourceMutant) -> dict[str, Any]:
        if not judge:
            judge.append(Judge(part, FOLDER / part.name))
        return {"path": mutant.path, "line": mutant.line, "what": mutant.words, **judge[0].judge(mutant)}

    folder = FOLDER / "kept" / f"{part.name}-{state}"
    rows = [kept(folder, f"{mutant.path.replace('/', '.')}-{mutant.number}", partial(judged, mutant))
            for mutant in tqdm(mutants, desc=part.name, disable=not sys.stderr.isatty())]
    return [row | {"equal": reason((ROOT / mutant.path).read_text(), mutant)}
            for row, mutant in zip(rows, mutants, strict=True)]


def contradictions(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The mutants that are said to compute the same, and that something notices."""
    return [f"{row['path']}:{row['line']}: {row['what']} is said to compute the same ({row['equal']}), and a {row['by']} "
            f"notices it: {row['words']}" for row in rows if row["equal"] and row["by"]]


def total(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How many mutants there are, how many compute the same, how many cases and tests notice, how many end neither well nor
    with a verdict, and the share that is noticed of those that do not compute the same."""
    by, equal = Counter(row["by"] for row in rows), sum(1 for row in rows if row["equal"])
    noticed, judged = len(rows) - by[""], len(rows) - equal
    return {"mutants": len(rows), "equal": equal, "judged": judged, "by_cases": by["case"], "by_tests": by["test"],
            "no_end": by["hang"] + by["crash"], "noticed": noticed, "share": round(noticed / max(judged, 1), 4)}


def chosen_counts(words: Sequence[str]) -> dict[str, int]:
    """The numbers of mutants by part that N and PART=N say; the later one counts.

    Raises:
        InputError: there is no such part, or N is no number.
    """
    found: dict[str, int] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        if not number.isdecimal():
            raise InputError(f"--count {word} is not accepted: a number is, or PART=NUMBER")
        found |= dict.fromkeys([choice("part", name, sorted(PARTS))] if name else PARTS, int(number))
    return found


def _line(name: str, rows: Sequence[Mapping[str, Any]]) -> list[object]:
    """A line of the table."""
    sums = total(rows)
    counts = [sums[key] for key in ("mutants", "equal", "by_cases", "by_tests", "no_end")]
    return [name, *counts, f"{100 * sums['share']:.1f} %"]


def pages(parts: Mapping[str, Sequence[Mapping[str, Any]]], seed: int) -> str:
    """The page of the report."""
    lines, left = [], []
    for name, rows in parts.items():
        lines.append(_line(f"**{name}**", rows))
        for path in sorted({row["path"] for row in rows}):
            lines.append(_line(f"`{path}`", [row for row in rows if row["path"] == path]))
        left += [[f"{row['path']}:{row['line']}", row["what"], row["equal"]] for row in rows if not row["by"]]
    table = page.table(
        ["module", "mutants", "compute the same", "noticed by cases", "by tests", "crash or hang", "share"], lines, left=1)
    survivors = page.table(["line", "what is changed"], [row[:2] for row in left if not row[2]], empty="None.")
    equal = page.table(["line", "what is changed", "why it computes the same, by reading"], [row for row in left if row[2]],
                       empty="None.")
    return (f"{HEAD}\nThey were drawn with seed {seed}.\n\n{table}\n\n## What nothing notices\n\n{survivors}\n\n"
            f"## What computes the same\n\n{equal}")


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run source_mutants", __doc__.split(": ", 1)[1])
    parser.add_argument("--part", metavar="NAME", help=f"only this part, and write nothing (of {', '.join(PARTS)})")
    parser.add_argument("--count", action="append", default=[], metavar="[PART=]N", help="mutants of a part, or of each; "
                        "can be repeated (default: " + ", ".join(f"{count} of {name}" for name, count in COUNTS.items()) + ")")
    parser.add_argument("--seed", type=int, default=SEED, help="selects the mutants (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=REPORTS / "source_mutants.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    if args.seed < 0:
        raise InputError(f"--seed {args.seed} is not accepted: a seed from 0 on is")
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes source_mutants.json and the page source_mutants.md."""
    args = _arguments(argv)
    names = [choice("part", args.part, sorted(PARTS))] if args.part else list(PARTS)
    counts = COUNTS | chosen_counts(args.count)
    parts: dict[str, list[dict[str, Any]]] = {}
    for name in names:
        parts[name] = verdicts(PARTS[name], counts[name], args.seed)
        sums = total(parts[name])
        tqdm.write(f"{name}: {sums['noticed']} of {sums['judged']} noticed, {sums['by_cases']} of them by cases")
        for row in parts[name] if args.part else ():
            if not row["by"] and not row["equal"]:
                tqdm.write(f"  {row['path']}:{row['line']}: {row['what']}")
    wrong = [words for rows in parts.values() for words in contradictions(rows)]
    tqdm.write("\n".join(wrong), end="\n" * bool(wrong))
    if not args.part:
        content = {"parts": {name: {**total(rows), "rows": rows} for name, rows in parts.items()}, "seed": args.seed}
        write_report(args.out.with_suffix(".json"), content, [__name__, play.WORKER], args)
        page.write_page(args.out, pages(parts, args.seed))
    return int(bool(wrong))
