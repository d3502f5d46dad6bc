"""The tables of docs/results.md about the cycle model, area and energy, performance, two eyes, and effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from golden.host.run_options import IDEAL
from msv2.studies.memory import ALL_NAMES, MEMORY_NAMES, cycles_cells, cycles_heads
from msv2.studies.page import table
from msv2.studies.tradeoff.knobs import base_of, preset_label

SINGLE_EFFECTS = ("sh", "levels", "blend", "depth")


def model_table(reports: dict[str, dict]) -> str | None:
    """The errors of the model against the RTL: in total, by phase and by stage."""
    if "model" not in reports:
        return None
    s = reports["model"]["summary"]
    rows = [["total", f"{100 * s['model_error_total']:.2f} %", f"{100 * s['mean_error_total']:.2f} %", "-"]]
    rows += [[f"total of {found['frames']} frames on {MEMORY_NAMES[kind]}", f"{100 * found['worst']:.2f} %",
              f"{100 * found['mean']:.2f} %", "-"] for kind, found in s.get("memories", {}).items()]
    rows += [[f"phase {name}", f"{100 * worst:.2f} %", "-", "-"] for name, worst in s["phases"].items()]
    rows += [[f"stage {name}", f"{100 * e['worst']:.2f} %", f"{100 * e['mean']:.2f} %", f"{100 * e['within_5_percent']:.0f} %"]
             for name, e in s["stages"].items()]
    return table([f"cycles, {s['frames']} frames", "worst error", "mean", "frames within 5 %"], rows)


def joint_frames_table(reports: dict[str, dict]) -> str | None:
    """Joint frames through the RTL: their cycles, and the error of the model."""
    if "summary" not in reports.get("frames_eyes", {}):
        return None
    rows = [[f"{row['scene']}, {row['size'][0]}x{row['size'][1]}", "4 levels" if row["levels"] > 1 else "-",
             f"`{row['config']}`", row["pixels"], row.get("memory", IDEAL), f"{row['entries']:,}", f"{row['frame_cycles']:,}",
             f"{100 * row['model']['error']:+.2f} %", _exact(row)] for row in reports["frames_eyes"]["rows"]]
    return table(["frame", "foveation", "machine", "pixels", "memory", "intersections of both eyes", "cycles",
                  "error of the model", "every bit and counter"], rows)


def combinations_table(reports: dict[str, dict]) -> str | None:
    """Frames of small machines in every combination of streams, packed frames, overlapped phases and eyes."""
    if "combinations" not in reports:
        return None
    rows = [[
        row["streams"], "overlapped" if row["overlap"] else "in turn", row["eyes"], "packed" if row["packed"] else "display",
        row["frames"], f"{row['cycles']:,}", f"{100 * (row['model_over_rtl'] - 1):+.2f} %",
        "NO" if row["problems"] else "yes"] for row in reports["combinations"]["rows"]]
    return table(["arrays", "phases", "eyes", "pixels", "frames in a row", "cycles of a frame", "error of the model",
                  "every bit and counter"], rows)


def _exact(row: Mapping[str, Any]) -> str:
    """Whether a frame and its counters are equal to golden."""
    return "yes" if row["bit_exact"] and not row["counter_errors"] else "NO"


def presets_table(reports: dict[str, dict]) -> str | None:
    """The default machine and the presets: their cost and their loss of quality on the scene of the tradeoff study."""
    if "tradeoff" not in reports:
        return None
    base, rows = base_of(reports["tradeoff"]), []
    for row in reports["tradeoff"]["machine"]:
        if row["knob"] in ("default", "preset"):
            name = preset_label(base, row["value"]) if row["value"] else f"`{base.name}`"
            area = "-" if row["area_mm2"] is None else f"{row['area_mm2']:.3f}"
            rows.append([
                name, *cycles_cells(row), f"{row['speedup']:.2f}", f"{row['chip_mj']:.4f}",
                f"{row['dram_mj']:.4f}", area, f"{row['loss_db']:+.4f}", f"{100 * row['hvsq_change']:+.2f} %",
                f"{row['worst_error_255']:.1f}"])
    cycles = cycles_heads(reports["tradeoff"]["machine"])
    return table(["configuration", *cycles, "speed", "chip, mJ", "DRAM, mJ", "mm², one eye", "loss, dB", "HVSQ",
                   "worst hard case, /255"], rows)


def depths_table(reports: dict[str, dict]) -> str | None:
    """Errors of disparities and depths against the oracle, for the worst camera of each scene."""
    if "accuracy_stereo" not in reports:
        return None
    rows = {}
    for row in reports["accuracy_stereo"]["rows"]:
        worst = rows.setdefault(row["scene"], row)
        if row["within_budget"] < worst["within_budget"]:
            rows[row["scene"]] = row
    header = ["scene, worst view", "levels", "disparities within 1/8 px", "depths within 0.2 %", "median error of depth"]
    return table(header, [
        [f"{scene}, {r['camera']}", str(r["levels"]), f"{100 * r['within_budget']:.3f} %", f"{100 * r['depth_within']:.2f} %",
         f"{100 * r['depth_error_p50']:.4f} %"] for scene, r in rows.items()])


def threshold_table(reports: dict[str, dict], threshold_deg: float = 18.0) -> str | None:
    """Frames of two eyes at one threshold: means over the poses of each scene."""
    if "table_ecc" not in reports:
        return None
    rows = []
    for scene in reports["table_ecc"]["scenes"]:
        found = [(p, t) for p in scene["poses"] for t in p["thresholds"] if t["threshold_deg"] == threshold_deg]
        if not found:
            continue

        def mean(value: Callable, found: list = found) -> float:
            return sum(value(p, t) for p, t in found) / len(found)

        size = "x".join(map(str, found[0][0]["size"]))
        rows.append([
            f"{scene['scene']}, {size}, {scene['levels']}",
            f"{100 * mean(lambda p, t: t['entries']['floor_share']):.1f} %",
            f"{100 * mean(lambda p, t: t['tiles']['holes'] / t['tiles']['all']):.1f} %",
            f"{mean(lambda p, t: t['cycles']['total'] / p['rendered']['cycles']['source']):.2f}",
            f"{mean(lambda p, t: t['cycles']['total'] / p['rendered']['cycles']['total']):.3f}",
            f"{mean(lambda p, t: t['cycles']['overhead']):.3f}",
            f"{1e5 * mean(lambda p, t: t['hvsq']['dense']['mean']):.2f} "
            f"({1e5 * mean(lambda p, t: p['rendered']['hvsq']['dense']['mean']):.2f})",
        ])
    return table(["scene", "floor: intersections in the fovea", "tiles rendered for holes", "cycles of one eye", "of two eyes",
                   "warping costs", "binocular HVSQ 1e-5 (both rendered)"], rows)


def effects_table(reports: dict[str, dict]) -> str | None:
    """The savings of frames that do not call for all effects."""
    if "effects" not in reports:
        return None
    rows, found = [], reports["effects"]["rows"]
    ratios = ["cycles", "energy", "simulation", *["area"] * any("area_ratio" in row for row in found)]
    for row in found:
        ms, called = row["golden_ms"], [n for n, e in row["effects"]["effects"].items() if e["state"] == "called for"]
        single = [f"{ms[n] - ms['auto']:+.1f}" if n in ms else "called for" for n in SINGLE_EFFECTS]
        rtl = [f"{row[f'{n}_ratio']:.2f}x" if f"{n}_ratio" in row else "-" for n in ratios]
        rows.append([f"{row['frame']}, {row['size']}", ", ".join(called) or "nothing", f"{ms['auto']:.1f}", *single,
                     f"{row['golden_ratio']:.2f}x", *rtl])
    return table(["frame", "called for", "golden, ms", *(f"+ {n}" for n in SINGLE_EFFECTS), "all but a second eye: golden",
                   *ratios], rows)


def effect_areas_table(reports: dict[str, dict]) -> str | None:
    """The area of each effect that has hardware."""
    areas = reports.get("effects", {}).get("areas")
    if not areas:
        return None
    return table(["effect", "machine with it, mm² at 16 nm", "without it", "the effect", "share"], [
        [name, f"{a['with_mm2']:.3f}", f"{a['without_mm2']:.3f}", f"{a['mm2']:z.3f}", f"{a['mm2'] / a['with_mm2']:z.1%}"]
        for name, a in areas.items()])


def area_table(reports: dict[str, dict]) -> str | None:
    """The areas of the paper's machine and of ours at 16 nm, by part."""
    if "area" not in reports:
        return None
    area = reports["area"]
    build, split, paper = area["builds"]["1ghz"], area["split"], area["paper"]
    rows = [[name, f"{paper['split'][name]:.2f}", f"{split[name]:.3f}"] for name in paper["split"]]
    rows += [["all", f"{paper['mm2_16nm']:.2f}", f"{build['mm2_16nm']:.3f}"],
             ["all but the warp unit's memories", "-", f"{build['mm2_16nm_without_warp_memories']:.3f}"],
             ["a core of the array, um²", f"{paper['core_um2_16nm']:,}", f"{build['core_um2_16nm']:,.0f}"]]
    return table(["mm² at 16 nm", "paper", "ours, by scaling"], rows)


