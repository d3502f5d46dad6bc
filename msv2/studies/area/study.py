"""Area of the paper's machine beside the paper's own numbers: writes reports/area.json, .md and .png.

    msv2 study run area                all builds; an hour if build/synth holds no results of modules
    msv2 study run area --builds 1ghz  only some builds; the numbers of the others stay as they are in the report

A build is the machine for two eyes with rows of 1920 pixels; the memories of the warp unit are also reported separately. The
build `mono` is without the warp unit, and so are those with the names of presets, which have their formats and harmonics. The
modules are those that the linked machine is timed with (`synth.whole`): mapped for what clock uncertainty leaves of the clock.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.files import read_json
from msv2.studies.area.estimate import SHORTENED
from msv2.studies.area.figure import draw
from msv2.studies.area.page import page
from msv2.studies.area.replaced import SUPERTILE_LISTS, units_of
from msv2.studies.destination import newest
from msv2.studies.page import write_page
from msv2.studies.record import commit, liberties, write_report
from spec.command_line import command_parser
from spec.config import PAPER, V3, AcceleratorConfig
from spec.errors import InputError
from spec.paths import REPORTS, ROOT
from synth.area import AreaReport, machine_area
from synth.corners import UNCERTAINTY
from synth.scaling import DELAY_TO_16NM, SOURCE, same_clock
from synth.settings import MOST_RUNS
from synth.timing import WIRE_DERATE

CLOCK_PS = 1000.0
TWO_EYES = PAPER.with_(stereo=True)


@dataclass(frozen=True)
class Build:
    """A machine in a technology at a clock, and a description of the use of its numbers."""

    config: AcceleratorConfig
    technology: str
    clock_ps: float
    about: str

    @property
    def mapped_ps(self) -> float:
        """The clock for which modules are mapped."""
        return float(round(self.clock_ps * (1 - UNCERTAINTY)))


BUILDS = {
    "1ghz": Build(TWO_EYES, "asap7", CLOCK_PS, "1 GHz in ASAP7: the build that all other tables are of"),
    "mono": Build(PAPER, "asap7", CLOCK_PS, "the same without the warp unit"),
    "relaxed": Build(TWO_EYES, "asap7", round(CLOCK_PS * DELAY_TO_16NM["asap7"]),
                     "made for the scaled clock itself: what 1 GHz in ASAP7 is at 16 nm, as ASAP7's constraint"),
    "tight": Build(TWO_EYES, "asap7", round(CLOCK_PS / DELAY_TO_16NM["asap7"]),
                   "made for 1 GHz at 16 nm: ASAP7's cells must be as much faster as the scaling says"),
    "nangate45": Build(TWO_EYES, "nangate45", same_clock(CLOCK_PS, "asap7", "nangate45"),
                       "another library's area, for a clock that scales to the same one at 16 nm"),
    "osu018": Build(TWO_EYES, "osu018", same_clock(CLOCK_PS, "asap7", "osu018"),
                    "a third one's; it has no clock gates, so enables are multiplexers"),
    SUPERTILE_LISTS: Build(V3, "asap7", CLOCK_PS, "chunks of compact records and lists by super-tile, beside `mono`"),
    **{name: Build(config, "asap7", CLOCK_PS, f"`mono` with the formats and harmonics of `{name}`")
       for name, config in SHORTENED.items()},
}
"""The builds by name; the first is the one that the report describes in detail."""

PAPER_MM2, PAPER_SHARES = 2.74, {"array": 0.63, "other logic": 0.30, "SRAM": 0.07}
"""Area of the paper's machine at 16 nm in mm^2, and the shares of its parts."""

PAPER_CORES = 256


def summary(report: AreaReport, build: Build) -> dict[str, object]:
    """The numbers of a build, as one entry of the report. Slack is what is left of `mapped_ps`; the clocks at zero slack have
    the same share of uncertainty."""
    slack = report.worst_slack_ps()
    zero = None if slack is None else (build.mapped_ps - slack) * build.clock_ps / build.mapped_ps
    late = {row.unit: row.slack_ps for row in report.rows if row.slack_ps is not None and row.slack_ps < 0}
    factor = DELAY_TO_16NM[report.technology]
    return {
        "about": build.about, "config": report.config, "stereo": report.stereo, "row_width": report.row_width,
        "technology": report.technology, "node": report.node, "cell_list": report.cell_list, "clock_ps": build.clock_ps,
        "mapped_ps": build.mapped_ps,
        "mm2_16nm": round(report.total_mm2_16nm(), 4),
        "mm2_16nm_without_warp_memories": round(report.total_mm2_16nm(warp_memories=False), 4),
        "mm2_16nm_logic": round(report.total_mm2_16nm(memories=False), 4),
        "core_um2_16nm": round(report.core_um2_16nm(), 1),
        "area_source": SOURCE, "worst_slack_ps": slack, "late_units": late,
        "clock_ghz_constraint": round(1e3 / build.clock_ps, 4),
        "clock_ghz_zero_slack": None if zero is None else round(1e3 / zero, 4),
        "clock_ghz_with_wires": None if zero is None else round(1e3 / zero / WIRE_DERATE, 4),
        "clock_ghz_16nm_constraint": round(1e3 / (build.clock_ps * factor), 4),
        "clock_ghz_16nm_zero_slack": None if zero is None else round(1e3 / (zero * factor), 4),
        "groups": {name: {key: round(value, 1) for key, value in sums.items()} for name, sums in report.groups().items()},
    }


