"""`msv2 study run energy_per_operation`: energies of operations, measured on mapped netlists, for
reports/energy_per_operation.json.

Units for which there is a test bench are simulated gate by gate, with delays, on the work of real scenes' frames, and every
output is compared. For the other units, clock energy and leakage come from their netlists, and an operation costs as much per
area as in the mean of the simulated units. The study needs the extra `synth` and the liberty files of MSV2_PDK.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from golden.msv2_ref.pipeline import Frame
from golden.scenes.captured import CAPTURED, scene_argument
from golden.scenes.files import read_json
from msv2.studies.destination import newest
from msv2.studies.energy.supertiles import STAND_INS
from msv2.studies.energy.table import TABLE
from msv2.studies.energy_per_operation.measure import map_work, measure, still
from msv2.studies.energy_per_operation.super_work import SUPER_WORK
from msv2.studies.energy_per_operation.table import DEFAULTS, SUPER_DEFAULTS, super_unit_rows, unit_rows
from msv2.studies.energy_per_operation.work import WORK
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import commit, liberties, write_report
from msv2.studies.scenes import MODELS
from spec.command_line import choice, command_parser
from spec.config import PAPER, V3, V3_PACKED, V3_STREAMS, AcceleratorConfig
from spec.errors import InputError
from spec.extras import how_to_get
from spec.paths import ROOT
from synth import flow
from synth.liberty import ASAP7, find_files
from synth.power.cells import read_cells
from synth.power.energy import VOLTAGE
from synth.scaling import ENERGY_TO_16NM, SOURCE
from tb.common.scenes import traced_frame

SIZE = "160x96"
PREFIXES = {PAPER.name: "", V3.name: "supertile_"}
"""What the keys of the table begin with that are of a machine's own units."""

UNITS = {PAPER.name: (*WORK, *DEFAULTS), V3.name: (*SUPER_WORK, *SUPER_DEFAULTS)}
"""The units that are measured, by the machine whose they are."""

MACHINES = {"warp_unit": PAPER.with_(stereo=True), "stream_buffer": V3_STREAMS, "frame_packer": V3_PACKED}
"""The machines of the units that neither PAPER nor V3 has."""

FOLDER = ROOT / "build" / "power"


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run energy_per_operation", __doc__)
    parser.add_argument("--unit", default="",
                        help=f"measure only this unit, and write nothing: {', '.join(sum(UNITS.values(), ()))}")
    parser.add_argument("--machine", default="", choices=("", *UNITS),
                        help="measure only the units of this machine; the others stay as they are in the kept table")
    parser.add_argument("--again", default="", metavar="UNIT,UNIT",
                        help="measure only these units; the others stay as they are in the kept table")
    parser.add_argument("--leave-out", default="", metavar="UNIT,UNIT",
                        help=f"units that are not measured, but assumed (docs/energy.md), among {', '.join(STAND_INS)}")
    parser.add_argument("--scenes", default="embedded,truck", help="scenes, separated by commas (default: embedded,truck)")
    parser.add_argument("--clock-ps", type=float, default=1000.0,
                        help="clock period of the netlists in picoseconds (default: 1000)")
    parser.add_argument("--synth", type=Path, default=ROOT / "build" / "synth", metavar="DIR",
                        help="folder of netlists (default: build/synth)")
    parser.add_argument("--out", type=Path, default=TABLE, metavar="FILE",
                        help=f"output file (default: build/reports/{TABLE.name}; --keep: {TABLE.relative_to(ROOT)})")
    return parser.parse_args(argv)


def _key(unit: str, scene: str, args: argparse.Namespace) -> str:
    """The name of a measurement, which covers everything on which it depends."""
    key = fingerprint([measure.__module__], unit, scene, SIZE, args.clock_ps, flow.version())
    return f"{unit}-{Path(scene).stem or 'still'}-{key}"


def measured(units: Sequence[str], scenes: Sequence[str], args: argparse.Namespace) -> list[dict[str, object]]:
    """The rows of simulated units, one per scene, and of the other units, one row each."""
    rows = []
    for unit in units:
        mapped = None
        for scene in scenes if unit in WORK or unit in SUPER_WORK else ("",):
            def make(unit: str = unit, scene: str = scene) -> dict[str, object]:
                nonlocal mapped
                config = machine_of(unit)
                mapped = mapped or map_work(unit, config, args.clock_ps, args.synth)
                return measure(mapped, unit, config, scene, _frame(config, scene)) if scene else still(mapped, unit)

            rows.append(kept(FOLDER, _key(unit, scene, args), make))
            print(_line(rows[-1]), flush=True)
    return rows


