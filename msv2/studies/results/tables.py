"""The generated tables of README.md, docs/results.md and docs/units.md, made of the numbers in reports/."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from golden.scenes.gaze import Display, blend_parameter, foveation_map, region_level
from msv2.studies import page
from msv2.studies.accuracy.study import BUDGETS_DB, TRAINED_BUDGETS_DB, as_markdown, of_scenes, worst_db
from msv2.studies.results.headline import HEADLINE_TABLES
from msv2.studies.results.report_tables import REPORT_TABLES
from msv2.studies.results.units import units_table
from msv2.studies.training.results_tables import TRAINING_TABLES
from spec.constants import TILE
from spec.paths import DOCS, ROOT

AREA_7_TO_16_NM = 1 / 0.31
"""Factor of area from 7 nm to 16 nm for the same logic (Stillmaker & Baas 2017)."""

PAPER_CORE_UM2 = 2.74e6 * 0.63 / TILE**2
"""Area of the paper's array per core: 63 % of 2.74 mm^2 at 16 nm."""

PAPER_SIZE = (1237, 822)
"""Frame size of the paper's datasets, for which it states the regions' shares."""

Reports = dict[str, dict]


def load_reports(folder: Path) -> Reports:
    """All reports, by name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def results_table(reports: Reports) -> str:
    """The paper's numbers, ours, and the reasons for the differences."""
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
        rows.append(["frames of the whole machine equal to the golden renderer", "-", counted, "every bit of every pixel"])
    rows += _gains(reports.get("machine", {"rows": []})["rows"])
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
    for words, budgets, views in (("", BUDGETS_DB, of_scenes(accuracy, trained=False)),
                                  (", the trained scene", TRAINED_BUDGETS_DB, of_scenes(accuracy, trained=True))):
        for records, budget in budgets.items() if views else ():
            rows.append([f"integer datapath against float64, {records} records{words}", "-",
                         f"{worst_db(views, records):.1f} dB or more in {sum(r['records'] == records for r in views)} views",
                         f"budget {budget:.0f} dB, before 8-bit rounding"])
    return page.table(["quantity", "paper", "ours", "why they differ, notes"], rows)


def _gains(machine: list[dict]) -> list[list[str]]:
    """The gain of merging and pipelining over the baseline, and the utilisation of what limits a frame."""
    rows, frames = [], [r for r in machine if r["gaze"]]
    for speed, words in ((None, "memory as fast as its bus"), (25.6, "ideal memory of 25.6 B a cycle")):
        ours = {(r["scene"], *r["size"]): r for r in frames if r["bytes_per_cycle"] == speed and r["pipeline"]}
        base = {(r["scene"], *r["size"]): r for r in frames if r["bytes_per_cycle"] == speed and not r["pipeline"]}
        if ours:
            gains = sorted(base[key]["render_cycles"] / r["render_cycles"] for key, r in ours.items())
            used = sorted(r["utilisation"] for r in ours.values())
            rows.append([f"merging and pipelining over the baseline, {words}", "1.13x", f"{gains[0]:.2f}x to {gains[-1]:.2f}x",
                         f"rendering cycles of {len(ours)} foveated frames; see the machine's table"])
            rows.append([f"utilisation of what limits rendering, {words}", "-", f"{used[0]:.3f} to {used[-1]:.3f}",
                         "LS-Gaussian reports 0.886 for its machine"])
    return rows


def accuracy_table(reports: Reports) -> str:
    """The table of reports/accuracy.md."""
    return as_markdown(reports["accuracy"]["rows"]) if "accuracy" in reports else page.ABSENT


