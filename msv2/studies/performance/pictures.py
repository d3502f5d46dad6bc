"""The report's pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from msv2.studies.memory import ALL_NAMES, IDEAL, LPDDR3, UNLIMITED
from msv2.studies.performance.machines import BOTH, GPU, GSCORE, LOCKSTEP, MACHINES, MEMORIES, SUPER, WARPING
from msv2.studies.picture import find_pyplot, save_figure
from perf.model import FrameCycles
from spec.stages import StagePhase, watched

STAGES = tuple(name for name in watched(StagePhase.RENDERING) if name != "list_read")
"""The rows of the timeline."""

SHORT = {LPDDR3: "LPDDR3", UNLIMITED: "unlimited"}
"""Names of memories in long legends."""

STYLES = {LPDDR3: "-", IDEAL: ":", UNLIMITED: "--"}
"""The lines of the memories."""

SHOWN = (*(m.name for m in MACHINES), LOCKSTEP.name, SUPER, WARPING, GSCORE, GPU)


def draw(content: Mapping, timelines: Mapping[str, FrameCycles], folder: Path) -> list[str]:
    """Draws all pictures as performance_*.png. Returns their names; none without matplotlib."""
    pyplot, made = find_pyplot(), []
    if pyplot is None:
        return made
    for name, picture in (("tiles", _tiles), ("timeline", _timeline), ("bars", _bars), ("area", _area),
                          ("bandwidth", _bandwidth), ("sweeps", _sweeps)):
        figure = picture(pyplot, timelines if name == "timeline" else content)
        if figure is not None:
            if figure.get_layout_engine() is None:
                figure.tight_layout()
            save_figure(figure, folder / f"performance_{name}.png", dpi=100)
            made.append(name)
    return made


def _name_ticks(axis, places: Sequence[int], names: Sequence[str]) -> None:
    """Names of frames as ticks: they are turned where there are too many to stand beside each other."""
    turned = len(names) > 3
    axis.set_xticks(places, names, rotation=40 if turned else 0, ha="right" if turned else "center",
                    rotation_mode="anchor" if turned else None, fontsize=9)


def _tiles(pyplot, content: Mapping):
    """Intersections per tile: a map for each frame, and their distribution."""
    frames = content["frames"]
    columns = min(3, len(frames))
    lines = -(-len(frames) // columns)
    figure = pyplot.figure(figsize=(3.8 * columns, 2.4 * lines + 3.2))
    grid = figure.add_gridspec(lines + 1, columns)
    for i, frame in enumerate(frames):
        axis = figure.add_subplot(grid[i // columns, i % columns])
        counts = np.array(frame["tiles"]["counts"]).reshape(-1, frame["tiles"]["across"])
        shown = axis.imshow(np.maximum(counts, 1), norm="log", cmap="inferno")
        figure.colorbar(shown, ax=axis, label="splats in a tile")
        axis.set_title(frame["name"])
        axis.set_axis_off()
    axis = figure.add_subplot(grid[lines, :])
    axis.boxplot([np.maximum(frame["tiles"]["counts"], 1) for frame in frames], whis=(0, 100))
    _name_ticks(axis, range(1, len(frames) + 1), [frame["name"] for frame in frames])
    axis.set_yscale("log")
    axis.set_ylabel("splats in a tile (none as 1)")
    return figure


def _timeline(pyplot, timelines: Mapping[str, FrameCycles]):
    """The same part of the rendering phase on each machine, with a row per stage and a colour per group."""
    figure, axes = pyplot.subplots(len(timelines), 1, figsize=(11, 2.3 * len(timelines)), sharex=True, squeeze=False)
    begins = {name: next(first for stage, _, _, first, _ in f.timeline if stage == "render") for name, f in timelines.items()}
    width = max(f.phases["render"] for f in timelines.values())
    colours = pyplot.get_cmap("tab20").colors
    for axis, (name, frame) in zip(axes[:, 0], timelines.items(), strict=True):
        for place, stage in enumerate(STAGES):
            bars = [(group, first - begins[name], last - first + 1) for found, _, group, first, last in frame.timeline
                    if found == stage and group >= 0]
            axis.broken_barh([bar[1:] for bar in bars], (place - 0.4, 0.8), linewidth=0,
                             facecolors=[colours[bar[0] % len(colours)] for bar in bars])
        axis.set_yticks(range(len(STAGES)), STAGES)
        axis.invert_yaxis()
        axis.set_xlim(0, width)
        axis.axvline(frame.phases["render"], color="black", linewidth=1)
        axis.set_title(f"{name}: {frame.phases['render']:,} cycles of rendering, {frame.groups:,} groups", loc="left")
    axes[-1, 0].set_xlabel("cycle of the rendering phase; a colour is a group of tiles in order")
    return figure


def _bars(pyplot, content: Mapping):
    """Speedup and energy relative to the base machine, for every frame and for the geometric mean."""
    names = [frame["name"] for frame in content["frames"]] + ["geomean"]
    figure, axes = pyplot.subplots(2, 2, figsize=(11, 7.5), squeeze=False, layout="constrained")
    for column, memory in enumerate((LPDDR3, UNLIMITED)):
        for axis, key, shown, label in ((axes[0, column], "speedup", SHOWN, "speed over base"),
                                        (axes[1, column], "energy_ratio", SHOWN[:-2],
                                         "energy, base's over it")):
            for i, machine in enumerate(shown):
                values = [run[key] for frame in content["frames"] for run in frame["runs"]
                          if (run["machine"], run["memory"]) == (machine, memory)]
                values.append(next(row[key] for row in content["means"]
                                   if row["machine"] == machine and row["memory"] == memory))
                width = 0.8 / len(shown)
                axis.bar(np.arange(len(names)) + (i - len(shown) / 2) * width, values, width, label=machine,
                         hatch="//" if machine == GPU else None)
            axis.axhline(1, color="black", linewidth=0.5)
            _name_ticks(axis, range(len(names)), names)
            axis.set_ylabel(label)
            axis.set_title(f"memory: {ALL_NAMES[memory]}")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=9, ncols=4, loc="outside upper center")
    return figure


def _lines(axis, rows: Sequence[Mapping], x: str, y: str, label: str, **style: object) -> None:
    points = [(row[x], row[y]) for row in rows if row[x] is not None]
    axis.plot(*zip(*points, strict=True), marker="o", label=label, **style)


def _area(pyplot, content: Mapping):
    """Frames per second over mm^2; None without an area report."""
    rows = content["iso_area"]
    frames = list(dict.fromkeys(row["frame"] for row in rows))
    if not frames:
        return None
    figure, axes = pyplot.subplots(
        1, len(frames), figsize=(max(6, 3.8 * len(frames)), 4.5), squeeze=False, layout="constrained")
    for axis, frame in zip(axes[0], frames, strict=True):
        for machine, colour in ((BOTH.name, "tab:blue"), (GSCORE, "tab:red")):
            for memory in MEMORIES:
                found = [r for r in rows if (r["frame"], r["machine"], r["memory"]) == (frame, machine, memory)]
                _lines(axis, found, "mm2_16nm", "frames_per_s", f"{machine}, {ALL_NAMES[memory]}", color=colour,
                       linestyle=STYLES[memory])
        axis.set_title(frame)
        axis.set_xlabel("mm² at 16 nm")
    axes[0, 0].set_ylabel("frames a second at 1 GHz")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=9, ncols=2, loc="outside upper center")
    return figure


def _bandwidth(pyplot, content: Mapping):
    """The cycles of a frame over the memory's bandwidth, and the bytes that it moves."""
    rows = content["bandwidth"]
    frames = list(dict.fromkeys(row["frame"] for row in rows))
    figure, axes = pyplot.subplots(
        1, len(frames) + 1, figsize=(max(8, 3 * len(frames) + 3), 4), squeeze=False, layout="constrained")
    machines = list(dict.fromkeys(row["sweep"] for row in rows))
    colours = {machine: f"C{i}" for i, machine in enumerate(machines)}
    for axis, frame in zip(axes[0], frames, strict=False):
        for machine in machines:
            mine = [row for row in rows if row["frame"] == frame and row["sweep"] == machine]
            _lines(axis, [row for row in mine if row["memory"] != LPDDR3], "value", "cycles", f"{machine}, ideal memory",
                   color=colours[machine])
            real = next(row for row in mine if row["memory"] == LPDDR3)
            axis.plot(real["value"], real["cycles"], "*", markersize=14, color=colours[machine], linestyle="none",
                      label=f"{machine}, {ALL_NAMES[LPDDR3]}")
        axis.set_title(frame)
        axis.set_xlabel("bytes of memory a cycle")
        axis.set_ylabel("cycles of a frame")
        axis.set_ylim(bottom=0)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=9, ncols=3, loc="outside upper center")
    for i, machine in enumerate(machines):
        moved = [next(r["dram_bytes"] for r in rows if r["frame"] == frame and r["sweep"] == machine) / 1e6 for frame in frames]
        axes[0, -1].bar(np.arange(len(frames)) + 0.27 * (i - 1), moved, 0.27, label=machine)
    _name_ticks(axes[0, -1], range(len(frames)), frames)
    axes[0, -1].set_ylabel("MB a frame")
    return figure


