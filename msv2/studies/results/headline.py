"""The README's own tables: the main results compared with the paper, and three small tables.

The small tables are about the trade-off between accuracy and time, the hard cases, and the cost of effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from msv2.cases.case import COLUMNS
from msv2.studies.accuracy.study import BUDGETS_DB, of_scenes, worst_db
from msv2.studies.memory import IDEAL, LPDDR3, cycles_cells, cycles_heads
from msv2.studies.page import table
from msv2.studies.performance.summary import geomean
from msv2.studies.tradeoff.knobs import base_of, preset_label
from msv2.studies.training import labels
from spec.config import MACHINES, PAPER, PAPER_BASE, PRESETS, V3, V3_STREAMS_PACKED
from spec.overrides import config_from_record

Reports = Mapping[str, Mapping[str, Any]]
Row = tuple[str, str, str, str]

RENDERERS = {"oracle": "float64 oracle", "golden": "integer golden renderer", "gradient": "differentiable renderer",
             "rtl": "RTL of the machine"}
"""The full names of the renderers in `msv2.cases.case.COLUMNS`."""

RATIOS = ("golden_ratio", "simulation_ratio", "cycles_ratio", "energy_ratio", "area_ratio")


def headline_table(reports: Reports) -> str | None:
    """The paper's results and ours, in at most twelve rows, which include the large misses. None if a report is missing."""
    needed = ("frames", "accuracy", "model", "area", "performance", "training", "v3")
    if any(name not in reports for name in needed):
        return None
    head = ["quantity", "paper", "ours", "why they differ"]
    return table(head, [
        *_exactness(reports), *_area(reports["area"]), _clock(reports["area"], reports.get("machine_timing")),
        *_speed(reports["performance"]), *_our_machine(reports["v3"]), *_training(reports)])


def _exactness(reports: Reports) -> Iterable[Row]:
    frames = [row for name in ("frames", "frames_v3", "frames_streams", "frames_eyes")
              for row in reports.get(name, {}).get("rows", ())]
    views = of_scenes(reports["accuracy"]["rows"], trained=False)
    machines = " and ".join(f"`{_machine(reports[name])}`" for name in ("frames", "frames_v3") if name in reports)
    exact, pixels = sum(f["bit_exact"] for f in frames), sum(f["pixels_checked"] for f in frames)
    yield ("frames of the RTL equal to the golden renderer", "-", f"{exact} of {len(frames)}",
           f"every bit of {pixels:,} pixels, and every counter, on {machines}"
           + (", also with four arrays and packed frames" if "frames_streams" in reports else "")
           + (", and of both eyes in one list" if "frames_eyes" in reports else "")
           + _combinations(reports.get("combinations"))
           + _proofs(reports.get("formal"), reports.get("mutants")))
    worst = {records: worst_db(views, records) for records in BUDGETS_DB}
    yield ("integer golden renderer against float64", "-", f"{worst['wide']:.1f} dB or more; {worst['compact']:.1f} dB with "
           "compact records", f"the worst of {sum(row['records'] == 'wide' for row in views)} views; the budgets are "
           f"{BUDGETS_DB['wide']:.0f} and {BUDGETS_DB['compact']:.0f} dB{_on_the_trained_scene(reports)}")
    model = reports["model"]["summary"]
    yield ("cycle model against the RTL", "-", f"{100 * model['model_error_total']:.2f} % off at worst",
           f"total cycles of {model['frames']} frames")


def _combinations(report: Mapping[str, Any] | None) -> str:
    """The frames of small machines with every combination of what machines can have, inside a sentence."""
    if report is None:
        return ""
    frames = sum(row["frames"] for row in report["rows"] if not row["problems"])
    return f"; and {frames} frames of small machines in all combinations"


def _proofs(formal: Mapping[str, Any] | None, mutants: Mapping[str, Any] | None) -> str:
    """How much is proven for all inputs, and how many faults in circuits the tests notice, as the end of a sentence; empty
    where it is not known."""
    proofs = f"; {formal['proven']} claims about {formal['units']} units are proven for all inputs" if formal else ""
    return proofs + (f"; tests notice {mutants['killed']:,} of {mutants['judged']:,} faults in circuits" if mutants else "")