def frames_table(reports: Reports) -> str:
    """Frames on the machine, with a row for the four combinations of merging and pipelining."""
    kinds: dict[tuple, dict[tuple[bool, bool], dict]] = {}
    for r in reports.get("frames", {"rows": []})["rows"]:
        kinds.setdefault((r["scene"], *r["size"], r["levels"] > 1), {})[r["merge"], r["pipeline"]] = r
    rows = []
    for (scene, width, height, foveated), ways in kinds.items():
        both = ways[True, True]
        cycles = [f"{ways[way]['render_cycles']:,}" if way in ways else "-"
                  for way in ((False, False), (True, False), (False, True), (True, True))]
        exact = all(r["bit_exact"] and not r["counter_errors"] for r in ways.values())
        rows.append([f"{scene}, {width}x{height}", "4 levels" if foveated else "-", f"{both['entries']:,}", f"{both['ops']:,}",
                     f"{both['geometry_cycles']:,}", *cycles, f"yes, {len(ways)} of {len(ways)}" if exact else "NO"])
    header = ["frame", "foveation", "intersections", "ops", "geometry cycles", "rendering: baseline", "merging", "pipelining",
              "both", "every bit and counter"]
    return page.table(header, rows)


def machine_table(reports: Reports) -> str:
    """The gain of merging and pipelining over the baseline, by frame and memory."""
    pairs: dict[tuple, dict[bool, dict]] = {}
    for r in reports.get("machine", {"rows": []})["rows"]:
        if r["camera"] != "away" and r["gaze"]:
            pairs.setdefault((r["scene"], *r["size"], r["bytes_per_cycle"] or 0), {})[r["pipeline"]] = r
    rows = []
    for (scene, width, height, speed), pair in pairs.items():
        ours, baseline = pair[True], pair[False]
        limit = max(ours["bounds"], key=ours["bounds"].get)
        rows.append([
            f"{scene}, {width}x{height}", f"{speed} B" if speed else "the bus's", f"{ours['entries']:,}",
            f"{100 * ours['events']['spilled_entries'] / ours['entries']:.0f} %",
            f"{ours['geometry_cycles']:,}", f"{baseline['render_cycles']:,}", f"{ours['render_cycles']:,}",
            f"{baseline['render_cycles'] / ours['render_cycles']:.3f}", limit, f"{baseline['utilisation']:.3f}",
            f"{ours['utilisation']:.3f}", f"{ours['frame_cycles']:,}", f"{ours['overlapped_cycles']:,}"])
    header = ["foveated frame", "ideal memory, a cycle", "intersections", "spilled in sorting", "geometry cycles",
              "rendering: baseline", "ours", "gain", "bound by", "utilisation: baseline", "ours", "whole frame",
              "phases overlapped, at best"]
    return page.table(header, rows)


def sorting_table(reports: Reports) -> str:
    """The sorter alone on real scenes' frames: the share of groups beyond its buffer, and how fast intersections are taken."""
    report = reports.get("sorting", {"rows": []})
    rows = [[r["frame"], f"{r['entries']:,}", f"{r['groups']:,}",
             f"{r['entries_in_large_groups']:,} ({100 * r['entries_in_large_groups'] / r['entries']:.0f} %)",
             f"{r['entries_written']:,}", f"{r['taken_per_cycle']:.3f}"] for r in report["rows"]]
    return page.table(["frame", "intersections", "groups", f"of them in groups beyond {report.get('buffer_entries', 0):,}",
                     "written to memory", "taken a cycle"], rows)


def culling_table(reports: Reports) -> str:
    """Points and splats per cycle in the paper's machine, by memory."""
    rows = []
    for r in reports.get("machine", {"rows": []})["rows"]:
        if r["pipeline"] and (r["camera"] == "away" or r["size"] == [640, 360]):
            events, cycles = r["events"], r["geometry_cycles"]
            culled = sum(events[f"culled_{why}"] for why in ("near", "faint", "outside"))
            size = "x".join(map(str, r["size"]))
            rows.append([
                f"{r['scene']}, {'looking away' if r['camera'] == 'away' else size}{', foveated' * bool(r['gaze'])}",
                f"{r['bytes_per_cycle']} B" if r["bytes_per_cycle"] else "the bus's", f"{events['points']:,}", f"{culled:,}",
                f"{events['survivors']:,}", f"{cycles:,}", f"{events['points'] / cycles:.3f}",
                f"{cycles / events['survivors']:.2f}" if events["survivors"] else "-"])
    header = ["frame", "memory, a cycle", "points", "culled", "visible", "geometry cycles", "points a cycle",
              "cycles a visible splat"]
    return page.table(header, rows)


