"""The energy of the same units at 16 nm by two libraries: writes reports/energy_anchors.json and energy_anchors.md.

    msv2 study run energy_anchors

Energies of operations are measured in ASAP7 and scaled. Nangate45, scaled from the other side, says something else. What is
compared is the switched capacitance: the sum of C V² over all input pins of a mapped unit, which is what its nets take when
each toggles twice. Both netlists are of the same RTL, with clocks that are the same at 16 nm, so equal activity is a
fair assumption; energy inside cells and leakage are not compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from msv2.studies.destination import newest
from msv2.studies.page import table, write_page
from msv2.studies.record import commit, liberties, write_report
from msv2.studies.wires.study import PLACED
from rtl.units import UNITS
from spec.command_line import command_parser
from spec.paths import REPORTS, ROOT
from synth.design import elaborate
from synth.discover import read_cells
from synth.hints import config_of
from synth.power.energy import VOLTAGE
from synth.report import module_result
from synth.scaling import SOURCE, TO_16NM, same_clock
from synth.settings import Settings

VOLTAGES = {"asap7": VOLTAGE, "nangate45": 1.10}
"""Supply voltage of the liberty files in V, by technology."""

CLOCK_PS = 1000.0
"""The clock in ASAP7; the other library's is the one that scales to the same clock at 16 nm."""


def pin_capacitances(liberty: Path) -> dict[str, float]:
    """The capacitance of all input pins of each cell in fF."""
    return {cell.name: sum(float(pin.attributes.get("capacitance", 0.0)) for pin in cell.pins.values() if pin.is_input)
            for cell in read_cells(liberty)[1]}


def switched(unit: str, settings: Settings) -> dict[str, float]:
    """Pins' capacitance of a mapped unit in fF, and C V² of it in fJ at the library's node and at 16 nm."""
    name, liberty = settings.technology, settings.library()[1]
    cells = pin_capacitances(liberty)
    design = elaborate(UNITS[unit].make(config_of(unit)), unit)
    counts, parts = design.counts(), {}
    for module in design.texts:
        parts[module] = module_result(design, module, [Path(part["netlist"]) for part in parts.values()], settings)
    ff = sum(counts[module] * number * cells[kind] for module, part in parts.items()
             for kind, number in part["cells_by_type"].items())
    energy = ff * VOLTAGES[name] ** 2
    return {"pin_ff": round(ff, 1), "fj": round(energy, 1), "fj_16nm": round(energy * TO_16NM[name].energy, 1)}


def unit_row(unit: str, folder: Path, runs: int) -> dict[str, object]:
    """A unit by both libraries, and the ratio of what they say of 16 nm."""
    found = {name: switched(unit, Settings(name, same_clock(CLOCK_PS, "asap7", name), folder, runs=runs)) for name in VOLTAGES}
    fine, coarse = (found[name]["fj_16nm"] for name in ("asap7", "nangate45"))
    return {"unit": unit, **found, "ratio": round(coarse / fine, 4), "commit": commit()}


def page(report: Mapping) -> str:
    """The report as a Markdown page."""
    rows = ((f"`{row['unit']}`", row["commit"], *(f"{row[name][key] / scale:,.2f}" for name in VOLTAGES
                                                 for key, scale in (("pin_ff", 1e3), ("fj_16nm", 1e3))), f"{row['ratio']:.2f}")
            for row in report["units"])
    head = ("unit", "commit", "ASAP7: pins, pF", "ASAP7: pJ at 16 nm", "Nangate45: pins, pF", "Nangate45: pJ at 16 nm",
            "Nangate45 over ASAP7")
    intro = (
        "Written by `msv2 study run energy_anchors`. The same units are mapped to two libraries, with clocks that are the same "
        f"at 16 nm. An energy is C V² of all input pins, scaled to 16 nm ({SOURCE}): what the unit's nets take if each "
        "toggles twice. It is a comparison of libraries and of scaling, and no energy of an operation.")
    sums = (f"Over all units, Nangate45 says {report['ratio']:.2f} of what ASAP7 says, {report['low']:.2f} to "
            f"{report['high']:.2f} by unit. Energies of frames are ASAP7's; the other anchor stands beside them "
            "([energy.md](energy.md)).")
    return "\n\n".join(["# Energy at 16 nm by two libraries", intro, sums, table(head, rows, left=2)]) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line, maps the units, and writes the reports; returns the exit status."""
    parser = command_parser("msv2 study run energy_anchors", __doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1, help="most runs of a module (default: 1, for both libraries)")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "synth",
                        help="folder of synthesis results (default: build/synth)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="folder of the report (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    for name in VOLTAGES:
        Settings(name, CLOCK_PS, args.folder).check()
    rows = []
    for unit in PLACED:
        rows.append(unit_row(unit, args.folder, args.runs))
        print(f"{unit}: {rows[-1]['ratio']:.2f}", flush=True)
    ratios = [row["ratio"] for row in rows]
    fine, coarse = (sum(row[name]["fj_16nm"] for row in rows) for name in ("asap7", "nangate45"))
    report = {"ratio": round(coarse / fine, 4), "low": min(ratios), "high": max(ratios), "voltages": VOLTAGES, "units": rows}
    path = args.out / "energy_anchors.json"
    write_report(path, report, [__name__], {"arguments": args}, liberties())
    write_page(args.out / "energy_anchors.md", page(report))
    print(f"wrote {newest(path)} and energy_anchors.md")
    return 0
