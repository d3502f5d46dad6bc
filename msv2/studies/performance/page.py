"""The performance report in Markdown. Every number in it comes from the report's JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from msv2.studies import page as pages
from msv2.studies.memory import ALL_NAMES, IDEAL, LPDDR3, UNLIMITED
from msv2.studies.performance.machines import (
    BASE,
    BOTH,
    GPU,
    GSCORE,
    LOCKSTEP,
    MACHINES,
    MEMORIES,
    PEAK,
    SUPER,
    SUPER_BASE,
    TWO_BASE,
    TWO_BOTH,
    WARPING,
    WHOLE,
)
from msv2.studies.performance.summary import PAPER, SAME_RATE, geomean
from msv2.studies.performance.tiles import NEVER, READINGS
from spec.config import V3_RECORDS

NONE = "-"

table = partial(pages.table, left=1)

_SAME_RATE = SAME_RATE[0].upper() + SAME_RATE[1:]

COLUMNS = (*(m.name for m in MACHINES), LOCKSTEP.name, SUPER_BASE, SUPER, WARPING, GSCORE, GPU)


def page(content: Mapping, pictures: Sequence[str]) -> str:
    """The whole page."""
    sections = {
        "The paper and ours": _paper(content), "What was to be reached": _goals(content),
        "Speed over base": _speeds(content, "speedup"),
        "Speed of the rendering phase over base's": _speeds(content, "speedup_render"),
        "Steps of the machine": _steps(content), "The paper's base": _lockstep(content),
        "Frames and floors": _frames(content), "Two eyes": _two_eyes(content),
        "GSCore-like machine at equal area": _gscore(content) + _picture("area", pictures),
        "Mobile GPU": _gpu(content), "Energy": _energy(content) + _picture("bars", pictures), "Full HD": _full_hd(content),
        "Splats in a tile": _tiles(content) + _picture("tiles", pictures),
        "Hand-over": _timeline(content) + _picture("timeline", pictures),
        "Memory": _memory(content) + _picture("bandwidth", pictures), "Sweeps": _sweeps(content) + _picture("sweeps", pictures)}
    parts = ["# Performance", _intro(content), *(f"## {title}\n\n{text}" for title, text in sections.items())]
    return "\n\n".join(parts) + "\n"


def _picture(name: str, pictures: Sequence[str]) -> str:
    return f"\n\n![{name}](performance_{name}.png)" if name in pictures else ""


def _where(row: Mapping) -> str:
    return ALL_NAMES[row["memory"]]


def _number(value: float | None, digits: int = 2) -> str:
    return NONE if value is None else f"{value:,.{digits}f}"


def _run(frame: Mapping, machine: str, memory: str) -> Mapping:
    return next(r for r in frame["runs"] if (r["machine"], r["memory"]) == (machine, memory))


def _intro(content: Mapping) -> str:
    error = content["model_error"]
    missing = f" Not there, and left out: {', '.join(content['missing'])}." if content["missing"] else ""
    checked = (f" Its cycles are within {100 * error['total']:.2f} % of the RTL's in {error['frames']} frames "
               "(reports/model.md)." if error else "")
    return (
        f"Commit {content['commit']}; machine `{content['config']}`, {content['clock_hz'] / 1e9:g} GHz; written by "
        f"`{content['command']}`. How it is found, what is modelled and what is assumed: [reports.md](../docs/reports.md). "
        f"Frames are {content['size']}, {content['levels']} levels, the gaze in the centre, by the cycle model, with "
        f"{ALL_NAMES[LPDDR3]} (the paper's memory). Two ideal memories stand beside it as bounds: one of the same bandwidth "
        f"({ALL_NAMES[IDEAL]}), and one that moves a beat read and a beat written in a cycle ({ALL_NAMES[UNLIMITED]})."
        f"{checked} Levels of {', '.join(content['trained']) or 'no scene'} are trained, of the others random nested subsets."
        f"{missing}")


def _paper(content: Mapping) -> str:
    rows = [(r["what"], _number(r["paper"]), *(_number(r["ours"][memory]) for memory in MEMORIES), r["why"])
            for r in content["beside_paper"]]
    head = ("geomean", "paper", *(f"ours, {ALL_NAMES[memory]}" for memory in MEMORIES), "why they differ")
    return table(head, rows, words=head[-1:])


def _goals(content: Mapping) -> str:
    rows = [(g["goal"], f"{'≥' if g['least'] else '≤'} {g['wanted']:.2f}", _number(g["found"], 3),
             "yes" if g["reached"] else "**no**", f"{g['frames']}")
            for g in content["goals"]]
    return table(("goal", "wanted", "found", "reached", "frames"), rows)


def _speeds(content: Mapping, key: str) -> str:
    shown = COLUMNS if key == "speedup" else COLUMNS[:-1]
    rows = []
    for memory, name in ALL_NAMES.items():
        for frame in content["frames"]:
            rows.append((frame["name"], name, *(_number(_run(frame, m, memory)[key], 3) for m in shown)))
        means = [next(r for r in content["means"] if r["machine"] == m and r["memory"] == memory) for m in shown]
        rows.append(("**geomean**", name, *(f"**{_number(r[key], 3)}**" for r in means)))
    return table(("frame", "memory", *shown), rows, left=2) + (
        f"\n\nWith warping: two eyes over base with two rendered eyes. `{SUPER}` has lists by super-tile, and the bounds of a "
        "camera that stands still; with double buffers it merges no lists, either (`--pipeline 0 --merge 0`). "
        f"{_SAME_RATE}.")


def _steps(content: Mapping) -> str:
    """The whole machine, what it loses without each step, and what its stages do."""
    shown, names = (LPDDR3, IDEAL), [ALL_NAMES[memory] for memory in (LPDDR3, IDEAL)]
    rows = [(f"`{row['machine']}`", row["without"] or "nothing",
             *(_number(row[key][memory], 3) for key in ("over_source", "of_whole") for memory in shown),
             *(_number(row[key], 3) for key in ("bytes_gain", "energy_gain", "mm2_16nm")),
             *(_number(row["gscore_like_gain"][memory]) for memory in shown)) for row in content["steps"]]
    head = ("machine", "without",
            *(f"speed over {of}, {name}" for of in (f"`{content['config']}`", "the first") for name in names),
            "bytes, times fewer", "energy, times less", "mm² at 16 nm",
            *(f"over GSCore-like of equal area, {name}" for name in names))
    busy = []
    for frame in content["frames"]:
        for memory in shown:
            run = _run(frame, WHOLE, memory)
            most = sorted(run["busy"].items(), key=lambda stage: -stage[1])[:3]
            busy.append((frame["name"], ALL_NAMES[memory], f"{run['cycles']:,}", f"{run['geometry']:,}", f"{run['render']:,}",
                         f"{100 * run['dram_bytes'] / (PEAK[memory] * run['cycles']):.0f}", f"{100 * run['array']:.0f}",
                         ", ".join(f"{name} {100 * share:.0f}" for name, share in most)))
    return (
        "Geometric means over the frames. The first machine has everything that is built for one eye: four arrays, packed "
        "frames, lists by super-tile with depth buckets, compact records in chunks. Each row below takes one step away. From "
        f"`{V3_RECORDS.name}` on, a machine also lacks all that needs this step; the last one is the source. Bytes and energy "
        f"of chip and DRAM are with {ALL_NAMES[LPDDR3]}, over `{content['config']}`. Areas are synthesised where "
        "reports/area.json has the build, and else estimated (`msv2.studies.area.estimate`); the GSCore-like machine is scaled "
        f"to each of them. {_SAME_RATE}.\n\n" + table(head, rows, left=2) +
        f"\n\nWhat bounds a frame of `{WHOLE}`, in per cent: the share of the memory's peak that it gets, the share of the "
        "rendering phase in which its arrays work, and its busiest stages with the share of the frame in which they do.\n\n"
        + table(("frame", "memory", "cycles", "geometry", "rendering", "memory", "arrays", "busiest stages"), busy, left=2,
                words=("busiest stages",)))


def _lockstep(content: Mapping) -> str:
    """The paper's baseline as we read it: what its swap costs by sorter and array alone, and what the machine takes."""
    rows, every = [], {name: [] for name in (*READINGS, *MEMORIES)}
    for frame in content["frames"]:
        alone = frame["tile_granular"]
        found = {name: alone[name] / alone[NEVER] for name in READINGS}
        found |= {m: _run(frame, LOCKSTEP.name, m)["render"] / _run(frame, BOTH.name, m)["render"] for m in MEMORIES}
        for name, value in found.items():
            every[name].append(value)
        rows.append((frame["name"], f"{alone[NEVER]:,}", *map(_number, found.values())))
    rows.append(("**geomean**", "-", *(f"**{_number(geomean(values))}**" for values in every.values())))
    head = ("frame", "cycles that never wait", *READINGS,
            *(f"`{LOCKSTEP.name}` over {BOTH.name}, {ALL_NAMES[memory]}" for memory in MEMORIES))
    return (
        f"The paper's base has double buffers between stages, and merging and pipelining together are {PAPER['speedup']:.2f} "
        "times as fast. Its text gives neither the sorter's rate nor the rule by which buffers swap, so that how long it waits "
        f"is a matter of reading. `{LOCKSTEP.name}` is ours, in RTL and in the cycle model: one tile in each half before and "
        "behind the sorter, swapped when all stages are done.\n\n" + table(head, rows) +
        "\n\nRendering phase. The first columns count the cycles of sorter and array alone, without latencies and memory, over "
        "those of the busier one: " + "; ".join(f"*{name}*: {what}" for name, what in READINGS.items()) + ". The last ones "
        "are of the cycle model.")


