"""`python -m msv2.cases`: runs the hard cases on the oracle, the integer renderer, the differentiable renderer and the
machine."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from tqdm import tqdm

from msv2.cases import golden_faults, rtl, rtl_faults, streams
from msv2.cases.case import COLUMNS, Case
from msv2.cases.check import Cell, cell
from msv2.cases.fuzz import command as fuzz
from msv2.cases.registry import CASES as SHOT_CASES
from msv2.cases.report import FaultRow, Result, Row, added, read_record, table, write
from msv2.cases.soak import command as soak
from msv2.cases.streams import MachineCase
from spec.command_line import add_out_argument, choice, command_parser
from spec.errors import InputError
from spec.paths import ROOT
from spec.private import output_folder

CASES: tuple[Case, ...] = tuple(sorted((*SHOT_CASES, *streams.CASES), key=lambda case: case.id))
"""The cases that renderers run, and those of the machine alone."""

COMMANDS = {"fuzz": fuzz.main, "soak": soak.main}
"""Commands of their own, by the first word of the command line."""

GRADIENTS = "msv2.cases.gradients"
"""The module that runs the differentiable renderer, in a process of its own, so that this process needs no torch."""

EPILOG = """\
Writes stability.json; the study `stability` makes a page and a picture of it. The exit status is 1 if a case fails or a seeded
fault is not caught.

examples:
  %(prog)s                                     everything
  %(prog)s --columns oracle,golden --no-faults    in a minute, without a simulator
  %(prog)s --case 06-needle-at-the-frustum     one case in all columns
  %(prog)s --columns rtl --add                 the machine; earlier results of other columns are kept
  %(prog)s fuzz --help                         spoilt files of every format that the project reads
  %(prog)s soak --help                         random frames on the machine, for as long as wanted
"""


class Gradients:
    """Runs the differentiable renderer's cases and faults in parallel to the others; without torch all its cells say so."""

    def __init__(self, cases: Sequence[Case], with_faults: bool, folder: Path):
        self._cases, self._path, self._process = cases, folder / "gradients.json", None
        if find_spec("torch") is not None:
            folder.mkdir(parents=True, exist_ok=True)
            command = [sys.executable, "-m", GRADIENTS, *(case.id for case in cases), "--json", str(self._path.resolve())]
            self._process = subprocess.Popen([*command, *["--faults"] * with_faults], cwd=ROOT)

    def result(self) -> tuple[dict[str, Cell], list[FaultRow]]:
        """Waits for the process; returns the cells and faults. Raises RuntimeError where the process failed."""
        if self._process is None:
            return {case.id: Cell("-", words="torch is not installed") for case in self._cases}, []
        if self._process.wait():
            raise RuntimeError(f"{GRADIENTS} ended with {self._process.returncode}")
        found = json.loads(self._path.read_text())
        return ({name: Cell(**values) for name, values in found["cells"].items()},
                [FaultRow(**fault) for fault in found["faults"]])


def machine(cases: Sequence[Case], folder: Path) -> dict[str, Cell]:
    """The machine's cells."""
    plans = {case.id: {"one eye": case.frames()} if isinstance(case, MachineCase) else rtl.frames_of(case) for case in cases}
    played = rtl.check({case: frames for case, frames in plans.items() if frames}, folder, progress=True)
    for case in cases:
        if isinstance(case, MachineCase) and case.unit is not None and played[case.id].outcome == "pass":
            played[case.id] = streams.unit_cell(case, folder)
    return {case.id: played.get(case.id) or Cell("-", words=case.absent.get("rtl", "no part in it")) for case in cases}


def run(cases: Sequence[Case], columns: Sequence[str], with_faults: bool, folder: Path) -> Result:
    """Runs the chosen cases and faults in the chosen columns."""
    begin = time.perf_counter()
    by_column: dict[str, dict[str, Cell]] = {}
    faults: list[FaultRow] = []
    shown = [case for case in cases if not isinstance(case, MachineCase)]
    trained = Gradients(shown, with_faults, folder) if "gradient" in columns else None
    for column in ("oracle", "golden"):
        if column in columns:
            by_column[column] = {case.id: cell(case, column) for case in tqdm(cases, desc=column)}
            if with_faults:
                dropped = [fault for fault in golden_faults.FAULTS if fault.column == column]
                faults += [FaultRow(fault.name, column, fault.case, *golden_faults.caught(fault))
                           for fault in tqdm(dropped, desc=f"{column}, faults")]
    if "rtl" in columns:
        by_column["rtl"] = machine(cases, folder / "frames")
        if with_faults:
            caught = rtl_faults.caught(folder / "faults")
            faults += [FaultRow(fault.name, "rtl", fault.case, *caught[fault.name]) for fault in rtl_faults.FAULTS]
    if trained is not None:
        by_column["gradient"], more = trained.result()
        by_column["gradient"] |= {case.id: Cell("-", words=case.absent["gradient"]) for case in cases if case not in shown}
        faults += more
    rows = [Row(case, {name: cells[case.id] for name, cells in by_column.items()}) for case in cases]
    return Result(rows, faults, time.perf_counter() - begin)


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("python -m msv2.cases", __doc__, EPILOG)
    parser.add_argument("--case", action="append", metavar="CASE", help="run only this case, by id or name; can be repeated")
    parser.add_argument("--columns", default=",".join(COLUMNS),
                        help="columns among oracle, golden, gradient, rtl (default: all)")
    parser.add_argument("--no-faults", action="store_true", help="leave the seeded faults out")
    add_out_argument(parser, "build/stability")
    parser.add_argument("--add", action="store_true",
                        help="add to the results in the output folder; those not run now are kept")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 where a case fails or a fault is not caught. With one of COMMANDS first, runs that."""
    argv = sys.argv[1:] if argv is None else argv
    if argv and argv[0] in COMMANDS:
        return COMMANDS[argv[0]](argv[1:])
    args = _arguments(argv)
    columns = args.columns.split(",")
    unknown = [name for name in columns if name not in COLUMNS]
    if unknown:
        raise InputError(f"columns {', '.join(unknown)} are not accepted: choose of {', '.join(COLUMNS)}")
    names = {name: case for case in CASES for name in (case.name, case.id)}
    for name in args.case or ():
        if name not in names:
            choice("case", name, [case.id for case in CASES])
    chosen = [case for case in CASES if not args.case or {case.name, case.id} & set(args.case)]
    default = Path("build/stability")
    with output_folder(args.out or (default if args.add else None), default) as out:  # --add means one certain folder
        result = run(chosen, columns, not (args.no_faults or args.case), out)
        if args.add:
            result = added(CASES, read_record(out), result)
        print("\n".join(table(result)))
        write(result, out)
    return int(result.failed + result.missed > 0)
