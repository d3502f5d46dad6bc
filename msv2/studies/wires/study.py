"""Places units of `paper` and measures what their wires cost: writes reports/wires.json and wires.md.

    msv2 study run wires                       all five units
    msv2 study run wires --unit pixel_core     one of them; the rows of the others stay as they are

A unit is mapped as in the area report, placed (`synth.physical`), and timed by OpenSTA with and without its wires.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from msv2.studies.destination import newest
from msv2.studies.page import write_page
from msv2.studies.record import commit, liberties, write_report
from msv2.studies.wires.page import page
from spec.command_line import command_parser
from spec.errors import InputError
from spec.extras import how_to_get
from spec.paths import REPORTS, ROOT
from synth import timing
from synth.liberty import PDK_VARIABLE
from synth.physical import placement
from synth.physical.parasitics import ASAP7_WIRES
from synth.physical.wired import Wired, measure
from synth.settings import MOST_RUNS, Settings

PLACED = ("pixel_core", "vrc_row", "setup", "entry_writer", "tile_merge_unit")
"""The units of the report: the datapaths that repeat most, and two units of control."""

LEF = Path("lef/asap7sc7p5t_28_R_1x_220121a.lef")
"""The LEF file of ASAP7's cells below the folder of the liberty files."""

CLOCK_PS = 1000.0


def row(found: Wired) -> dict[str, object]:
    """A unit's row of the report."""
    numbers = {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(found).items()
               if key != "tree"}
    tree = {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(found.tree).items()}
    shares = {key: round(getattr(found, key), 4) for key in ("wire_share", "derate", "tree_share")}
    return {**numbers, "tree": tree, **shares, "commit": commit()}


def overall(rows: Sequence[Mapping]) -> dict[str, float]:
    """What follows for a machine: the units' sums for energies, and the slowest unit's for delays.

    Returns:
        `derate`: the largest ratio of a unit's clock periods with and without wires. `wire_share`: capacitance of wires over
        that of pins. `tree_share`: energy of clock trees over that of the pins and cells that they clock.
    """
    def total(*keys: str) -> float:
        return sum(found[keys[0]] if len(keys) == 1 else found[keys[0]][keys[1]] for found in rows)

    return {"derate": max(found["derate"] for found in rows), "wire_share": round(total("wire_ff") / total("pin_ff"), 4),
            "tree_share": round((total("tree", "wire_fj") + total("tree", "buffer_fj")) / total("clock_fj"), 4)}


def lef_file(given: Path | None) -> Path:
    """The LEF file that is named, or the one below MSV2_PDK.

    Raises:
        InputError: neither is there.
    """
    if given is not None:
        return given
    folder = os.environ.get(PDK_VARIABLE)
    if not folder:
        raise InputError(f"--lef must name the LEF file of ASAP7's cells, or {PDK_VARIABLE} a folder that holds {LEF}")
    return Path(folder) / LEF


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line, places the units, and writes the reports; returns the exit status."""
    parser = command_parser("msv2 study run wires", __doc__.splitlines()[0])
    parser.add_argument("--unit", nargs="+", default=list(PLACED), metavar="UNIT", help=f"among {', '.join(PLACED)}")
    parser.add_argument("--density", type=float, default=0.8, help="share of the die that cells take (default: 0.8)")
    parser.add_argument("--effort", type=int, default=3, help="of the placement, 1..9 (default: 3)")
    parser.add_argument("--runs", type=int, default=MOST_RUNS, help=f"most runs of a module (default: {MOST_RUNS})")
    parser.add_argument("--lef", type=Path, help=f"LEF file of the cells (default: {LEF} below {PDK_VARIABLE})")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "synth",
                        help="folder of synthesis results (default: build/synth)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="folder of the report (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    unknown = set(args.unit) - set(PLACED)
    if unknown:
        raise InputError(f"units {', '.join(sorted(unknown))} are not known: {', '.join(PLACED)} are")
    if not placement.available():
        raise InputError(f"coloquinte is not installed; {how_to_get('coloquinte')}")
    if not timing.available():
        raise InputError("OpenSTA (the command sta) is not installed; on Debian: apt-get install opensta")
    settings, lef = Settings("asap7", CLOCK_PS, args.folder, runs=args.runs), lef_file(args.lef)
    settings.check()
    path = args.out / "wires.json"
    old = json.loads(path.read_text()) if path.is_file() else {}
    rows = {found["unit"]: found for found in old.get("units", [])}
    for unit in args.unit:
        rows[unit] = row(measure(unit, settings, lef, args.density, args.effort))
        print(f"{unit}: slack {rows[unit]['slack_ps']:.1f} ps, with wires {rows[unit]['wired_slack_ps']:.1f} ps", flush=True)
    units = [rows[unit] for unit in PLACED if unit in rows]
    report = {**overall(units), "technology": settings.library()[0].node, "wires": asdict(ASAP7_WIRES), "units": units}
    earlier = old if set(rows) - set(args.unit) else None
    write_report(path, report, [__name__], {"arguments": args}, [*liberties(), lef], earlier)
    write_page(args.out / "wires.md", page(report))
    print(f"wrote {newest(path)} and wires.md")
    return 0
