"""`msv2 study run trust`: what speaks for the RTL in one table: proofs, mutants, coverage, seeded faults, spoilt files, frames.

Proofs, mutants, coverage and seeded faults come from the kept reports of their studies. Spoilt files and random frames are
played here: as many cases as are asked for, and frames until the soak in build/trust/soak has so many cycles; both go on where
they ended. The exit status is 1 if a file or a frame fails.

examples:
  msv2 study run trust
  msv2 study run trust --cases 20000 --cycles 1e6
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from golden.scenes.files import read_json
from golden.scenes.request import make_folder
from msv2.cases.fuzz.command import RECORD, fuzz
from msv2.cases.fuzz.samples import FORMATS
from msv2.cases.soak.runs import MACHINES, Soak
from msv2.studies.kept import fingerprint
from msv2.studies.page import table, write_page
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.record import PROVENANCE, write_report
from spec.command_line import command_parser
from spec.errors import InputError
from spec.paths import BUILD, REPORTS

FOLDER = BUILD / "trust"

SEED = 20

SOURCES = ("mutants", "coverage", "formal", "stability")
"""The reports that are read."""

SOURCE_MUTANTS = "source_mutants"
"""One that is read if it is there: it takes hours."""

HEAD = """# What speaks for the RTL

Written by `msv2 study run trust`. Each line is the result of a command, with the date on which it was run. What a proof, a
mutant, a seeded fault and a soak are is told in [docs/stability.md](../docs/stability.md) and
[docs/formal.md](../docs/formal.md).
"""


def _read(name: str) -> tuple[dict[str, Any], dict[str, str]]:
    """A kept report, and the command and the date of it."""
    path = REPORTS / f"{name}.json"
    if not path.exists():
        raise InputError(f"{path} is missing: `msv2 study run {name} --keep` writes it")
    report = read_json(path)
    return report, {key: report[PROVENANCE][key] for key in ("command", "date")}


def mutants() -> dict[str, Any]:
    """The mutants, in all and by unit."""
    report, made = _read("mutants")
    units = {row["unit"]: {"judged": row["drawn"] - row["equal"], "killed": row["killed"]} for row in report["rows"]}
    return {**{key: report[key] for key in ("drawn", "equal", "judged", "killed", "share", "missing")}, **made, "units": units}


def source_mutants() -> dict[str, Any]:
    """The mutants of Python, by part."""
    report, made = _read(SOURCE_MUTANTS)
    parts = {name: {key: value for key, value in part.items() if key != "rows"} for name, part in report["parts"].items()}
    keys = ("mutants", "judged", "by_cases", "by_tests", "no_end", "noticed")
    sums = {key: sum(part[key] for part in parts.values()) for key in keys}
    return {**sums, **made, "units": parts}


def coverage() -> dict[str, Any]:
    """Bits that change and ways that are taken in the quick suites, in all and by unit."""
    report, made = _read("coverage")
    keys = ("bits", "covered", "ways", "taken", "lines", "whole")
    return {**{key: report[key] for key in keys}, **made,
            "units": {row["unit"]: {key: row[key] for key in keys} for row in report["rows"]}}


def formal() -> dict[str, Any]:
    """The claims, in all and by component."""
    report, made = _read("formal")
    units: dict[str, Counter[str]] = {}
    for row in report["rows"]:
        units.setdefault(row["unit"], Counter()).update(claim["result"] for claim in row["claims"])
    return {**{key: report[key] for key in ("proven", "open", "fails", "empty")}, **made,
            "units": {unit: dict(sorted(counts.items())) for unit, counts in units.items()}}


def faults() -> dict[str, Any]:
    """The seeded faults, in all and by renderer."""
    report, made = _read("stability")
    by = Counter((fault["column"], bool(fault["caught"])) for fault in report["faults"])
    columns = {column: {"faults": by[column, True] + by[column, False], "caught": by[column, True]} for column, _ in by}
    return {"seeded": len(report["faults"]), "caught": report["seeded_faults_caught"], **made, "units": columns}


def fuzzed(cases: int, seed: int = SEED) -> dict[str, Any]:
    """Spoilt files, in all and by format. It goes on from the cases that were run with the code as it is."""
    folder = FOLDER / f"fuzz-{fingerprint(['msv2.cases.fuzz.worker', 'msv2.cases.fuzz.command'], seed)}"
    found = fuzz(list(FORMATS), cases, seed, make_folder(folder), resume=True)
    formats = {name: {"cases": row["cases"], "failures": len(row["failures"])} for name, row in found["formats"].items()}
    return {**{key: found[key] for key in ("cases", "accepted", "refused", "failures")},
            "command": f"msv2 cases fuzz --cases {cases} --seed {seed}", "date": _written(folder / RECORD), "units": formats}


def soaked(cycles: int, seed: int = SEED) -> dict[str, Any]:
    """Random frames, in all and by machine."""
    soak = Soak(FOLDER / "soak", seed, list(MACHINES))
    soak.run(cycles)
    count = soak.count
    return {"cycles": count["cycles"], "frames": count["frames"], "differences": len(count["differences"]),
            "command": f"msv2 cases soak --cycles {cycles} --seed {seed}", "date": _written(soak.file), "ends": count["by_end"],
            "units": count["by_machine"]}


def _written(path: Path) -> str:
    """When a file was written."""
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")


def pages(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The page of the report."""
    mutant, seen, claim, fault, file, frame = (
        found[name] for name in ("mutants", "coverage", "formal", "faults", "fuzz", "soak"))
    source = found.get(SOURCE_MUTANTS, {"units": {}})
    lines = [
        ("mutants of units that the quick suites kill",
         f"{mutant['killed']} of {mutant['judged']} ({100 * mutant['share']:.1f} %); goal 95 %", mutant),
        *((f"mutants of Python in {name} that cases or quick tests notice",
           f"{part['noticed']} of {part['judged']} ({100 * part['share']:.1f} %); goal 95 %", source)
          for name, part in source["units"].items()),
        ("bits of units that rise and fall in the quick suites", _part(seen["covered"], seen["bits"]), seen),
        ("values of selects and cases that the quick suites take", _part(seen["taken"], seen["ways"]), seen),
        ("claims proven for all inputs",
         f"{claim['proven']}; {claim['open']} open, {claim['fails'] + claim['empty']} fail", claim),
        ("seeded faults caught", f"{fault['caught']} of {fault['seeded']}", fault),
        ("spoilt files", f"{file['cases']:,}, {file['failures']} failed", file),
        ("random frames on the RTL",
         f"{frame['frames']:,} in {frame['cycles']:,} cycles, {frame['differences']} different", frame)]
    head = table(["what", "result", "command", "date"],
                 [[what, result, f"`{made['command']}`", made["date"][:10]] for what, result, made in lines])
    units = table(["unit", "mutants", "killed"],
                  [[unit, row["judged"], row["killed"]] for unit, row in mutant["units"].items()], left=1)
    claims = table(["component", "proven", "open"],
                   [[unit, row.get("proven", 0), row.get("open", 0)] for unit, row in claim["units"].items()], left=1)
    frames = table(["machine", "frames", "cycles"],
                   [[name, row["frames"], f"{row['cycles']:,}"] for name, row in frame["units"].items()], left=1)
    ends = ", ".join(f"{number:,} {end}" for end, number in sorted(frame["ends"].items()))
    left = f"\n\nNot judged: {', '.join(mutant['missing'])}." if mutant["missing"] else ""
    return (f"{HEAD}\n{head}\n\n![share of the killed mutants by unit](trust.png)\n\n## Mutants\n\n{units}{left}\n\n"
            f"## Random frames\n\n{frames}\n\nHow the frames ended: {ends}.\n\n## Claims\n\n{claims}")