def machine_of(unit: str) -> AcceleratorConfig:
    """The machine in which a unit is measured."""
    return MACHINES.get(unit, V3 if unit in UNITS[V3.name] else PAPER)


@cache
def _frame(config: AcceleratorConfig, scene: str) -> Frame:
    return traced_frame(config, scene_argument(scene), SIZE)[1]


def _line(row: dict[str, object]) -> str:
    work = (f"{row['pj_per_operation']:9.3f} pJ for each {row['operation']}, {row['operations']} in {row['cycles']} cycles, "
            f"{row['items_compared']} items equal; " if "operation" in row else " " * 12)
    return (f"{row['unit']:20} {row.get('scene', ''):12} {work}clock {row['clock_pj_per_cycle']:8.3f} pJ a cycle, "
            f"leakage {row['leakage_mw']:.4f} mW")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    if args.unit:
        choice("unit", args.unit, sum(UNITS.values(), ()))
    if flow.libyosys is None:
        raise InputError(f"pyosys is not installed; {how_to_get('pyosys')}")
    find_files(ASAP7)
    scenes = args.scenes.split(",")
    for scene in scenes:
        if scene not in MODELS:
            raise InputError(f"scene {scene!r} is not accepted: choose of {', '.join(MODELS)}")
        if scene_argument(scene) is None:
            raise InputError(f"scene {scene!r} is not there: MSV2_DATA must name the folder that has {CAPTURED[scene]}")
    if args.unit:
        measured([args.unit], scenes, args)
        return 0
    left_out = args.leave_out.split(",") if args.leave_out else []
    for unit in left_out:
        choice("leave-out", unit, tuple(STAND_INS))
    again = args.again.split(",") if args.again else []
    for unit in again:
        choice("again", unit, sum(UNITS.values(), ()))
    old, samples, commits = read_json(TABLE) if args.machine or again else {}, {}, {}
    for machine, prefix in PREFIXES.items():
        if again:
            kept_rows = [row for row in old[f"{prefix}samples"] if row["unit"] not in again]
            fresh = [row | {"commit": commit()} for row in measured([u for u in UNITS[machine] if u in again], scenes, args)]
            samples[machine] = sorted(kept_rows + fresh, key=lambda row: UNITS[machine].index(row["unit"]))
            commits[machine] = old[f"{prefix}commit"]
        elif args.machine in ("", machine):
            samples[machine] = measured([unit for unit in UNITS[machine] if unit not in left_out], scenes, args)
            commits[machine] = commit()
        elif not old.get(f"{prefix}samples"):
            raise InputError(f"machine {args.machine!r} alone is not accepted: {TABLE} has no units of the other one")
        else:
            samples[machine], commits[machine] = old[f"{prefix}samples"], old[f"{prefix}commit"]
    write_table(args.out, samples, commits, scenes, args.clock_ps, old)
    print(f"wrote {newest(args.out)}")
    return 0


def write_table(
    path: Path, samples: Mapping[str, Sequence[dict[str, object]]], commits: Mapping[str, str], scenes: Sequence[str],
    clock_ps: float, old: Mapping[str, object],
) -> None:
    """Writes the table of the measurements of each machine's units, which were made at some commit. Those of one machine may be
    of an old table."""
    rows, super_rows = (samples[machine] for machine in PREFIXES)
    report = {
        "config": PAPER.name,
        "reference": {"cores": PAPER.cores_x * PAPER.cores_y, "culling_units": PAPER.culling_units,
                      "warp_lanes": PAPER.warp_lanes},
        "node": ASAP7.node, "voltage": VOLTAGE, "clock_ps": clock_ps, "to_16nm": ENERGY_TO_16NM["asap7"],
        "scaling": f"x {ENERGY_TO_16NM['asap7']:g} to 16 nm at 0.8 V ({SOURCE})", "flop_leakage_pw": flop_leakage(),
        **{f"{prefix}commit": commits[machine] for machine, prefix in PREFIXES.items()}, "tools": flow.version(),
        "scenes": scenes, "size": SIZE,
        "units": unit_rows(rows), "supertile_units": super_unit_rows(super_rows, rows), "samples": rows,
        "supertile_samples": super_rows}
    write_report(path, report, [__name__], {"machines": [PAPER, V3], "clock_ps": clock_ps, "size": SIZE},
                 [*liberties(), *filter(None, map(scene_argument, scenes))], earlier=old or None)


def flop_leakage() -> float:
    """The leakage of the library's flip-flop in pW."""
    return read_cells(find_files(ASAP7), [ASAP7.flop])[ASAP7.flop].leakage