def _sweeps(pyplot, content: Mapping):
    """Cycles relative to the paper's machine with automatic beta, with a colour per frame; full lines are for LPDDR3, dashed
    ones for unlimited memory.

    The cycles are those of the rendering phase, or of the whole frame where the geometry phase depends on what is changed.
    """
    rows = content["sweeps"]
    names = [name for name in dict.fromkeys(row["sweep"] for row in rows) if name != "beta, double buffers"]
    lines = -(-(len(names) + 1) // 3)
    figure, grid = pyplot.subplots(lines, 3, figsize=(11, 3.6 * lines), layout="constrained", squeeze=False)
    axes, rest = grid.flat[: len(names)], grid.flat[len(names):]
    whole = {(r["frame"], r["memory"]): r for r in rows if r["sweep"] == "beta, line buffers" and r["value"] is None}
    for axis, name in zip(axes, names, strict=True):
        key = "cycles" if "units" in name else "render"
        for colour, frame in enumerate(dict.fromkeys(row["frame"] for row in rows)):
            for sweep in dict.fromkeys((name, name.replace("line buffers", "double buffers"))):
                for memory in (LPDDR3, UNLIMITED):
                    found = [dict(r, value=max(1, r["value"]), shown=r[key] / whole[frame, memory][key])
                             for r in rows if r["value"] is not None
                             and (r["frame"], r["sweep"], r["memory"]) == (frame, sweep, memory)]
                    label = ", ".join((frame, *["double buffers"] * ("double" in sweep), SHORT[memory]))
                    _lines(axis, found, "value", "shown", label, linestyle=STYLES[memory], color=f"C{colour}",
                           markersize=3 if "double" in sweep else 6)
        axis.set_xscale("log", base=2)
        axis.set_xlabel(name.partition(",")[0] + " in entries (none as 1)" if name.startswith("beta") else name)
        axis.set_title(f"cycles of the {'frame' if key == 'cycles' else 'rendering phase'}", fontsize=10)
        axis.set_ylim(0.9, max(1.15, axis.get_ylim()[1]))
    for axis in grid[:, 0]:
        axis.set_ylabel("over the paper's, beta automatic")
    for axis in rest:
        axis.set_axis_off()
    rest[0].legend(*axes[0].get_legend_handles_labels(), fontsize=9, loc="upper left")
    return figure