def _on_the_trained_scene(reports: Reports) -> str:
    """The worst PSNR of each format of records on the trained scene, as the end of a sentence; empty if it is not measured."""
    views = of_scenes(reports["accuracy"]["rows"], trained=True)
    return f"; {worst_db(views, 'wide'):.1f} and {worst_db(views, 'compact'):.1f} dB on the trained scene" if views else ""


def _machine(report: Mapping[str, Any]) -> str:
    """The name that the machine of a report of frames has today; that in its rows, if its parameters are not known."""
    record = (report.get("provenance", {}).get("configuration") or {}).get("config")
    if record is None:
        return str(report["rows"][0]["config"])
    made = config_from_record(record)
    return next((config.name for config in MACHINES.values() if config.with_(name=made.name) == made), made.name)


def _area(area: Mapping[str, Any]) -> Iterable[Row]:
    build, paper = area["builds"]["1ghz"], area["paper"]
    yield ("area at 16 nm, and SRAM in it", f"{paper['mm2_16nm']:.2f} mm², {paper['split']['SRAM']:.2f} mm²",
           f"{build['mm2_16nm']:.3f} mm², {area['split']['SRAM']:.3f} mm²",
           "scaled from ASAP7 cells, no wires; the paper's is laid out. Our goal of 1.2 mm² is missed: without the warp "
           f"unit's memories it is {build['mm2_16nm_without_warp_memories']:.3f} mm². Our SRAM has counters, cache, queues "
           "and sorter; the paper's 1 KB line buffers and a 64 KB buffer")


def _clock(area: Mapping[str, Any], linked: Mapping[str, Any] | None) -> Row:
    """The clock of units by themselves, and that of the machine `paper` linked as one where it is measured."""
    build = area["builds"]["1ghz"]
    alone = build["clock_ghz_16nm_constraint"]
    why = (f"1 GHz in ASAP7, scaled; with {100 * (area['wire_derate'] - 1):.0f} % for wires "
           f"{build['clock_ghz_with_wires']:.2f} GHz in ASAP7")
    if linked is None:
        return "clock", "-", f"{alone:.2f} GHz at 16 nm", why
    typical, slow = (linked["machines"][PAPER.name][corner]["ghz"] for corner in ("typical", "slow"))
    return ("clock", "-", f"{alone * typical:.2f} GHz at 16 nm",
            f"{typical:.2f} GHz in ASAP7 for the linked machine, with {linked['uncertainty']:.0%} clock uncertainty, scaled, "
            f"without wires; {slow:.2f} at the slow corner")


def _speed(performance: Mapping[str, Any]) -> Iterable[Row]:
    found = {row["what"]: row for row in performance["beside_paper"]}

    def row(begin: str, title: str, why: str, alike: bool = True) -> Row:
        kept = next(row for what, row in found.items() if what.startswith(begin))
        times = {memory: f"{value:.2f}x" for memory, value in kept["ours"].items()}
        first, rest = times[LPDDR3], {memory: value for memory, value in times.items() if value != times[LPDDR3]}
        ours = "; ".join((first, *(f"{value} with {'an ideal' if memory == IDEAL else 'unlimited'} memory"
                                   for memory, value in rest.items())))
        return title, f"{kept['paper']:.2f}x", ours, f"{'missed: ' * (alike and kept['ours'][LPDDR3] < kept['paper'])}{why}"

    ours = performance["equal_area_supertiles"]
    wires = geomean(row["speedup_bound"] for row in ours if row["memory"] == LPDDR3)
    base, before = (next(row["ours"][LPDDR3] for what, row in found.items() if what.startswith(begin)) for begin in (
        f"rendering: merging + pipelining over `{PAPER_BASE.name}`", "merging + pipelining over GSCore-like"))
    yield row("rendering: merging + pipelining", "tile merging and pipelining, rendering phase",
              f"our baseline streams through its sorter and {PAPER.sort_buffer_bytes // 1024} KB of buffers, so that it hardly "
              f"waits, and four channels of LPDDR3-1600 limit it. Over `{PAPER_BASE.name}`, the paper's as "
              f"we read it: {base:.2f}x")
    yield row("two eyes: with warping", "second eye warped, over both rendered",
              "the geometry phase of the second eye is not spared, and most of its tiles are in the fovea or have holes")
    yield row(f"`{V3.name}` over GSCore-like at equal area", f"`{V3.name}` over a GSCore-like machine of equal area",
              f"`{PAPER.name}`: {before:.2f}x. Ours is {ours[0]['mm2_16nm']:.2f} mm², the paper compares at "
              f"{ours[0]['large_mm2_16nm']:g} mm². With LPDDR3, it is given the bytes a cycle that ours gets; with all that "
              f"the wires can move, ours is {wires:.2f}x as fast")
    yield row("base over the mobile GPU", "baseline over a mobile GPU",
              "not like for like: the paper measured a GPU, ours is its roofline, which no GPU reaches", alike=False)