def _frames(content: Mapping) -> str:
    rows = []
    for frame in content["frames"]:
        for memory in MEMORIES:
            for machine in (LOCKSTEP.name, BASE.name, BOTH.name, SUPER_BASE, SUPER):
                r = _run(frame, machine, memory)
                rows.append((frame["name"], ALL_NAMES[memory], machine, f"{frame['points']:,}", f"{frame['entries']:,}",
                             f"{r['cycles']:,}", f"{r['geometry']:,}", f"{r['render']:,}",
                             _number(r["floor"] and r["cycles"] / r["floor"]),
                             f"{100 * r['array']:.0f} %", f"{r['dram_bytes'] / 1e6:.2f}", f"{r['frames_per_s']:,.0f}"))
    head = ("frame", "memory", "machine", "points", "entries", "cycles", "geometry", "rendering", "over floor", "array busy",
            "MB", "frames/s")
    return table(head, rows, left=3) + (
        "\n\nFloor: each phase by its busiest part (culling, sorting, array, memory) that never waits. It is not known for "
        f"`{SUPER}`. Array busy: of the rendering phase.")


def _two_eyes(content: Mapping) -> str:
    rows = []
    for frame in content["frames"]:
        for memory in MEMORIES:
            base, both, warp = (_run(frame, m, memory) for m in (TWO_BASE, TWO_BOTH, WARPING))
            rows.append((frame["name"], ALL_NAMES[memory], f"{100 * frame['target_rendered']:.0f} %", f"{base['cycles']:,}",
                         f"{both['cycles']:,}", f"{warp['cycles']:,}", _number(warp["speedup"], 3),
                         _number(both["cycles"] / warp["cycles"], 3), _number(warp["cycles"] / warp["floor"]),
                         _number(warp["energy_ratio"], 3)))
    head = ("frame", "memory", "tiles of the second eye rendered", "base, both rendered", "all, both rendered", "all, warping",
            "over base", "warping alone", "over floor", "energy of base over it")
    return table(head, rows, left=2)


