"""What a sweep writes: all results as JSON and CSV, and a diagram of the points that no other point beats."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from golden.scenes.files import atomic_output
from golden.scenes.request import write_json
from msv2.studies.area.estimate import SYNTHESISED
from msv2.studies.picture import find_pyplot, save_figure
from msv2.sweep.points import OF_THE_MACHINE, options

COLUMNS = (
    "frames_per_s", "milliseconds", "cycles", "geometry_cycles", "render_cycles", "mm2", "logic_mm2", "memory_mm2",
    "area_basis", "area_build", "chip_mj", "dram_mj", "wires_mj", "energy_basis", "intersections", "operations", "read_bytes",
    "written_bytes", "array_utilisation")
"""Columns of the CSV behind those of the settings; `msv2.sweep.measure.measure` says what they are."""

UNITS = {"mm2": "area, mm² at 16 nm", "energy_mj": "energy of chip and DRAM, mJ a frame", "frames_per_s": "frames/s"}
PAIRS = (("mm2", "frames_per_s"), ("energy_mj", "frames_per_s"))
"""The diagram's axes: a cost, of which less is better, and a rate, of which more is."""

NAMED_MOST = 8
"""Points of all frontiers of a panel that are labelled."""

LINE = 105
"""Letters of a line below a panel."""


def frontier(rows: Sequence[Mapping[str, object]], cost: str, rate: str) -> list[int]:
    """The rows that no other beats in both: indices in the order of rising cost."""
    order = sorted(range(len(rows)), key=lambda i: (value(rows[i], cost), -value(rows[i], rate)))
    found, best = [], float("-inf")
    for index in order:
        if value(rows[index], rate) > best:
            found.append(index)
            best = value(rows[index], rate)
    return found


def value(row: Mapping[str, object], name: str) -> float:
    """A number of a row; `energy_mj` is what chip and memory take."""
    return float(row["chip_mj"]) + float(row["dram_mj"]) if name == "energy_mj" else float(row[name])


def frame_of(row: Mapping[str, object]) -> str:
    """What is drawn and from what memory, as far as the sweep varies it. Only points that have it in common compete: a machine
    is no better because its memory is faster."""
    return ", ".join(f"{name} {text}" for name, text in row["settings"].items()
                     if name in options() and name not in OF_THE_MACHINE)


def write_all(rows: Sequence[Mapping[str, object]], out: Path, subject: Mapping[str, object]) -> list[Path]:
    """Writes results.json, results.csv and, with matplotlib, pareto.png. Returns the paths."""
    good = [row for row in rows if "error" not in row]
    marks = {pair: set() for pair in PAIRS}
    for frame in dict.fromkeys(map(frame_of, good)):
        places = [i for i, row in enumerate(good) if frame_of(row) == frame]
        for pair in PAIRS:
            marks[pair] |= {places[i] for i in frontier([good[i] for i in places], *pair)}
    made = [out / "results.json", out / "results.csv"]
    listed = [{**row, "pareto": [f"{rate} over {cost}" for cost, rate in PAIRS if i in marks[cost, rate]]}
              for i, row in enumerate(good)]
    write_json(made[0], {**subject, "points": listed, "failed": [row for row in rows if "error" in row]})
    with atomic_output(made[1]) as file:
        file.write(as_csv(listed).encode())
    pyplot = find_pyplot()
    if pyplot and good:
        made.append(out / "pareto.png")
        _draw(pyplot, good, marks, made[-1])
    return made


def as_csv(rows: Sequence[Mapping[str, object]]) -> str:
    """The results as a table: the settings that vary, then COLUMNS, then on which frontiers a point is."""
    settings = list(dict.fromkeys(name for row in rows for name in row["settings"]))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*settings, *COLUMNS, "pareto", "key"])
    for row in rows:
        writer.writerow([*(row["settings"].get(name, "") for name in settings), *(row[name] for name in COLUMNS),
                         "; ".join(row["pareto"]), row["key"]])
    return text.getvalue()


def _draw(pyplot: object, rows: Sequence[Mapping[str, object]], marks: Mapping[tuple[str, str], set[int]], path: Path) -> None:
    """A panel for each pair of axes, with a colour for each frame."""
    figure, panels = pyplot.subplots(1, len(PAIRS), figsize=(7 * len(PAIRS), 6.5), constrained_layout=True)
    frames = list(dict.fromkeys(map(frame_of, rows)))
    for panel, (cost, rate) in zip(panels, PAIRS, strict=True):
        named: list[int] = []
        for number, frame in enumerate(frames):
            places = [i for i, row in enumerate(rows) if frame_of(row) == frame]
            colour = f"C{number % 10}"
            for basis, marker, filled in ((SYNTHESISED, "s", colour), (None, "o", "none")):
                here = [i for i in places if _synthesised(rows[i], cost) == (basis is not None)]
                panel.plot([value(rows[i], cost) for i in here], [value(rows[i], rate) for i in here], marker, color=colour,
                           markerfacecolor=filled, markersize=5, linestyle="none", alpha=0.8)
            front = sorted((i for i in places if i in marks[cost, rate]), key=lambda i: value(rows[i], cost))
            panel.step([value(rows[i], cost) for i in front], [value(rows[i], rate) for i in front], where="post", color=colour,
                       linewidth=1.2, label=frame or "frontier")
            named += _chosen(front, max(2, NAMED_MOST // len(frames)))
        panel.set_xlabel(UNITS[cost])
        panel.set_ylabel(UNITS[rate])
        panel.set_ylim(0, 1.08 * max(value(row, rate) for row in rows))
        panel.grid(alpha=0.3)
        panel.margins(x=0.12)
        panel.legend(fontsize=8, loc="lower right")
        _name(panel, rows, named[:NAMED_MOST], cost, rate)
    figure.suptitle("■ synthesised or measured on the synthesised netlists    ○ estimated from the unit tables", fontsize=9)
    save_figure(figure, path)


def _synthesised(row: Mapping[str, object], cost: str) -> bool:
    return row["area_basis" if cost == "mm2" else "energy_basis"] == SYNTHESISED


def _chosen(front: Sequence[int], most: int) -> list[int]:
    """At most so many points of a frontier, evenly spread."""
    most = min(most, len(front))
    return [front[round(i * (len(front) - 1) / max(1, most - 1))] for i in range(most)]


def _name(panel: object, rows: Sequence[Mapping[str, object]], named: Sequence[int], cost: str, rate: str) -> None:
    """Numbers at the named points, and below the panel the settings that they stand for, where the sweep's points differ."""
    differ = [name for name in rows[0]["settings"] if len({row["settings"][name] for row in rows}) > 1]
    lines = []
    for number, index in enumerate(named, 1):
        beside = (-3, 6) if number % 2 else (6, -4)
        panel.annotate(str(number), (value(rows[index], cost), value(rows[index], rate)), xytext=beside,
                       textcoords="offset points", fontsize=9, fontweight="bold")
        settings = rows[index]["settings"]
        named_there = frame_of(rows[index])  # the legend says it
        text = ", ".join(f"{name.removeprefix('set.')} {settings[name]}" for name in differ
                         if f"{name} {settings[name]}" not in named_there)
        lines += textwrap.wrap(f"{number}  {text}", LINE, subsequent_indent="    ", break_long_words=False)
    panel.set_title("\n".join(lines), y=-0.14, va="top", loc="left", fontsize=7)