def _part(part: int, whole: int) -> str:
    return f"{part:,} of {whole:,} ({100 * part / max(whole, 1):.1f} %)"


def picture(found: Mapping[str, Mapping[str, Any]], path: Path) -> bool:
    """Draws the share of the killed mutants by unit; False where matplotlib is not installed."""
    pyplot = find_pyplot()
    if pyplot is None:
        return False
    units = found["mutants"]["units"]
    figure, axes = pyplot.subplots(figsize=(7, 0.24 * len(units) + 0.9))
    axes.barh(range(len(units)), [100 * row["killed"] / max(row["judged"], 1) for row in units.values()], color="#4c9f70")
    axes.set_yticks(range(len(units)), [f"{unit} ({row['judged']})" for unit, row in units.items()], fontsize=8)
    axes.invert_yaxis()
    axes.axvline(95, color="#c8402f", linewidth=0.9)
    axes.set_xlim(0, 100)
    axes.set_xlabel("mutants killed, % (line: goal)")
    figure.tight_layout()
    save_figure(figure, path)
    return True


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run trust", __doc__.split(": ", 1)[1])
    parser.add_argument("--cases", type=int, default=2000, metavar="N", help="spoilt files (default: %(default)s)")
    parser.add_argument("--cycles", type=float, default=1e5, metavar="N", help="cycles of the soak (default: %(default)g)")
    parser.add_argument("--out", type=Path, default=REPORTS / "trust.md", metavar="FILE",
                        help="the page; JSON and PNG are beside it (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    if args.cases < 1 or not 1 <= args.cycles < 1e15:
        raise InputError(f"--cases {args.cases} --cycles {args.cycles:g} is not accepted: cases from 1 on, and cycles from 1 "
                         "to 1e15 are")
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes trust.json, the page trust.md and the picture trust.png."""
    args = _arguments(argv)
    sources = [REPORTS / f"{name}.json" for name in (*SOURCES, SOURCE_MUTANTS)]
    found = {"mutants": mutants(), "coverage": coverage(), "formal": formal(), "faults": faults(), "fuzz": fuzzed(args.cases),
             "soak": soaked(round(args.cycles))}
    if sources[-1].exists():
        found[SOURCE_MUTANTS] = source_mutants()
    write_report(args.out.with_suffix(".json"), found, [__name__], args, [path for path in sources if path.exists()])
    write_page(args.out, pages(found))
    picture(found, args.out.with_suffix(".png"))
    for name, row in found.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in row.items() if isinstance(value, int | float)))
    return int(bool(found["fuzz"]["failures"] or found["soak"]["differences"]))