def energy_table(reports: dict[str, dict]) -> str | None:
    """The energies of frames."""
    if "energy" not in reports:
        return None
    rows = []
    for f in reports["energy"]["frames"]:
        size = f["size"] if isinstance(f["size"], str) else "x".join(map(str, f["size"]))
        levels = f"{f['levels']} level{'s' if f['levels'] > 1 else ''}"
        rows.append([f"{f['scene']}, {size}, {levels}", MEMORY_NAMES[f["memory"]], f["work"], f"{f['cycles']:,}",
                     *(f"{f[key]:.3f}" for key in ("chip_mj", "dram_mj", "assumed_mj", "total_mj"))])
    return table(["frame", "memory", "work by", "cycles", "chip, mJ", "DRAM, mJ", "wires and clock tree (assumed), mJ",
                  "all, mJ"], rows)


def performance_table(reports: dict[str, dict]) -> str | None:
    """The paper's speedups and ours."""
    if "performance" not in reports:
        return None
    return table(["geomean", "paper", *(f"ours, {name}" for name in ALL_NAMES.values()), "why they differ"], [
        [r["what"], f"{r['paper']:.2f}", *(f"{r['ours'][memory]:.2f}" for memory in ALL_NAMES), r["why"]]
        for r in reports["performance"]["beside_paper"]])