def _our_machine(v3: Mapping[str, Any]) -> Iterable[Row]:
    step, whole = v3["steps"]["supertiles"], v3["steps"].get("streams")
    title = "frames of our machine over `paper`"
    if whole is None:
        yield title, "-", _gains(step), f"`{V3.name}`: records are gathered by super-tile and projected again"
        return
    yield (title, "-", _gains(whole),
           f"`{V3_STREAMS_PACKED.name}`: records are gathered by super-tile and projected again, four arrays, packed frames. "
           f"`{V3.name}`: {step['lpddr3_gain']:.2f}x. Two eyes in one list: {whole['two_eyes_gain']:.2f}x")


def _gains(step: Mapping[str, Any]) -> str:
    return f"{step['lpddr3_gain']:.2f}x; {step['ideal_gain']:.2f}x with an ideal memory"


def _training(reports: Reports) -> Iterable[Row]:
    scenes = [s for name in ("training", "training_fern") for s in reports.get(name, {}).get("scenes", ()) if "ablation" in s]
    rows = {scene["scene"]: {row["name"]: row for row in scene["ablation"]} for scene in scenes}

    def each(value: Callable[[Mapping[str, Any]], str]) -> str:
        return ", ".join(f"{value(found)} ({name})" for name, found in rows.items())

    def share(found: Mapping[str, Any]) -> str:
        pruned = found.get(labels.PRUNED) or found[labels.PRUNED_BY_CE]
        return f"{100 * pruned['storage_mb'] / found[labels.DENSE]['storage_mb']:.1f} %"

    def speed(found: Mapping[str, Any]) -> str:
        return f"{found[labels.DENSE]['frame']['cycles'] / found[labels.ENHANCED]['frame']['cycles']:.2f}x"

    least = labels.TARGET_PSNR_PERCENT["H"]
    size, times = labels.PAPER_SIZE_PERCENT[labels.PRUNED], labels.PAPER_SPEED[labels.ENHANCED]
    today = _largest(reports.get("training_headline", {}).get("rows", ()))
    if not today:
        points = " and ".join(f"{found[labels.DENSE]['points']:,}" for found in rows.values())
        yield ("model left by pruning, of the dense one", f"{size:g} %", each(share),
               f"missed: our dense models are capped at {points} points, so that fewer of them are superfluous")
        yield ("pruned and foveated over the dense model", f"{times:.1f}x", each(speed),
               "missed for the same reason; cycles of the integer renderer's frames against a GPU's seconds")
        return
    names = [f"({row['scene']} {row['size']})" for row in today]
    yield ("model left by pruning, of the dense one", f"{size:g} %",
           ", ".join(f"{100 * row['l1_points_of_dense']:.1f} % {name}" for row, name in zip(today, names, strict=True)),
           f"{_missed(name for row, name in zip(today, names, strict=True) if _falls_short(row, size))}"
           f"at {100 * min(row['l1_psnr_share'] for row in today):.2f} % of the dense PSNR (H: {least:g} %); "
           f"{_seeds(min(len(row['seeds']) for row in today))}")
    yield ("pruned and foveated over the dense model", f"{times:.1f}x",
           ", ".join(f"{row['cut_foveated']:.2f}x {name}" for row, name in zip(today, names, strict=True)),
           f"{_missed(name for row, name in zip(today, names, strict=True) if row['cut_foveated'] < times)}"
           "intersections, the paper's are seconds")


