"""The README's tables, made of the numbers in reports/."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from golden.accuracy import as_markdown
from golden.scenes.files import atomic_output
from golden.scenes.gaze import Display, blend_parameter, foveation_map, region_level
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.vrc_array import blend, expand, row, setup
from spec.config import DEFAULT
from spec.constants import TILE

AREA_7_TO_16_NM = 1 / 0.31
"""Area of the same logic at 16 nm over 7 nm (Stillmaker & Baas 2017)."""

PAPER_CORE_UM2 = 2.74e6 * 0.63 / TILE**2
"""The paper's array, 63 % of 2.74 mm^2 at 16 nm, per core."""

PAPER_SIZE = (1237, 822)
"""Frame of the paper's datasets at which it states the regions' shares."""

Reports = dict[str, dict]


def load_reports(folder: Path) -> Reports:
    """Every report by name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """A table; a message where there is nothing to show."""
    if not rows:
        return "(not measured yet)"
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [header, ["---"] * len(header), *rows])


def results_table(reports: Reports) -> str:
    """Paper, ours, and why they differ."""
    rows = []
    synthesis = {r["unit"]: r for r in reports.get("synthesis", {"rows": []})["rows"]}
    if "vrc_row" in synthesis:
        per_core, core = synthesis["vrc_row"]["area_per_core_um2"], synthesis["pixel_core"]
        rows.append(["area of a core, registers of its row included, at 16 nm", f"{PAPER_CORE_UM2:,.0f} um²",
                     f"{per_core * AREA_7_TO_16_NM:,.0f} um² (ASAP7: {per_core:.0f} um² x 1/0.31)",
                     "log2-domain integers, their format is not stated; cells only, no place and route, no line buffer"])
        rows.append(["pixel core alone, ASAP7, strict cell list", "-",
                     f"{core['area_um2']:.0f} um², slack {core['slack_ps']:.0f} ps at {core['clock_ps']:.0f} ps",
                     f"two level banks, depth, early stop; {1e3 / core['derated_ps']:.2f} GHz with 15 % for wires"])
    frames = reports.get("frames", {"rows": []})["rows"]
    if frames:
        exact, pixels = sum(f["bit_exact"] for f in frames), sum(f["pixels_checked"] for f in frames)
        counted = f"{exact} of {len(frames)}, {pixels:,} pixels"
        rows.append(["RTL frames equal to the golden renderer", "-", counted, "every bit of every pixel"])
    display = Display(*PAPER_SIZE)
    gaze = (PAPER_SIZE[0] / 2, PAPER_SIZE[1] / 2)
    eccentricity = display.eccentricity(gaze)
    level = region_level(eccentricity)
    shares = "/".join(f"{100 * (level == i).mean():.1f}" for i in range(4))
    band = 100 * ((blend_parameter(eccentricity, level) > 0) & (level < 3)).mean()
    tiles = 100 * foveation_map(display, gaze).blend.mean()
    size = "x".join(map(str, PAPER_SIZE))
    rows.append([f"pixels per quality region at {size}", "13/17/21/49 %", f"{shares} %", "display 90° wide, theirs not stated"])
    bands = f"{band:.1f} % ({tiles:.0f} % of the tiles)"
    rows.append(["pixels in blend bands", "about 25 %", bands, "one such pixel makes a tile blend"])
    accuracy = reports.get("accuracy", {"rows": []})["rows"]
    if accuracy:
        worst = min(r["psnr_vs_oracle_db"] for r in accuracy)
        rows.append(["integer datapath against float64", "-", f"{worst:.1f} dB or more in {len(accuracy)} views",
                     "budget 60 dB, before 8-bit rounding"])
    return markdown(["quantity", "paper", "ours", "why they differ, notes"], rows)


def latencies(*units: type) -> str:
    """Latencies of float units, as their classes state them."""
    return f"{', '.join(str(unit.latency) for unit in units)} cycles, 1/cycle"


def units_table(reports: Reports) -> str:
    """Source, golden, tests, latency and area of every RTL unit."""
    area = {r["unit"]: f"{r['area_um2']:,.0f} um²" for r in reports.get("synthesis", {"rows": []})["rows"]}
    core, array = row.PIPELINE + row.SUMS_LATER, "array_kernel"
    units = [
        ("pixel core", "vrc_array/pixel_core", array, "test_rtl_pixel_core", f"{core} cycles, 1 op/cycle"),
        ("row of 16 cores", "vrc_array/row", array, "test_rtl_array", "1 cycle to the next row"),
        ("setup unit", "vrc_array/setup, polynomial", array, "test_rtl_setup", f"{setup.LATENCY} cycles, 1 op/cycle"),
        ("expansion", "vrc_array/expand", array, "test_rtl_expand", f"{expand.latency(DEFAULT)} cycles, 1 op/cycle"),
        ("block sequencer", "vrc_array/blocks", "-", "test_rtl_array", "1 cycle (3 with blocks)"),
        ("level blending", "vrc_array/blend", array, "test_rtl_blend", f"{blend.BLEND_LATENCY} cycles, 1 row/cycle"),
        ("collection, line buffer", "vrc_array/collect", "-", "test_rtl_array", "1 row/cycle"),
        ("whole array", "vrc_array/array", "vrc_array", "sim TEST=vrc, frame", "1 entry/cycle"),
        ("tile merge unit", "sort_tmu/tile_merge", "sort_tmu", "test_rtl_tmu, sim TEST=tmu", "1 entry/cycle, 1 tile/cycle"),
        ("chunk sorter", "sort_tmu/chunk_sorter", "sort_tmu", "test_rtl_sort, sim TEST=sort", "1 entry/cycle"),
        ("float add, multiply", "float/add, multiply", "rounding", "sim TEST=float", latencies(FloatAdd, FloatMul)),
        ("float divide, 1/x", "float/divide", "rounding", "sim TEST=float", latencies(FloatDivide, FloatReciprocal)),
        ("float 1/sqrt, sqrt", "float/roots", "rounding", "sim TEST=float", latencies(FloatRsqrt, FloatSqrt)),
        ("float from, to fixed", "float/convert", "rounding", "sim TEST=float", latencies(FixedToFloat, FloatToFixed)),
    ]
    synthesised = {"pixel core": "pixel_core", "row of 16 cores": "vrc_row"}
    rows = [[*unit, area.get(synthesised.get(unit[0]), "-")] for unit in units]
    return markdown(["unit", "rtl/", "golden/msv2_ref/", "tests", "latency, throughput", "area, ASAP7"], rows)


def accuracy_table(reports: Reports) -> str:
    """The table of reports/accuracy.md."""
    return as_markdown(reports["accuracy"]["rows"]) if "accuracy" in reports else "(not measured yet)"


def frames_table(reports: Reports) -> str:
    """One row per RTL frame."""
    rows = []
    for r in reports.get("frames", {"rows": []})["rows"]:
        size = "x".join(map(str, r["size"]))
        numbers = [f"{r[key]:,}" for key in ("entries", "ops", "cycles", "cycles_per_s")]
        rows.append([f"{r['scene']}, {size}", "4 levels" if r["gaze"] else "-", r["config"], *numbers[:3],
                     f"{r['cycles'] / r['ops']:.3f}", "yes" if r["bit_exact"] else "NO", numbers[3]])
    header = ["frame", "foveation", "machine", "entries", "ops", "cycles", "cycles/op", "bit-exact", "simulated cycles/s"]
    return markdown(header, rows)


def time_table(reports: Reports) -> str:
    """Every renderer's time against its error, from the benchmark; the RTL's from the frames it simulated."""
    rows = []
    for scene in reports.get("bench", {"scenes": []})["scenes"]:
        size = "x".join(map(str, scene["size"]))
        for name, r in scene["renderers"].items():
            rows.append([f"{scene['scene']}, {size}", name, f"{1e3 * r['median_s']:,.1f} ms", f"{r['times_integer']:.2f}",
                         f"{r['psnr_vs_oracle_db']:.1f} dB"])
    for r in reports.get("frames", {"rows": []})["rows"]:
        if r["config"] == "default" and not r["gaze"]:
            size = "x".join(map(str, r["size"]))
            rows.append([f"{r['scene']}, {size}", "RTL in Verilator", f"{1e3 * r['cycles'] / r['cycles_per_s']:,.0f} ms", "-",
                         "equal to the integer golden"])
    return markdown(["frame", "renderer", "time", "times the integer golden's", "against the oracle"], rows)


TABLES: dict[str, Callable[[Reports], str]] = {
    "results": results_table, "units": units_table, "accuracy": accuracy_table, "frames": frames_table, "time": time_table,
}


def fill_readme(readme: Path, reports_folder: Path, *, check: bool = False) -> int:
    """Rewrites the text between each `<!-- table:NAME -->` and `<!-- end -->`; with `check` returns 1 where it would change."""
    reports, old = load_reports(reports_folder), readme.read_text()
    new = re.sub(r"(<!-- table:(\w+) -->\n).*?(<!-- end -->)",
                 lambda m: f"{m[1]}{TABLES[m[2]](reports)}\n{m[3]}", old, flags=re.S)
    if not check and new != old:
        with atomic_output(readme) as file:
            file.write(new.encode())
    return int(check and new != old)
