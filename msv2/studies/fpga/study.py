"""What every unit takes on FPGAs of the families ECP5 and 7-series, by Yosys: reports/fpga.json and the tables of docs/fpga.md.

    msv2 study run fpga                     every unit of the machines `tiny` and `paper`, one after the other
    msv2 study run fpga --unit axi_master   only the rows of this unit; the other rows stay
    msv2 study run fpga --minutes 10        stop after 10 minutes; the report names the units that were not reached
    msv2 study run fpga --machine all       only the machine `fpga` as a whole: what `msv2 fpga` builds (msv2.fpga)
    msv2 study run fpga --machine unrouted  the same without placing and routing
    msv2 study run fpga --check             only says whether the page differs from the report

A unit is synthesised alone, as one flat netlist, in a process of its own with limits of time and memory. Where a limit is
met, the report says so in place of the numbers. Only the machine `fpga` can be placed and routed, and then has a clock rate.

What was synthesised is kept in build/fpga under a hash of the unit's netlist before synthesis: a study that was interrupted
goes on where it was, and after a change of the RTL only the changed units are synthesised.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from golden.scenes.files import read_json
from golden.scenes.request import make_folder, write_json
from msv2.studies import page
from msv2.studies.fpga import machine
from msv2.studies.fpga.measure import COMMANDS, CPU_SECONDS, FAMILIES, MEMORY_GB
from msv2.studies.record import write_report
from rtl.emit import to_rtlil
from rtl.units import TOP, UNITS, stage_of
from spec.command_line import choice, command_parser
from spec.config import CONFIGS, FPGA, PAPER, TINY
from spec.errors import InputError
from spec.extras import how_to_get
from spec.paths import BUILD, DOCS, REPORTS, ROOT
from synth import flow

PAGE, REPORT = DOCS / "fpga.md", REPORTS / "fpga.json"

MACHINES = (TINY, PAPER)

MEASURE = "msv2.studies.fpga.measure"

SKIPPED = {
    ("tiny", TOP): "it is all other units in one flat netlist; add up the units",
    ("paper", TOP): "it is all other units in one flat netlist; add up the units",
    ("tiny", "vrc_array"): "it is four `vrc_row` with `setup`, `expand`, `block_sequencer`, `collect` and `blend`; add them up",
    ("paper", "vrc_array"): "it is sixteen `vrc_row` with `setup`, `expand`, `collect` and `blend`; add them up",
    ("tiny", "batch_array"): "it is `vrc_array`, whose cores can load their pixels' state, with memories for a super-tile",
    ("paper", "batch_array"): "it is `vrc_array`, whose cores can load their pixels' state, with memories for a super-tile",
    **{(machine, unit): text for machine in ("tiny", "paper") for unit, text in (
        ("stream_buffer", "it is `batch_buffer` with four sets of masks and dealers, and records in banks"),
        ("stream_arrays", "it is `stream_buffer` with four `batch_array` of a quarter of the cores"))},
}
"""Units that are not tried, by configuration, and why."""

LIMITED = f"it needs more than {CPU_SECONDS} s of processor time or {MEMORY_GB} GB of memory"
"""What the report says of a unit whose process met a limit."""

NOT_REACHED = "it was not reached in the time that the study was given; the study goes on here when it is run again"

_LOST = re.compile(r"bad_alloc|MemoryError|CPU time limit|status code 137|return code 9")
"""What a process says that has met a limit, or whose ABC, a process below it, has."""

Row = dict[str, object]


def synthesised(unit: str, config: str, family: str, folder: Path, until: float = math.inf) -> dict[str, object]:
    """What a unit takes on a family: the columns of `measure` and the cells by type, or `left_out` with the reason.

    Args:
        unit, config, family: what is synthesised.
        folder: where Yosys' log goes.
        until: when to give up, as of `time.monotonic`.

    Raises:
        ValueError: the netlist has a type of cell that no column counts.
    """
    left = until - time.monotonic()
    if left <= 0:
        return {"left_out": NOT_REACHED}
    process = subprocess.Popen(
        [sys.executable, "-m", MEASURE, unit, config, family, str(folder)], cwd=ROOT, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        out, errors = process.communicate(timeout=None if math.isinf(left) else left)
    except subprocess.TimeoutExpired:
        return {"left_out": NOT_REACHED}
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)  # ABC, too, which is a process below
            process.wait()
    if process.returncode == 0:
        cells = json.loads(out)
        return {**FAMILIES[family].count(cells), "cells": cells}
    return {"left_out": failure(process.returncode, out + errors)}


def failure(status: int, said: str) -> str:
    """Why a process gave no numbers: a limit, which also a signal tells, or the last line that it said."""
    if status < 0 or _LOST.search(said):
        return LIMITED
    return f"the synthesis fails: {(said.strip().splitlines() or ['it says nothing'])[-1]}"


def kept(unit: str, config: str, family: str, digest: str, folder: Path, until: float = math.inf) -> dict[str, object]:
    """`synthesised`, or what the folder keeps of the same netlist, commands, limits and version of Yosys."""
    settled = {"netlist": digest, "commands": list(COMMANDS), "family": FAMILIES[family].command, "yosys": flow.version(),
               "limits": [CPU_SECONDS, MEMORY_GB]}
    path = folder / f"{unit}-{digest}-{family}.json"
    if path.is_file() and (old := read_json(path))["settings"] == settled:
        found = old["found"]
        return found if "left_out" in found else {**FAMILIES[family].count(found["cells"]), "cells": found["cells"]}
    found = synthesised(unit, config, family, folder, until)
    if found.get("left_out") != NOT_REACHED:
        write_json(path, {"settings": settled, "found": found})
    return found


def wanted(units: Sequence[str]) -> list[tuple[str, str, str]]:
    """Configuration, unit and a hash of the unit's netlist before synthesis, smallest netlist first."""
    found = []
    for config in MACHINES:
        for unit in units:
            text = "" if (config.name, unit) in SKIPPED else to_rtlil(UNITS[unit].make(config), unit)
            found.append((len(text), config.name, unit, hashlib.sha256(text.encode()).hexdigest()[:16]))
    return [(config, unit, digest) for _, config, unit, digest in sorted(found, key=lambda one: (one[0], one[1] != TINY.name))]


