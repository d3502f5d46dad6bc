"""The study's diagrams: small frontiers with named settings, and all measured points.

In a frontier, time increases to the right and accuracy upwards, so that the upper left is best. In the diagrams of all points
the loss increases upwards, so that the lower left is best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msv2.studies.labels import place_labels
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.tradeoff.frontiers import Frontier
from msv2.studies.tradeoff.knobs import DEFAULT, WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_LOSS = 1e-5
"""Losses below this many decibels are drawn at this value, because the scale is logarithmic and some settings gain by
chance."""

_MARKS = "os^vD<>pPX*hd"
_SHADE = "#0b5cad"


def save(frontier: Frontier, path: Path) -> None:
    """Draws a frontier as a PNG."""
    save_figure(draw(frontier), path, dpi=160)


def draw(frontier: Frontier) -> Figure:
    """The figure of a frontier, small enough to stay readable at a width of 400 pixels."""
    figure, axis = find_pyplot().subplots(figsize=(4.4, 3.5), layout="constrained")
    if frontier.log_time:
        axis.set_xscale("log")
    if frontier.linear_db is not None:
        axis.set_yscale("symlog", linthresh=frontier.linear_db)
    axis.plot(*_columns(frontier.others), "o", color="0.75", markersize=3.5, zorder=1)
    front = sorted((mark.time, mark.decibels) for mark in frontier.marks if mark.front)
    corners = [corner for (x, y), (next_x, _) in pairwise(front) for corner in ((x, y), (next_x, y))] + front[-1:]
    axis.plot(*_columns(corners), color=_SHADE, linewidth=1.2, zorder=2)
    for mark in frontier.marks:
        axis.plot(mark.time, mark.decibels, "*" if mark.other else "o", color=_SHADE, markersize=10 if mark.other else 6,
                  zorder=3, fillstyle="full" if mark.front or mark.other else "none")
    axis.set_xlabel(frontier.time, fontsize=9)
    axis.set_ylabel(frontier.accuracy, fontsize=9)
    axis.tick_params(labelsize=8)
    _ticks(axis, frontier)
    axis.margins(0.14, 0.16)
    axis.grid(alpha=0.3)
    axis.set_ylim(*axis.get_ylim())
    axis.set_xlim(*axis.get_xlim())
    place_labels(axis, [(mark.time, mark.decibels) for mark in frontier.marks], [mark.name for mark in frontier.marks],
                 size=8.5, lines=corners)
    return figure


def _ticks(axis: Axes, frontier: Frontier) -> None:
    """Ticks with plain numbers, few enough to stand beside each other."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

    if frontier.log_time:
        times = [mark.time for mark in frontier.marks]
        narrow = max(times) < 100 * min(times)
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,), numticks=12))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
    if frontier.linear_db is not None:
        steps = [frontier.linear_db * 10**i for i in range(4)]
        axis.yaxis.set_major_locator(FixedLocator([*(-step for step in reversed(steps)), 0, *steps]))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}" if value else "0"))
        axis.yaxis.set_minor_formatter(NullFormatter())


def _columns(points: object) -> tuple[list[float], list[float]]:
    pairs = list(points)
    return [x for x, _ in pairs], [y for _, y in pairs]


def save_details(picture: str, content: Mapping[str, Any], path: Path) -> None:
    """Draws all measured points as a PNG: `settings` of the machine, or `runs` of the training."""
    save_figure(details(picture, content), path, dpi=110)


def details(picture: str, content: Mapping[str, Any]) -> Figure:
    """The figure of all measured points."""
    count = {"settings": 3, "runs": 2}[picture]
    figure, axes = find_pyplot().subplots(count, 1, figsize=(8, 4.6 * count), layout="constrained")
    {"settings": _settings, "runs": _runs}[picture](axes, content)
    return figure


