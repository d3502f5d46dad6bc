"""Synthesise a unit, or all units of a machine, and report area and the timing that OpenSTA finds.

With --machine, all mapped modules of a machine are linked and timed as one; --budget checks the stored numbers of their ports.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from spec.command_line import command_parser
from spec.config import MACHINES, PAPER, AcceleratorConfig
from spec.effects import with_two_eyes
from spec.errors import InputError, run_command_line
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD
from synth import timing, whole_report
from synth.area import AreaReport, machine_area
from synth.corners import CORNERS, UNCERTAINTY
from synth.hints import SYNTHESISED
from synth.liberty import ASAP7
from synth.report import synthesise_unit, write_json
from synth.settings import MOST_RUNS, TECHNOLOGIES, Settings
from synth.whole import time_config

EXAMPLES = """\
examples:
  %(prog)s                                          a pixel core in NAND2 equivalents, without liberty files
  %(prog)s --unit pixel_core --tech asap7 --clock-ps 1000
  %(prog)s --config paper --stereo --tech asap7     all units of a machine
  %(prog)s --machine --config v3 --corner slow      the linked machine at ASAP7's slow corner
  %(prog)s --budget                                 whether the units' stored times add up to one clock; seconds
"""

JOBS = max(1, (os.cpu_count() or 2) // 2)
"""Number of modules synthesised at a time; each takes a core and up to 1 GB of memory."""


def as_line(label: str, result: dict) -> str:
    """The line of the printed table for one unit or variant."""
    if "nand2_equivalents" in result:
        return f"{label:24} {result['nand2_equivalents']:>9,} NAND2 equivalents"
    line = f"{label:24} {result['area_um2']:9.1f} um2 {result['cells']:6,} cells"
    if "area_per_core_um2" in result:
        line += f"  {result['area_per_core_um2']:.1f} um2 a core"
    if result["slack_ps"] is None:
        return line
    return (f"{line}  slack {result['slack_ps']:6.1f} ps at {result['clock_ps']:.0f} ps; zero slack at "
            f"{1e3 / result['zero_slack_ps']:.2f} GHz, {1e3 / result['derated_ps']:.2f} GHz with 15 % for wires")


def machine_lines(report: AreaReport) -> list[str]:
    """The lines of the printed table for a whole machine."""
    unit = "NAND2" if report.technology == "generic" else "um2"
    rows = [("unit", "group", f"logic, {unit}", "cells", "memory bits", "memory, um2", "slack, ps")]
    for row in report.rows:
        rows.append((row.unit, row.group, *(_number(value) for value in (
            row.logic_um2, row.cells, row.memory_bits, row.memory_um2, row.slack_ps))))
    for group, sums in report.groups().items():
        rows.append(("all of", group, *(_number(sums[key]) for key in ("logic_um2", "cells", "memory_bits", "memory_um2")), ""))
    lines = ["{:24} {:26} {:>13} {:>9} {:>12} {:>12} {:>10}".format(*row) for row in rows]
    if report.scales:
        total, logic = report.total_mm2_16nm(), report.total_mm2_16nm(memories=False)
        lines.append(f"at 16 nm: {total:.3f} mm2, {logic:.3f} without memories")
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line, runs the synthesis and prints the results; returns the exit status."""
    parser = command_parser("python -m synth", __doc__, EXAMPLES)
    parser.add_argument("--unit", help=f"unit to synthesise: one of {', '.join(SYNTHESISED)} (default: pixel_core)")
    add_config_arguments(parser, None)
    parser.add_argument("--stereo", action="store_true", help="with --config: include the warp unit")
    parser.add_argument("--tech", default="generic",
                        help=f"one of {', '.join(TECHNOLOGIES)}, or the path of a liberty file (default: generic)")
    parser.add_argument("--clock-ps", type=float, default=1000.0, help="clock period in ps (default: 1000)")
    parser.add_argument("--jobs", type=int, default=JOBS,
                        help=f"with --config: modules synthesised at a time (default: {JOBS})")
    parser.add_argument("--runs", type=int, default=MOST_RUNS,
                        help=f"most runs of a module, each with faster sums; 1: all sums fast at once (default: {MOST_RUNS})")
    parser.add_argument("--out", type=Path, default=BUILD / "synth", metavar="DIR",
                        help="folder for results (default: build/synth)")
    parser.add_argument("--machine", action="store_true",
                        help="link all modules of a machine (default: paper) in ASAP7 and time it as one")
    parser.add_argument("--corner", action="append", metavar="CORNER",
                        help=f"with --machine: {', '.join(CORNERS)}, or a liberty file with ASAP7's cells; may be repeated "
                             "(default: all)")
    parser.add_argument("--uncertainty", type=float, default=UNCERTAINTY,
                        help=f"with --machine: clock uncertainty as a share of the clock (default: {UNCERTAINTY})")
    parser.add_argument("--budget", action="store_true",
                        help="check that the stored times of the units' ports add up to one clock (default: all machines)")
    args = parser.parse_args(argv)
    if args.machine or args.budget:
        return _timing(args)
    if args.corner or args.uncertainty != UNCERTAINTY:
        raise InputError("corner and uncertainty are accepted with machine only: units are synthesised at the typical corner")
    if args.unit and args.config:
        raise InputError(f"one of unit and config is accepted, not {args.unit!r} and {args.config!r}")
    if args.sets and not args.config:
        raise InputError(f"set {args.sets[0]!r} is not accepted without config: units have configurations of their own")
    if args.jobs < 1:
        raise InputError(f"jobs must be at least 1, not {args.jobs!r}")
    written = _machine(args) if args.config else _unit(args)
    if args.tech != "generic" and not timing.available():
        print("no timing: sta is not installed (Debian's package opensta)")
    print(f"wrote {written}")
    return 0