def _gscore(content: Mapping) -> str:
    if not content["equal_area"]:
        return ("No reports/area.json is there (`make report-area`), so areas are not known; at the published size the machine "
                "is in the tables of speed.")
    parts = [f"`{content['config']}`:\n\n{_equal(content['equal_area'])}"]
    if content["equal_area_whole"]:
        parts.append(f"`{WHOLE}`, whose area is an estimate:\n\n{_equal(content['equal_area_whole'])}")
    if content["equal_area_supertiles"]:
        parts.append(f"`{SUPER}`:\n\n{_equal(content['equal_area_supertiles'])}")
    else:
        parts.append(f"The area report has no build of `{SUPER}`, so that it is not compared at equal area.")
    return "\n\n".join(parts) + (
        f"\n\nAreas are at 16 nm for one eye ({content['area_source']}). Scaled machines of ours are of the report's groups: "
        "array with cores, culling and colour with units, all else and memories as they are; an array larger than a tile is "
        "not modelled, so the curve ends at the paper's resources.")


def _equal(equal: Sequence[Mapping]) -> str:
    """One of our machines and GSCore scaled to its area."""
    rows = [(e["frame"], _where(e), f"{e['ours_cycles']:,}", f"{e['gscore_cycles']:,}",
             _number(e["speedup"]), _number(e["speedup_render"]), _number(e["speedup_over_large"]),
             *(f"{e[key] / 1e6:.2f}" for key in ("ours_dram_bytes", "gscore_dram_bytes")))
            for e in equal]
    first, means = equal[0], []
    for memory in MEMORIES:
        mine = [e for e in equal if e["memory"] == memory]
        frame, render, large = (geomean(e[key] for e in mine) for key in ("speedup", "speedup_render", "speedup_over_large"))
        means.append(f"{ALL_NAMES[memory]}: {frame:.2f}, in rendering {render:.2f}, over the large one {large:.2f}")
    return table(("frame", "memory", "ours, cycles", "GSCore-like", "speedup", "in rendering",
                  f"over GSCore-like of {first['large_mm2_16nm']:g} mm²", "ours, MB", "GSCore-like, MB"),
                 rows, left=2) + (
        f"\n\nGeomeans, {'; '.join(means)}. {_SAME_RATE}; if it got all that the wires can move, ours would be "
        f"{geomean(e['speedup_bound'] for e in equal if e['memory'] == LPDDR3):.2f} times as fast. Ours takes "
        f"{first['mm2_16nm']:.3f} mm²; GSCore is scaled to that, {first['factor']:.2f} times the published units.")


