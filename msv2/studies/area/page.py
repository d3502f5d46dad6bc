"""The area report as a Markdown page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msv2.studies.area import replaced
from msv2.studies.page import table
from synth.scaling import FO4_PS

_WHY = {
    "array": "falloff by forward differences in the log2 domain: additions in a core, no product but T (1 - alpha); "
             "weights telescope; narrow words in two banks ([array.md](../docs/array.md))",
    "other logic": "culling in floats of 18 and 20 bits, one pipeline instead of eight units; warp unit and bus are in it",
    "SRAM": "counters of tiles, a cache of views, queues in front of memory, the sorter's words, the warp unit's columns; "
            "the paper names line buffers of 1 KB and a double buffer of 64 KB before its sorting unit, made by Arm's compiler",
}


def _numbers(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    return f"{table(head, rows, left)}\n"


def page(report: dict) -> str:
    """The whole page as Markdown."""
    build = report["builds"]["1ghz"]
    intro = (
        f"Commit {report['commit']}; {build['config']}, two eyes, row width {build['row_width']:,}; {build['node']}, cells "
        f"{build['cell_list']}; mapped for {build['mapped_ps']:,.0f} of {build['clock_ps']:,.0f} ps, the rest is clock "
        f"uncertainty; at most {build['runs']} runs of a module; written by `make report-area`. How it is found, and what "
        "is not in it: [area.md](../docs/area.md). mm² are at 16 nm, scaled from the library's node by the factors of "
        f"{report['scaling_source']}.")
    sections = {
        "The paper and ours": _paper(report), "Builds and clocks": _builds(report) + "\n" + _clocks(report) + "\n",
        "Frames at both clocks": _frames(report), "Groups": _groups(build),
        "Lists by super-tile": replaced.section(report), "Units": _units(report), "Memories": _memories(report),
        "Slower than the clock": _late(report)}
    parts = ["# Area", intro, "![area](area.png)", *(f"## {title}\n\n{text.rstrip()}" for title, text in sections.items())]
    return "\n\n".join(parts) + "\n"


def _mm2(value: float) -> str:
    return f"{value:.3f}"


def _count(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"


def _ghz(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _paper(report: dict) -> str:
    ours, paper, build = report["split"], report["paper"], report["builds"]["1ghz"]
    rows = [(part, paper["split"][part], ours[part], why) for part, why in _WHY.items()]
    rows.append(("all", paper["mm2_16nm"], build["mm2_16nm"],
                 f"without the warp unit's memories {_mm2(build['mm2_16nm_without_warp_memories'])}"))
    lines = [(part, f"{theirs:.2f}", _mm2(mine), f"{theirs / mine:.1f}", why) for part, theirs, mine, why in rows]
    theirs, mine = paper["core_um2_16nm"], build["core_um2_16nm"]
    lines.append(("a core of the array, um²", _count(theirs), _count(mine), f"{theirs / mine:.1f}",
                  "with its share of rows, setup and expansion; level blending apart"))
    return _numbers(("mm² at 16 nm", "paper", "ours", "paper / ours", "why"), lines)


def _builds(report: dict) -> str:
    head = ("build", "what it is", "cells", "clock, ps", "mapped for, ps", "mm²", "without warp memories", "logic",
            "um² a core", "worst slack, ps", "GHz at zero slack", "clock at 16 nm, GHz", "zero slack at 16 nm, GHz")
    rows = []
    for name, build in report["builds"].items():
        areas = (build[key] for key in ("mm2_16nm", "mm2_16nm_without_warp_memories", "mm2_16nm_logic"))
        clocks = (build[key] for key in ("clock_ghz_zero_slack", "clock_ghz_16nm_constraint", "clock_ghz_16nm_zero_slack"))
        rows.append((
            f"`{name}`", build["about"], build["technology"], _count(build["clock_ps"]),
            _count(build.get("mapped_ps", build["clock_ps"])), *map(_mm2, areas),
            _count(build["core_um2_16nm"]), _count(build["worst_slack_ps"]), *map(_ghz, clocks)))
    return _numbers(head, rows, left=3)


def _clocks(report: dict) -> str:
    build, factor = report["builds"]["1ghz"], report["delay_to_16nm"]
    text = (f"1 GHz in ASAP7 is {1e3 / factor:,.0f} MHz at 16 nm by the same scaling (delays x {factor:.2f}), before wires; "
            f"x {report['wire_derate']} on delays stands for wires where it is said.")
    if build["late_units"]:
        text += (f" {len(build['late_units'])} units do not meet it: with the slowest, all run at "
                 f"{_ghz(build['clock_ghz_zero_slack'])} GHz in ASAP7 ({_ghz(build['clock_ghz_16nm_zero_slack'])} at 16 nm), "
                 f"{_ghz(build['clock_ghz_with_wires'])} GHz with wires.")
    return text + (" Units are timed each by itself, from registers to registers: what goes through two in one cycle is given "
                   "10 % of the clock before a unit and 5 % behind it.") + _anchors(report["builds"])


def _anchors(builds: dict) -> str:
    """What the two libraries say of the clock at 16 nm; empty where one of the builds is not made."""
    if not {"1ghz", "nangate45"} <= builds.keys():
        return ""
    fine, coarse = builds["1ghz"], builds["nangate45"]
    apart = 100 * abs(coarse["mm2_16nm"] / fine["mm2_16nm"] - 1)
    return (
        f"\n\n**Two anchors.** By these two libraries the areas at 16 nm are {apart:.0f} % apart, and the clocks are not as "
        "close. Delays are counted in those of an inverter with a fan-out of four (FO4). With its slowest unit, ASAP7's build "
        f"{_in_fo4(fine)}; Nangate45's {_in_fo4(coarse)}, and was made for cycles of "
        f"{coarse['clock_ps'] / FO4_PS['nangate45']:.0f} FO4. Which of the two clocks a chip at 16 nm would have is not "
        "known, so both are quoted.")


def _in_fo4(build: dict) -> str:
    """The cycle of a build in FO4, and what its clock is at 16 nm."""
    delay = FO4_PS[build["technology"]]
    return (f"has cycles of {1e3 / build['clock_ghz_zero_slack'] / delay:.0f} FO4 of {delay} ps, which is "
            f"{_ghz(build['clock_ghz_16nm_zero_slack'])} GHz at 16 nm")


def _frames(report: dict) -> str:
    if not report["frames"]:
        return "(no frames)\n"
    rows, scaled = [], 1.0 / report["delay_to_16nm"]
    for row in report["frames"]:
        width, height = row["size"]
        rates = [1e9 * clock / row[cycles] for cycles in ("frame_cycles", "overlapped_cycles") for clock in (1.0, scaled)]
        frame = f"{row['scene']} {width}x{height}, {row['levels']} levels"
        rows.append((frame, _count(row["frame_cycles"]), *map(_count, rates)))
    head = ("frame", "cycles", "a second at 1 GHz", "at the scaled clock", "geometry overlapped, 1 GHz", "scaled clock")
    return _numbers(head, rows) + (
        f"\nCycles of RTL (reports/machine.json) at {report['frames'][0]['bytes_per_cycle']} bytes of memory a cycle: at the "
        "scaled clock the memory is taken to be as much slower.\n")


def _groups(build: dict) -> str:
    keys = ("logic_um2", "memory_um2", "logic_um2_16nm", "memory_um2_16nm", "memory_bits")
    rows = [(name, *(_count(sums[key]) for key in keys)) for name, sums in build["groups"].items()]
    rows.append(("all", *(_count(sum(sums[key] for sums in build["groups"].values())) for key in keys)))
    head = ("group", "logic, um² ASAP7", "memories, um²", "logic, um² at 16 nm", "memories at 16 nm", "memory bits")
    return _numbers(head, rows)


def _units(report: dict) -> str:
    head = ("unit", "group", "logic, um²", "its own", "shared modules", "cells", "flip-flops", "slack, ps", "memory bits",
            "memories, um²", "to 16 nm", "logic, um² at 16 nm", "note")
    rows = []
    for row in report["rows"]:
        shared = sum(part["count"] for part in row["parts"].values())
        numbers = (row["logic_um2"], row["own_um2"], shared, row["cells"], row["flip_flops"], row["slack_ps"],
                   row["memory_bits"], row["memory_um2"])
        rows.append((f"`{row['unit']}`", row["group"], *map(_count, numbers), f"x {row['factor']:.3f}",
                     _count(row["logic_um2_16nm"]), row["note"]))
    return _numbers(head, rows, left=2) + (
        f"\nThe factor is of {report['scaling_source']}. Units without a slack are wires around others.\n")


def _memories(report: dict) -> str:
    head = ("memory", "group", "count", "words", "width", "ports", "bits in all", "made of", "um²", "um² at 16 nm")
    rows = []
    for row in sorted(report["memories"], key=lambda row: -row["count"] * row["bits"]):
        made = ", ".join(f"{count} {name}" for name, count in row["macros"].items()) or row["kind"]
        rows.append((f"`{row['name']}`", row["group"], *map(_count, (row["count"], row["words"], row["width"])),
                     f"{row['reads']}R {row['writes']}W", _count(row["count"] * row["bits"]), made,
                     *map(_count, (row["area_um2"], row["area_um2_16nm"]))))
    sources = list(dict.fromkeys(row["source"] for row in report["memories"] if row["area_um2"]))
    return _numbers(head, rows, left=2) + "\nAreas: " + "; or: ".join(sources) + (
        ". What is said to be part of a unit's logic has its area there.\n")


def _late(report: dict) -> str:
    late = sorted((row for row in report["rows"] if (row["slack_ps"] or 0) < 0), key=lambda row: row["slack_ps"])
    rows = [(f"`{row['unit']}`", _count(row["slack_ps"]), row["path"] or "-") for row in late]
    return _numbers(("unit", "slack, ps", "its worst path"), rows) if rows else "None.\n"