def _unit(args: argparse.Namespace) -> Path:
    unit = args.unit or "pixel_core"
    report = synthesise_unit(unit, args.tech, args.clock_ps, args.out, args.runs)
    print(as_line(unit, report))
    for label, result in report["variants"].items():
        print(as_line(f"  {label}", result))
    return args.out / f"{unit}-{Settings(args.tech, args.clock_ps, args.out).label}.json"


def _timing(args: argparse.Namespace) -> int:
    """The linked machine or the budget rule; returns the exit status."""
    if args.unit or args.tech not in ("generic", ASAP7.name):
        raise InputError("machine and budget are of a whole machine in ASAP7: unit and tech are not accepted with them")
    if not 0 <= args.uncertainty < 1:
        raise InputError(f"uncertainty must be a share of the clock, 0 to 1, not {args.uncertainty!r}")
    if args.budget:
        return whole_report.check_budgets([args.config.lower()] if args.config else [], _say)
    args.config = args.config or PAPER.name
    config = _config(args)
    found = time_config(config, args.out, args.jobs, _say, args.runs, args.corner or tuple(CORNERS), args.clock_ps,
                        args.uncertainty)
    path = args.out / f"machine-{config.name}{'-stereo' if args.stereo else ''}-{args.clock_ps:.0f}.json"
    write_json(path, {"config": config_record(config), **whole_report.summary(found)})
    print("\n".join(whole_report.lines(found)))
    print(f"wrote {path}")
    return 0


def _config(args: argparse.Namespace) -> AcceleratorConfig:
    """The machine of the command line."""
    if args.config.lower() in MACHINES:
        args.config = args.config.lower()
    config = config_from(args)
    return with_two_eyes(config) if args.stereo else config


def _say(line: str) -> None:
    print(line, flush=True)


def _machine(args: argparse.Namespace) -> Path:
    config = _config(args)
    report = machine_area(config, args.tech, args.clock_ps, args.out, args.jobs, _say, args.runs)
    path = args.out / f"{config.name}{'-stereo' if args.stereo else ''}-{report.technology}-{args.clock_ps:.0f}.json"
    write_json(path, {**report.as_json(), "configuration": config_record(config)})
    print("\n".join(machine_lines(report)))
    return path


if __name__ == "__main__":
    run_command_line(main)