def _largest(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of each scene's rows of variant H, the one with the largest frames."""
    largest: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        if row["variant"] == "H" and _pixels(row) > _pixels(largest.get(row["scene"], {"size": "0x0"})):
            largest[row["scene"]] = row
    return list(largest.values())


def _falls_short(row: Mapping[str, Any], size: float) -> bool:
    """Whether a row's L1 has a larger share of the dense model's points than `size` percent, or less PSNR than H asks for."""
    return 100 * row["l1_points_of_dense"] > size or 100 * row["l1_psnr_share"] < labels.TARGET_PSNR_PERCENT["H"]


def _pixels(row: Mapping[str, Any]) -> int:
    width, height = row["size"].split("x")
    return int(width) * int(height)


def _seeds(count: int) -> str:
    return "one seed" if count == 1 else f"{count} seeds"


def _missed(names: Iterable[str]) -> str:
    """The begin of a sentence that says where a number of the paper is not reached; empty if it is everywhere."""
    found = [name.strip("()").split()[0] for name in names]
    return f"missed on {', '.join(found)}; " if found else ""


def tradeoff_table(reports: Reports) -> str | None:
    """The time that accuracy costs, in at most six rows: the default machine, the presets, trained levels, and two eyes."""
    if "tradeoff" not in reports:
        return None
    base = base_of(reports["tradeoff"])
    shown = {("default", ""): f"`{base.name}`", **{("preset", name): preset_label(base, name) for name in PRESETS},
             ("variant", "H"): f"`{base.name}`, four trained levels",
             ("ecc_thresh", "18 degrees"): f"`{PAPER.name}`, second eye warped"}
    found, rows = reports["tradeoff"]["machine"], []
    eyes = next((r["cycles"] for r in found if (r["knob"], r["value"]) == ("ecc_thresh", "both rendered")), None)
    for row in found:
        name = shown.get((row["knob"], row["value"]))
        if name is None:
            continue
        speed = f"{eyes / row['cycles']:.2f} (of two eyes)" if row["knob"] == "ecc_thresh" and eyes else f"{row['speedup']:.2f}"
        area = "-" if row["area_mm2"] is None else f"{row['area_mm2']:.3f}"
        broken = f"{row['worst_error_255']:.1f}" + (f", {len(row['broken'])} broken" if row["broken"] else "")
        rows.append((list(shown.values()).index(name), [name, *cycles_cells(row), speed, area, f"{row['loss_db']:+.3f}",
                                                        f"{100 * row['hvsq_change']:+.1f} %", broken]))
    return table(["machine", *cycles_heads(found), "speed", "mm², one eye", "loss of PSNR, dB", "change of HVSQ",
                  "worst hard case, /255"], [cells for _, cells in sorted(rows)])


def stability_table(reports: Reports) -> str | None:
    """The results of the hard cases and of the seeded faults, by renderer."""
    if "stability" not in reports:
        return None
    report, rows = reports["stability"], []
    for column in COLUMNS:
        cells = [case["columns"][column] for case in report["results"].values() if column in case["columns"]]
        run = [cell for cell in cells if cell["outcome"] != "-"]
        passed = sum(cell["outcome"] == "pass" for cell in run)
        errors = [cell["error"] for cell in run if cell["error"] is not None]
        faults = [fault["caught"] for fault in report["faults"] if fault["column"] == column]
        against = "0 to the golden renderer" if column == "rtl" and not any(errors) else (
            f"{255 * max(errors):.1f} to the oracle" if errors else "-")
        rows.append([RENDERERS[column], f"{passed} of {len(run)}", against, f"{sum(faults)} of {len(faults)}"])
    rows.append(["all", f"{report['cases'] - report['failed']} of {report['cases']}", "",
                 f"{report['seeded_faults_caught']} of {report['seeded_faults']}"])
    return table(["renderer", "cases passed", "worst difference of a picture, /255", "seeded faults caught"], rows)


def effects_table(reports: Reports) -> str | None:
    """The cost that frames avoid: the ratio of running all effects except a second eye to running only the needed ones."""
    if "effects" not in reports:
        return None
    rows, head = [], ("frame", "effects called for", "golden renderer's time", "simulation's time", "cycles", "energy", "area")
    for row in reports["effects"]["rows"]:
        called = [name for name, effect in row["effects"]["effects"].items() if effect["state"] == "called for"]
        rows.append([row["frame"], ", ".join(called) or "nothing",
                     *(f"{row[name]:.2f}x" if name in row else "-" for name in RATIOS)])
    return table(head, rows)


HEADLINE_TABLES: dict[str, Callable[[Reports], str | None]] = {
    "headline": headline_table, "tradeoff": tradeoff_table, "stability": stability_table, "effects": effects_table}
"""The tables by name. A function returns None if a report is missing."""