def _settings(axes: list[Axes], content: Mapping[str, Any]) -> None:
    rows = [row for row in content["machine"] if not row.get("error")]
    one = [row for row in rows if row["threshold_deg"] is None and row["loss_db"] is not None]
    knobs = list(dict.fromkeys(row["knob"] for row in rows))
    judged_by = "against photographs" if content["photographs"] else "photographs assumed"
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(0.08)
    for axis in (axes[0], axes[2]):
        axis.set_yscale("log")
        axis.set_ylabel(f"loss of PSNR, dB, {judged_by}")
    for axis in axes[:2]:
        axis.set_xscale("log")
        axis.set_xlabel("cycles a frame (model); hollow, crossed: breaks a hard case")
        _plain_cycles(axis, [row["cycles"] for row in (one if axis is axes[0] else rows)])
    axes[1].set_yscale("symlog", linthresh=1)
    axes[1].set_ylabel("change of HVSQ, %")
    axes[2].set_xlabel("bits of all formats and segments, word lengths alone")
    front = sorted((row for row in one if row["pareto"]), key=lambda row: row["cycles"])
    axes[0].step([row["cycles"] for row in front], [max(row["loss_db"], LEAST_LOSS) for row in front], where="post",
                 color="k", linewidth=1, label="frontier")
    _scatter(axes[0], one, knobs, "cycles", lambda row: max(row["loss_db"], LEAST_LOSS))
    _scatter(axes[1], [row for row in rows if row["hvsq_change"] is not None], knobs, "cycles",
             lambda row: 100 * row["hvsq_change"])
    words = [row for row in one if row["knob"] in (DEFAULT, "combination", *WORDS)]
    _scatter(axes[2], words, knobs, "word_bits", lambda row: max(row["loss_db"], LEAST_LOSS))
    axes[0].figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=5, loc="outside upper center",
                          title=f"{content['scene']}, {content['size']}")


def _plain_cycles(axis: Axes, cycles: list[float]) -> None:
    """Ticks in thousands of cycles, at most six."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    axis.set_xlim(0.95 * min(cycles), 1.08 * max(cycles))
    axis.xaxis.set_major_locator(MaxNLocator(6))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1e3:,.0f}k"))


def _scatter(
    axis: Axes, rows: list[Mapping[str, Any]], knobs: list[str], cost: str, loss: Callable[[Mapping[str, Any]], float],
) -> None:
    """Draws a marker per knob. Settings that break a hard case have hollow markers with a red cross. Values for which there is
    no free place are left out."""
    for number, knob in enumerate(knobs):
        own = [row for row in rows if row["knob"] == knob]
        mark, colour = _MARKS[number % len(_MARKS)], f"C{number % 10}"
        for i, row in enumerate(own):
            axis.plot(row[cost], loss(row), mark, color="k" if knob == DEFAULT else colour, markersize=7,
                      zorder=9 if knob == DEFAULT else 2, fillstyle="none" if row["broken"] else "full",
                      label=knob if i == 0 else None)
            if row["broken"]:
                axis.plot(row[cost], loss(row), "x", color="r", markersize=4)
    named = [row for row in rows
             if cost == "word_bits" or row["knob"] not in (*WORDS, "combination", DEFAULT, "tile test")]
    axis.figure.canvas.draw()
    place_labels(axis, [(row[cost], loss(row)) for row in named], [row["value"].partition(",")[0] for row in named], size=7,
                 drop=True, avoid=[(row[cost], loss(row)) for row in rows])


def _runs(axes: list[Axes], content: Mapping[str, Any]) -> None:
    for axis in axes:
        axis.set_ylabel("PSNR against photographs, dB")
        axis.grid(alpha=0.3)
    points, names = [], []
    for number, run in enumerate(content["training"]):
        label, colour = f"{run['scene']}-{run['variant']}", f"C{number}"
        axes[0].plot(run["curve"]["iteration"], run["curve"]["psnr"], color=colour, linewidth=0.8, alpha=0.5)
        stages = [stage for stage in run["stages"] if stage["level"] == 1]
        axes[0].plot([s["iterations"] for s in stages], [s["psnr"] for s in stages], "o", color=colour, label=label)
        axes[1].plot([s["points"] for s in run["stages"]], [s["psnr"] for s in run["stages"]], "o-", color=colour, label=label)
        points += [(stage["points"], stage["psnr"]) for stage in run["stages"]]
        names += [stage["stage"] for stage in run["stages"]]
    axes[0].set_xlabel("iterations; lines: training views while the dense model is trained, dots: test views")
    axes[1].set_xlabel("points of the stage's model")
    axes[0].figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=4, loc="outside upper center")
    place_labels(axes[1], points, names, size=7, drop=True)
