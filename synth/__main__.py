"""Synthesise a unit: area, and timing in OpenSTA.

    python -m synth --unit pixel_core --tech asap7 --clock-ps 1000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from spec.errors import run_command_line
from synth import timing
from synth.report import TECHNOLOGIES, synthesise_unit
from synth.units import UNITS


def as_line(label: str, result: dict) -> str:
    """One line of the printed table."""
    if "nand2_equivalents" in result:
        return f"{label:24} {result['nand2_equivalents']:>9,} NAND2 equivalents"
    line = f"{label:24} {result['area_um2']:9.1f} um2 {result['cells']:6,} cells"
    if "area_per_core_um2" in result:
        line += f"  {result['area_per_core_um2']:.1f} um2 a core"
    if result["slack_ps"] is None:
        return line
    return (f"{line}  slack {result['slack_ps']:6.1f} ps at {result['clock_ps']:.0f} ps; zero slack at "
            f"{1e3 / result['zero_slack_ps']:.2f} GHz, {1e3 / result['derated_ps']:.2f} GHz with 15 % for wires")


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = argparse.ArgumentParser(prog="python -m synth", description=__doc__.splitlines()[0])
    parser.add_argument("--unit", default="pixel_core", help=f"one of {', '.join(UNITS)} (default: pixel_core)")
    parser.add_argument("--tech", default="generic", help=f"one of {', '.join(TECHNOLOGIES)} (default: generic)")
    parser.add_argument("--clock-ps", type=float, default=1000.0, help="clock period in ps (default: 1000)")
    parser.add_argument("--out", type=Path, default=Path("build/synth"), metavar="DIR", help="default: build/synth")
    args = parser.parse_args(argv)
    report = synthesise_unit(args.unit, args.tech, args.clock_ps, args.out)
    print(as_line(args.unit, report))
    for label, result in report["variants"].items():
        print(as_line(f"  {label}", result))
    if args.tech != "generic" and not timing.available():
        print("no timing: sta is not installed (Debian's package opensta)")
    print(f"wrote {args.out / f'{args.unit}-{args.tech}.json'}")
    return 0


if __name__ == "__main__":
    run_command_line(main)
