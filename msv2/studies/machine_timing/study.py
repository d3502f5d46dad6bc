"""Machines timed as one: writes reports/machine_timing.json, .md, and the stored ports' times, reports/machine_budget.json.

    msv2 study run machine_timing               `paper` and `v3`, with one eye and two, at the typical and the slow corner
    msv2 study run machine_timing --configs v3  one of them; the numbers of the other stay as they are
    msv2 study run machine_timing --ports       the budget rule alone: only modules that have changed are mapped and measured

All mapped modules are linked (`synth.linked`). Each machine's modules are those of its area report: build/synth keeps them.
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from msv2.studies.destination import newest
from msv2.studies.machine_timing.page import page
from msv2.studies.page import write_page
from msv2.studies.record import commit, liberties, write_report
from spec.command_line import command_parser
from spec.config import MACHINES
from spec.errors import InputError
from spec.paths import REPORTS, ROOT
from synth.budget import graph, late
from synth.corners import CORNERS, HOLD_UNCERTAINTY_PS, INPUT_SLEW_PS, SLEW_LIMIT_PS, UNCERTAINTY
from synth.machine import TOP
from synth.settings import MOST_RUNS
from synth.whole import STORE, Budget, WholeTiming, budgets, stored, time_config, time_ports
from synth.whole_report import summary

TIMED = ("paper", "paper_eyes", "v3", "v3_eyes_warp")
"""The machines of the report: one eye, and two."""

CLOCK_PS = 1000.0

WORST = ("slack_ps", "late_endpoints", "ghz")
"""Numbers of which the worst machine's are repeated at the top of the report, by corner."""


def machine_row(found: WholeTiming, stamp: str, runs: int) -> dict[str, object]:
    """A machine's part of the report: the linked runs, and what the budget rule says at the typical corner."""
    return {"commit": stamp, "runs": runs, **summary(found), "budget": late_rows(found)}


def with_ports(row: Mapping[str, object], found: WholeTiming, stamp: str, runs: int) -> dict[str, object]:
    """A machine's part of the report with what the budget rule says today, where only the ports of some modules were measured.

    `budget_commit` is the commit at which all stored times are of the machine's RTL, and `budget_modules` the number of modules
    that were measured with at most `budget_runs` runs since the linked run.
    """
    before = row.get("budget_modules", 0)
    return {**row, "budget": late_rows(found), "budget_commit": stamp, "budget_modules": before + found.measured,
            "budget_runs": runs if found.measured else row.get("budget_runs", 0)}


def late_rows(found: WholeTiming) -> list[dict[str, object]]:
    """What the budget rule says of a machine at the typical corner: the pairs of units that are late, the worst first."""
    return [{"start": pair.start, "end": pair.end, "excess_ps": pair.excess_ps, "inputs": pair.inputs, "way": list(pair.way)}
            for pair in late(graph(found.interfaces, TOP, CLOCK_PS), CLOCK_PS, UNCERTAINTY)]


def worst(machines: Mapping[str, Mapping]) -> dict[str, dict[str, object]]:
    """By corner: the worst slack, the most late endpoints and the slowest clock of all machines."""
    by = {"slack_ps": min, "late_endpoints": max, "ghz": min}
    return {corner: {key: by[key](machine[corner][key] for machine in machines.values()) for key in WORST}
            for corner in CORNERS}


def merged(new: Mapping[str, object], old: Mapping[str, object]) -> dict[str, object]:
    """Stored interfaces with those of machines that were not measured now; such of no machine are left out."""
    machines = {**old.get("machines", {}), **new["machines"]}
    wanted = {f"{module} {source}" for machine in machines.values() for module, source in machine["modules"].items()}
    interfaces = {**old.get("interfaces", {}), **new["interfaces"]}
    return {**new, "machines": {name: machines[name] for name in sorted(machines)},
            "interfaces": {key: interfaces[key] for key in sorted(wanted)}}


def _budget(name: str) -> Budget:
    """The stored interfaces of a machine; InputError where there are none."""
    kept = budgets()
    if name not in kept:
        raise InputError(f"ports are measured again only where they were once: {name} is not in {STORE.name}")
    return kept[name]


def _linked_before(rows: Mapping[str, dict], name: str) -> dict:
    """The machine's row of the report; InputError where there is none."""
    if name not in rows:
        raise InputError(f"ports need a report with a linked run: {name} is not in machine_timing.json of the folder `--out`")
    return rows[name]


def _read(path: Path) -> dict:
    return json.loads(path.read_text()) if path.is_file() else {}


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line, times the machines, and writes the reports; returns the exit status."""
    parser = command_parser("msv2 study run machine_timing", __doc__.splitlines()[0])
    parser.add_argument("--configs", nargs="+", default=list(TIMED), metavar="CONFIG",
                        help=f"machines to time, among {', '.join(TIMED)} (default: all)")
    parser.add_argument("--jobs", type=int, default=2, help="modules synthesised at a time (default: 2)")
    parser.add_argument("--runs", type=int, default=MOST_RUNS, help=f"most runs of a module (default: {MOST_RUNS})")
    parser.add_argument("--ports", action="store_true",
                        help="measure the ports of modules that have changed, and link nothing")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "synth",
                        help="folder of synthesis results (default: build/synth)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="folder of the report (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    unknown = set(args.configs) - set(TIMED)
    if unknown:
        raise InputError(f"configs {', '.join(sorted(unknown))} are not known: {', '.join(TIMED)} are")
    old, kept = _read(args.out / "machine_timing.json"), _read(args.out / STORE.name)
    rows, measured, stamp = dict(old.get("machines", {})), [], commit()
    for name in args.configs:
        if args.ports:
            found = time_ports(MACHINES[name], _budget(name), args.folder, args.jobs, _say, args.runs)
            rows[name] = with_ports(_linked_before(rows, name), found, stamp, args.runs)
        else:
            found = time_config(MACHINES[name], args.folder, args.jobs, _say, args.runs, clock_ps=CLOCK_PS, interfaces=True)
            rows[name] = machine_row(found, stamp, args.runs)
        measured.append(found)
        _write(args, {name: rows[name] for name in TIMED if name in rows}, measured, old, kept)
    return 0


def _write(args: Namespace, rows: Mapping[str, dict], measured: Sequence[WholeTiming], old: dict, kept: dict) -> None:
    """Writes the reports with the machines that are measured so far, and those of an earlier report."""
    report = {
        **worst(rows), "clock_ps": CLOCK_PS, "uncertainty": UNCERTAINTY, "hold_uncertainty_ps": HOLD_UNCERTAINTY_PS,
        "input_slew_ps": INPUT_SLEW_PS, "slew_limit_ps": SLEW_LIMIT_PS,
        "corners": {name: {"node": corner.technology.node, "memory_factor": round(corner.memory_factor, 4),
                           "memory_source": corner.source} for name, corner in CORNERS.items()},
        "machines": rows}
    used = {"arguments": args, "machines": {name: MACHINES[name] for name in args.configs}}
    earlier = args.ports or len(rows) > len(measured)
    path, store = args.out / "machine_timing.json", args.out / STORE.name
    write_report(path, report, [__name__], used, liberties(), old if earlier else None)
    write_report(store, merged(stored(measured, CLOCK_PS, UNCERTAINTY), kept), [__name__], used, liberties(),
                 kept if earlier else None)
    write_page(args.out / "machine_timing.md", page(report))
    print(f"wrote {newest(path)}, machine_timing.md and {STORE.name}")


def _say(line: str) -> None:
    print(line, flush=True)