def measure(units: Sequence[str], folder: Path, until: float = math.inf) -> list[Row]:
    """The rows of these units in both machines. A unit that is the same in both is synthesised once. `folder` keeps what is
    found."""
    rows: list[Row] = []
    known: dict[tuple[str, str], Row] = {}
    for config, unit, digest in wanted(units):
        skipped, same = SKIPPED.get((config, unit)), known.get((unit, digest))
        row: Row = {"unit": unit, "config": config, "stage": stage_of(unit), "netlist": digest}
        for family in FAMILIES:
            if skipped:
                row[family] = {"left_out": skipped}
            else:
                row[family] = same[family] if same else kept(unit, config, family, digest, folder, until)
        if same and not skipped:
            row["same_as"] = same["config"]
        known[unit, digest] = row
        rows.append(row)
        print(f"{config} {unit}: " + ", ".join(f"{family} {_brief(row[family])}" for family in FAMILIES), flush=True)
    return rows


def _brief(numbers: object) -> str:
    kept = {key: value for key, value in dict(numbers).items() if key != "cells"}
    return " ".join(f"{key} {value}" for key, value in kept.items())


def in_order(rows: Sequence[Row]) -> list[Row]:
    """The rows by machine, each in the order of `rtl.units`."""
    order, machines = list(UNITS), [config.name for config in MACHINES]
    return sorted(rows, key=lambda row: (machines.index(str(row["config"])), order.index(str(row["unit"]))))