def _gpu(content: Mapping) -> str:
    rows = []
    for frame in content["frames"]:
        gpu, ours = _run(frame, GPU, LPDDR3), _run(frame, BOTH.name, LPDDR3)
        rows.append((frame["name"], _number(gpu["frames_per_s"], 0), _number(ours["frames_per_s"], 0),
                     _number(ours["frames_per_s"] / gpu["frames_per_s"])))
    published = [(p["what"], _number(p["fps"], 1), p["source"]) for p in content["gpu_published"]]
    return table(("frame", "GPU's roofline, frames/s (modelled)", "ours, frames/s", "ours over it, at least"), rows) + (
        f"\n\nModelled, not measured: {content['gpu_model']}. Measured by others, on other frames:\n\n"
        + table(("what", "frames/s", "source"), published, words=("source",)))


def _energy(content: Mapping) -> str:
    rows = []
    for frame in content["frames"]:
        for memory in (LPDDR3, IDEAL):
            cells = [_run(frame, m, memory) for m in (BASE.name, BOTH.name, SUPER, TWO_BASE, WARPING)]
            rows.append((frame["name"], ALL_NAMES[memory], *(f"{r['chip_mj']:.3f} + {r['dram_mj']:.3f}" for r in cells),
                         *(_number(cells[i]["energy_ratio"], 3) for i in (1, 2, 4))))
    head = ("frame", "memory", BASE.name, BOTH.name, SUPER, TWO_BASE, WARPING, "base over both", f"base over {SUPER}",
            "two eyes: base over warping")
    return ("mJ a frame, chip at 16 nm + memory (docs/energy.md). Wires and clock tree are not in it; with the ideal memory, "
            "activates and refreshes are not, either.\n\n" + table(head, rows, left=2))