def split(report: AreaReport) -> dict[str, float]:
    """The machine's area in mm^2 at 16 nm, in the parts of the paper.

    Setup and blending count as part of the array, and all memories as SRAM.
    """
    groups = report.groups()
    array = sum(groups[name]["logic_um2_16nm"] for name in ("array", "blending")) / 1e6
    logic = report.total_mm2_16nm(memories=False)
    return {"array": array, "other logic": logic - array, "SRAM": report.total_mm2_16nm() - logic}


def measure(names: Sequence[str], folder: Path, jobs: int, runs: int, old: dict) -> dict[str, object]:
    """Synthesises the builds `names` and returns the whole report; all other builds are copied from the report `old`."""
    builds = dict(old.get("builds", {}))
    report = {key: old.get(key) for key in ("rows", "memories", "modules", "split")}
    for name in names:
        build = BUILDS[name]
        print(f"{name}: {build.about}", flush=True)
        stamp = commit()
        area = machine_area(build.config, build.technology, build.mapped_ps, folder, jobs, _say, runs)
        builds[name] = {"commit": stamp, "runs": runs, **summary(area, build)}
        found = area.as_json()
        if name == SUPERTILE_LISTS:
            builds[name]["units"] = [_rounded(row) for row in units_of(found["rows"])]
            builds[name]["modules"] = {key: _rounded(value) for key, value in found["modules"].items()}
        if name == "1ghz":
            rows = [{**row, "path": _ends(row["worst_path"])} for row in found["rows"]]
            report |= {"rows": [_rounded(row) for row in rows], "memories": [_rounded(row) for row in found["memories"]],
                       "modules": {key: _rounded(value) for key, value in found["modules"].items()},
                       "split": {key: round(value, 4) for key, value in split(area).items()}}
    if "1ghz" not in builds:
        raise InputError("the build 1ghz is wanted first: its rows are the report")
    shares = {part: round(PAPER_MM2 * share, 4) for part, share in PAPER_SHARES.items()}
    paper = {"mm2_16nm": PAPER_MM2, "split": shares, "core_um2_16nm": round(1e6 * shares["array"] / PAPER_CORES)}
    return {
        "commit": builds["1ghz"]["commit"], "config": repr(TWO_EYES), "delay_to_16nm": DELAY_TO_16NM["asap7"],
        "wire_derate": WIRE_DERATE, "scaling_source": SOURCE, "paper": paper, "frames": frame_rates(),
        "builds": {name: builds[name] for name in BUILDS if name in builds}, **report}


def frame_rates() -> list[dict[str, object]]:
    """Cycles of the frames in reports/machine.json that are merged, pipelined and at the paper's bandwidth per cycle."""
    path = REPORTS / "machine.json"
    rows = json.loads(path.read_text())["rows"] if path.exists() else []
    keys = ("scene", "size", "gaze", "levels", "frame_cycles", "overlapped_cycles", "bytes_per_cycle")
    return [{key: row[key] for key in keys} for row in rows if row["merge"] and row["pipeline"] and row["bytes_per_cycle"]]


def _rounded(row: dict) -> dict:
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in row.items() if key != "worst_path"}


def _ends(path: str | None) -> str | None:
    """The number of pins on a unit's worst path, and the sums that it passes."""
    if path is None:
        return None
    text = Path(path).read_text()
    lines = [line for line in text.splitlines() if " v " in line or " ^ " in line]
    named = [line.split()[-2] for line in lines if "_fa" in line]
    sums = list(dict.fromkeys(name.split("/")[0].rpartition("_fa")[0] for name in named))
    return f"{len(lines)} pins; sums on it: {', '.join(sums) or 'none'}"


def _say(line: str) -> None:
    print(line, flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line, measures, and writes the report; returns the exit status."""
    parser = command_parser("msv2 study run area", __doc__.splitlines()[0])
    parser.add_argument("--builds", nargs="+", default=list(BUILDS), metavar="BUILD",
                        help=f"builds to make, among {', '.join(BUILDS)} (default: all)")
    parser.add_argument("--jobs", type=int, default=2, help="modules synthesised at a time (default: 2)")
    parser.add_argument("--runs", type=int, default=MOST_RUNS,
                        help=f"most runs of a module, each with more fast adders; 1: all are fast (default: {MOST_RUNS})")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "synth",
                        help="folder of synthesis results (default: build/synth)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="folder of the report (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    unknown = set(args.builds) - set(BUILDS)
    if unknown:
        raise InputError(f"builds {', '.join(sorted(unknown))} are not known: {', '.join(BUILDS)} are")
    path = args.out / "area.json"
    old = read_json(path) if path.exists() else {}
    report = measure(args.builds, args.folder, args.jobs, args.runs, old)
    machines = {name: BUILDS[name].config for name in args.builds}
    write_report(path, report, [__name__], {"arguments": args, "machines": machines}, [*liberties(), REPORTS / "machine.json"],
                 old if set(report["builds"]) - set(args.builds) else None)
    write_page(args.out / "area.md", page(report))
    draw(report, args.out / "area.png")
    print(f"wrote {newest(path)}, area.md and area.png")
    return 0