def table(rows: Sequence[Row], config: str) -> str:
    """The table of one machine in Markdown. Units that are the same in an earlier machine are left to its table."""
    head = ["unit"]
    for family in FAMILIES.values():
        head += [f"{family.title} LUT", "as memory", "FF", "RAM", "DSP"]
    cells = []
    for row in rows:
        if row["config"] != config or "same_as" in row:
            continue
        found = [row[family] for family in FAMILIES]
        if all("left_out" in one for one in found):
            continue
        cells.append([f"`{row['unit']}`", *(text for one in found for text in _columns(one))])
    return page.table(head, cells, left=1)


def _columns(numbers: dict) -> list[str]:
    if "left_out" in numbers:
        return ["left out", "-", "-", "-", "-"]
    return [f"{numbers[name]:,}" for name in ("lut", "lut_ram", "ff", "bram", "dsp")]


def left_out(rows: Sequence[Row]) -> str:
    """The units without numbers by machine, family and reason, in Markdown."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        reasons = {family.title: row[name]["left_out"] for name, family in FAMILIES.items() if "left_out" in row[name]}
        if len(reasons) == len(FAMILIES) and len(set(reasons.values())) == 1:
            reasons = {"both": next(iter(reasons.values()))}
        for family, reason in reasons.items():
            found.setdefault((str(row["config"]), family, reason), []).append(f"`{row['unit']}`")
    cells = [[config, family, ", ".join(units), reason] for (config, family, reason), units in found.items()]
    return page.table(["machine", "family", "units", "why"], cells, empty="No unit is left out.")


def fill(*, check: bool = False) -> int:
    """Writes the tables into docs/fpga.md. With `check` it changes nothing and returns 1 where the page would change."""
    report = read_json(REPORT)
    rows = report["rows"]
    tables = {f"fpga_{config.name}": lambda name=config.name: table(rows, name) for config in MACHINES}
    return page.fill(PAGE, tables | {"fpga_left_out": lambda: left_out(rows), "fpga_machine": lambda: machine.table(report)},
                     check=check, complete=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Measures, writes the report and fills the page."""
    parser = command_parser("msv2 study run fpga", __doc__)
    parser.add_argument("--unit", action="append", metavar="UNIT", help="only this unit; may be given several times")
    parser.add_argument("--minutes", type=float, default=math.inf, metavar="N", help="stop after N minutes (default: no limit)")
    parser.add_argument("--machine", metavar="PART", help="only the machine `fpga` as a whole: all, or unrouted")
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 where the page is stale")
    args = parser.parse_args(argv)
    if args.check:
        return fill(check=True)
    if not args.minutes > 0:
        raise InputError(f"minutes {args.minutes:g} is not accepted: more than 0 is")
    if flow.libyosys is None:
        raise InputError(f"the study needs pyosys, which is not installed; {how_to_get('pyosys')}")
    units = [choice("unit", name, UNITS) for name in args.unit or UNITS]
    before = read_json(REPORT) if REPORT.exists() else None
    if args.machine:
        found = machine.measured(make_folder(BUILD / "fpga"), choice("part", args.machine, ("all", "unrouted")))
        units_only = {key: value for key, value in (before or {"rows": []}).items() if key not in machine.FIELDS}
        write_report(REPORT, units_only | found, [__name__, MEASURE, *machine.MODULES],
                     {"units": units, "machines": [FPGA]}, earlier=before)
        return fill()
    old = before if args.unit else None
    until = time.monotonic() + 60 * args.minutes
    measured = measure(units, make_folder(BUILD / "fpga"), until)
    others = [row for row in (old or {"rows": []})["rows"] if row["unit"] not in units]
    write_report(REPORT, {"yosys": flow.version(), "limits": {"cpu_seconds": CPU_SECONDS, "memory_gb": MEMORY_GB},
                          "rows": in_order([*others, *measured]), **machine.kept(before)}, [__name__, MEASURE],
                 {"units": units, "machines": [CONFIGS[config.name] for config in MACHINES]}, earlier=old)
    return fill()
