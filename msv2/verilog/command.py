"""`msv2 verilog`: a machine, or one unit of it, as Verilog files with file lists, lint waivers and register documents."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from msv2.verilog.export import export
from rtl.units import TOP, UNITS
from spec.config import CONFIGS, AcceleratorConfig
from spec.errors import InputError


def configuration(name: str, stereo: bool) -> AcceleratorConfig:
    """The configuration of that name; InputError with what is accepted, and the nearest name, where there is none."""
    found = CONFIGS.get(name.lower())
    if found is None:
        near = get_close_matches(name.lower(), CONFIGS, 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise InputError(f"config {name!r} is not known{hint}: {', '.join(CONFIGS)} are")
    return found.with_(stereo=stereo)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; InputError for what is not accepted."""
    parser = argparse.ArgumentParser(prog="msv2 verilog", description=__doc__)
    parser.add_argument("--config", default="tiny", help=f"machine: one of {', '.join(CONFIGS)} (default: tiny)")
    parser.add_argument("--stereo", action="store_true", help="with the warp unit, for frames of two eyes")
    parser.add_argument("--unit", default=TOP, help=f"one of {', '.join(UNITS)} (default: {TOP}, the whole machine)")
    parser.add_argument("--out", type=Path, default=Path("build/verilog"), metavar="DIR", help="default: build/verilog")
    parser.add_argument("--prefix", help="what the names of all modules begin with (default: the configuration's name)")
    args = parser.parse_args(argv)
    written = export(configuration(args.config, args.stereo), args.out, args.unit, args.prefix)
    print(f"wrote module {written.top}: {written.files}, {written.waivers}, {written.description}")
    for path in written.documents:
        print(f"wrote {path}")
    return 0