def _full_hd(content: Mapping) -> str:
    if not content["full_hd"]:
        return "Not made with a SCENE named (`--full-hd 1` does)."
    rows = [(f["frame"], f["memory"], f"{f['points']:,}", f"{f['model_mb']:.1f}", f["quality"], f"{f['cycles']:,}",
             _number(f["frames_per_s"], 1), f"{f['chip_mj']:.2f}", f"{f['dram_mj']:.2f}", _number(f["over_floor"]))
            for f in content["full_hd"]]
    c = content["chip_129"]
    rows.append((f"{c['design']}, {c['node']}", "published", "-", "-", c["model"], "-", _number(c["frames_per_s"], 1),
                 f"{c['chip_mj']:.2f}", "-", "-"))
    head = ("1920x1080", "memory", "points", "model, MB", "quality", "cycles", "frames/s", "chip, mJ", "DRAM, mJ", "over floor")
    scaled, text = content["scaled_clock"], (
        "\n\nNot like for like: the chip is a measured one of 28 nm at 800 MHz with wires and clock tree, and renders every "
        "pixel of a compressed model; ours is modelled at 1 GHz, its energies at 16 nm from netlists, foveated, of another "
        "model.")
    if content["reached_ghz"]:
        text += (f" 1 GHz is the clock of the model; synthesis reaches {content['reached_ghz']:.2f} GHz in ASAP7 so far (zero "
                 "slack of the slowest unit).")
    if scaled:
        rates = ", ".join(f"{f['frame']}, {f['memory']}: {f['scaled_frames_per_s']:.1f}" for f in content["full_hd"])
        text += (f" At {1e3 * scaled:.0f} MHz, which 1 GHz in ASAP7 is at 16 nm by scaling (docs/area.md), frames/s: {rates}. "
                 "LPDDR3 keeps its times in nanoseconds; the ideal memories are slower by as much as the clock.")
    return table(head, rows, left=2, words=("quality",)) + text


def _tiles(content: Mapping) -> str:
    shown = ("least", "quarter", "median", "three_quarters", "most", "mean")
    rows = [(f["name"], *(f"{f['tiles'][key]:,.0f}" for key in shown),
             _number(f["tiles"]["most"] / max(1, f["tiles"]["median"]), 1)) for f in content["frames"]]
    return table(("frame", "least", "quarter", "median", "three quarters", "most", "mean", "most / median"), rows)


def _timeline(content: Mapping) -> str:
    rows = [(t["machine"], f"{t['groups']:,}", f"{t['render']:,}") for t in content["timeline"]["machines"]]
    return table(("machine", "groups", "cycles of rendering"), rows) + (
        f"\n\n{content['timeline']['frame']}, {_where(content['timeline'])}; as traces for "
        f"ui.perfetto.dev in {content['timeline']['folder']}.")


def _memory(content: Mapping) -> str:
    rows = [(r["frame"], r["sweep"], _of(r), f"{r['cycles']:,}", f"{r['render']:,}", f"{r['dram_bytes'] / 1e6:.2f}")
            for r in content["bandwidth"]]
    return table(("frame", "machine", "memory", "cycles", "rendering", "MB"), rows, left=3)


def _of(row: Mapping) -> str:
    """The memory of a row in which the ideal memory has a bandwidth of its own."""
    return f"ideal, {row['value']:g} B a cycle" if row["memory"] == IDEAL else _where(row)


def _sweeps(content: Mapping) -> str:
    by = {}
    for r in content["sweeps"]:
        by.setdefault((r["frame"], r["sweep"], r["value"]), {})[r["memory"]] = r
    rows = [(frame, sweep, "automatic" if value is None else f"{value:,}",
             *(f"{found[memory][key]:,}" for memory in MEMORIES for key in ("cycles", "render")))
            for (frame, sweep, value), found in by.items()]
    head = ("frame", "what", "value",
            *(f"{name}, {where}" for where in ALL_NAMES.values() for name in ("cycles", "rendering")))
    return table(head, rows, left=3)