def full_hd_table(reports: dict[str, dict]) -> str | None:
    """Full HD frames, with a published chip for comparison."""
    if "performance" not in reports:
        return None
    p = reports["performance"]
    rows = []
    for f in p["full_hd"]:
        rate = f["frames_per_s"]
        rows.append([f"{f['frame']}, {f['points']:,} points; {f['quality']}", f["memory"], f"{rate:,.0f}",
                     f"{f['scaled_frames_per_s']:,.0f}", f"{f['chip_mj']:.2f}", f"{f['dram_mj']:.2f}"])
    chip = p["chip_129"]
    rows.append([f"{chip['design']}, {chip['node']}, silicon; model {chip['model']}", "its own",
                 f"{chip['frames_per_s']:,.0f}", "-", f"{chip['chip_mj']:.2f}", "-"])
    header = ["1920x1080, four levels", "memory", "frames/s at 1 GHz", f"at {p['scaled_clock']:g} GHz", "chip, mJ", "DRAM, mJ"]
    return table(header, rows)


REPORT_TABLES = {
    "performance": performance_table, "full_hd": full_hd_table, "area": area_table, "energy": energy_table,
    "model": model_table, "joint_frames": joint_frames_table, "combinations": combinations_table,
    "presets": presets_table,
    "depths": depths_table, "threshold": threshold_table, "effects_all": effects_table,
    "effect_areas": effect_areas_table,
}
"""The tables by name. A function returns None where its report is missing."""