def order_table(reports: Reports) -> str:
    """The differences between the machine's order and the exact one."""
    rows = [[f"{r['scene']}, {'x'.join(map(str, r['size']))}", f"{r['neighbours']:,}", f"{r['machine_inversions']:,}",
             f"{r['equal_keys']:,}", f"{r['float64_inversions']:,}", f"{r['largest_gap']:.1e}", f"{r['changed_pixels']:,}",
             f"{r['max_abs_error']:.4f}"] for r in reports.get("order", {"rows": []})["rows"]]
    header = ["frame", "neighbours in lists", "inverted by the machine's z", "equal keys", "inverted by float64 z",
              "largest gap of these", "pixels changed by them", "largest change"]
    return page.table(header, rows)


def shared_table(reports: Reports) -> str:
    """One pipeline at full rate, compared with several units that take turns. docs/synthesis.md has all details."""
    rows = [[r["part"].replace("_", " "), r["throughput"], f"{r['units']}", f"{r['interval']}", f"{r['operators']:,}",
             f"{r['register_bits']:,}", f"{r['mux_bits']:,}", f"{r['area_um2']:,.0f}"]
            for r in reports.get("culling_area", {"rows": []})["rows"] if r["units"] in (1, 8)]
    header = ["part", "throughput", "units", "cycles an item each", "operators", "register bits", "2:1 mux bits", "um², ASAP7"]
    return page.table(header, rows)


def time_table(reports: Reports) -> str:
    """Time and error of every renderer from the benchmark, and the processor time of the RTL from the simulated frames."""
    rows = []
    for scene in reports.get("bench", {"scenes": []})["scenes"]:
        size = "x".join(map(str, scene["size"]))
        for name, r in scene["renderers"].items():
            rows.append([f"{scene['scene']}, {size}", name, f"{1e3 * r['median_s']:,.1f} ms", f"{r['times_integer']:.2f}",
                         f"{r['psnr_vs_oracle_db']:.1f} dB"])
    for r in reports.get("frames", {"rows": []})["rows"]:
        if r["merge"] and r["pipeline"] and not r["gaze"]:
            size = "x".join(map(str, r["size"]))
            milliseconds = 1e3 * r["frame_cycles"] / r["cycles_per_cpu_s"]
            rows.append([f"{r['scene']}, {size}", "RTL in Verilator", f"{milliseconds:,.0f} ms of one core", "-",
                         "equal to the integer golden"])
    return page.table(["frame", "renderer", "time", "times the integer golden's", "against the oracle"], rows)


TABLES: dict[str, Callable[[Reports], str | None]] = {
    "results": results_table, "units": units_table, "accuracy": accuracy_table, "frames": frames_table,
    "machine": machine_table, "sorting": sorting_table, "culling": culling_table,
    "order": order_table, "shared": shared_table, "time": time_table, **TRAINING_TABLES, **REPORT_TABLES,
    **HEADLINE_TABLES,
}
"""The tables by name. A function returns None if its report is missing, and then the page keeps its table."""


PAGES = (ROOT / "README.md", DOCS / "results.md", DOCS / "units.md")
"""The pages in which these tables stand."""


def fill(path: Path, reports_folder: Path, *, check: bool = False) -> int:
    """Rewrites the generated tables of a page. With `check` it writes nothing, and returns 1 if the page would change.

    Raises:
        InputError: the page has a marker for an unknown table.
    """
    reports = load_reports(reports_folder)
    return page.fill(path, {name: partial(table, reports) for name, table in TABLES.items()}, check=check)
