"""`msv2 cases fuzz`: spoils files of every format that the project reads, and loads them within limits of time and memory. A
file must be loaded, or refused with an error that says what is wrong with it; anything else is a failure.

A case is a format, a seed and a number, and always the same. Case 0 of a format is a good file. The files of a failed case are
left in the output folder, beside fuzz.json.

examples:
  msv2 cases fuzz                               2,000 cases
  msv2 cases fuzz --cases 1000000 --seed 7 --resume
  msv2 cases fuzz --format spz --case 1234      one case, with its files
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from golden.scenes.files import atomic_output, read_json
from msv2.cases.fuzz import runs
from msv2.cases.fuzz.samples import FORMATS
from msv2.cases.fuzz.worker import OUTCOMES, case_files, write_files
from spec.command_line import add_out_argument, choice, command_parser
from spec.errors import InputError
from spec.private import output_folder

RECORD = "fuzz.json"
"""What a run leaves in its output folder."""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 cases fuzz", __doc__)
    parser.add_argument("--cases", type=int, default=2000, metavar="N", help="number of cases of all formats (default: 2000)")
    parser.add_argument("--seed", type=int, default=1, help="selects the cases (default: 1)")
    parser.add_argument("--format", action="append", default=[], metavar="NAME",
                        help=f"only this format; can be repeated (of {', '.join(FORMATS)})")
    parser.add_argument("--case", type=int, metavar="N", help="run this case alone; needs one --format")
    parser.add_argument("--resume", action="store_true",
                        help="go on where a run of the same seed in the output folder ended, with whatever --cases it had")
    parser.add_argument("--seconds", type=float, default=runs.SECONDS, help="limit of a case (default: %(default)g)")
    add_out_argument(parser, "build/fuzz")
    args = parser.parse_args(argv)
    for name in args.format:
        choice("format", name, FORMATS)
    if args.cases < 1 or args.seed < 0 or not args.seconds > 0:
        raise InputError(f"--cases {args.cases} --seed {args.seed} --seconds {args.seconds:g} is not accepted: a number of "
                         "cases from 1 on, a seed from 0 on, and positive seconds are")
    if args.case is not None and (len(args.format) != 1 or args.case < 0):
        raise InputError(f"--case {args.case} is not accepted with {len(args.format)} formats: a number from 0 on and one "
                         "--format are")
    return args


def fuzz(
    names: Sequence[str], cases: int, seed: int, out: Path, seconds: float = runs.SECONDS, resume: bool = False,
) -> dict[str, Any]:
    """Runs cases, writes the files of failed ones, and returns the record, JSON-ready, which is also kept in the folder while
    they run. `resume` goes on from the record in the folder.

    Raises:
        InputError: the record in the folder is of another seed, or is none.
    """
    absent = {name: packages for name in names if (packages := runs.missing(name))}
    counts = runs.shares([name for name in names if name not in absent], cases)
    found = _earlier(out / RECORD, seed) if resume else {}
    before = sum(min(found[name].cases, count) for name, count in counts.items() if name in found)
    record = _record(found, seed, absent)
    with tqdm(total=sum(counts.values()), initial=before, desc="fuzz", mininterval=1) as bar:
        for name, tally in runs.run_cases(counts, seed, seconds=seconds, tick=bar.update, before=found):
            found[name] = tally
            record = _record(found, seed, absent)
            _write(out / RECORD, record)
            for failure in tally.failures:
                keep(name, seed, failure["index"], out)
    return record


def _earlier(path: Path, seed: int) -> dict[str, runs.Tally]:
    """What the cases of each format did by the record of an earlier run; nothing where there is none."""
    if not path.exists():
        return {}
    record = read_json(path)
    try:
        found = {name: runs.Tally({key: row[key] for key in OUTCOMES}, row["failures"], row["seconds"], row["slowest_seconds"])
                 for name, row in record["formats"].items()}
        before = record["seed"]
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{path} is no record of a run of the fuzzer ({error!r}): give another --out") from error
    if before != seed:
        raise InputError(f"{path} is a record of seed {before}, not {seed}: give the same, or another --out")
    return found


def _record(found: Mapping[str, runs.Tally], seed: int, absent: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    rows = {name: {"cases": tally.cases, **tally.outcomes, "failures": tally.failures, "seconds": tally.seconds,
                   "slowest_seconds": tally.slowest} for name, tally in found.items()}
    total = {key: sum(row[key] for row in rows.values()) for key in ("cases", *OUTCOMES[:2])}
    return {"seed": seed, **total, "failures": sum(len(row["failures"]) for row in rows.values()), "formats": rows,
            "not_installed": dict(absent)}


def _write(path: Path, record: Mapping[str, Any]) -> None:
    with atomic_output(path) as file:
        file.write((json.dumps(record, indent=1) + "\n").encode())


def keep(name: str, seed: int, index: int, out: Path) -> Path:
    """Writes the files of a case into a folder of its own, which is returned."""
    folder = out / f"{name}-{seed}-{index}"
    write_files(case_files(name, seed, index), folder)
    return folder


def _one_case(args: argparse.Namespace, out: Path) -> int:
    (name,) = args.format
    with runs.Worker(args.seconds) as worker:
        answer = worker.run(name, args.seed, args.case)
    print(f"{keep(name, args.seed, args.case, out)}: {answer['outcome']}")
    print(answer.get("trace") or answer.get("what", ""))
    return int(answer["outcome"] == runs.FAILED)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 where a case fails."""
    args = _arguments(argv)
    with output_folder(args.out, Path("build/fuzz")) as out:
        if args.case is not None:
            return _one_case(args, out)
        record = fuzz(args.format or list(FORMATS), args.cases, args.seed, out, args.seconds, args.resume)
        for name, row in record["formats"].items():
            print(f"{name}: {row['cases']:,} cases, {row['accepted']:,} accepted, {row['refused']:,} refused, "
                  f"{len(row['failures'])} failed, slowest {row['slowest_seconds']:.2f} s")
            for place in sorted({f"{failure['where']}: {failure['what']}" for failure in row["failures"]})[:10]:
                print(f"  {place}")
        for name, packages in record["not_installed"].items():
            print(f"{name}: left out, needs {', '.join(packages)}")
    return int(record["failures"] > 0)
