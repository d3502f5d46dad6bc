"""Work-precision diagrams: the cost increases to the right and the loss upwards, so that the lower left is best."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.tradeoff.knobs import DEFAULT, WORDS

LEAST_LOSS = 1e-5
"""Losses below this many decibels are drawn at this value, because the scale is logarithmic and some settings gain by
chance."""

_MARKS = "os^vD<>pPX*hd"


def save(picture: str, content: Mapping[str, Any], path: Path) -> None:
    """Draws one of `report.PICTURES` as a PNG."""
    count = 3 if picture == "machine" else 2
    figure, axes = find_pyplot().subplots(1, count, figsize=(6.5 * count, 5.2), constrained_layout=True)
    {"machine": _machine, "simulation": _simulation, "training": _training}[picture](axes, content)
    save_figure(figure, path, dpi=100)


def _machine(axes: list[Axes], content: Mapping[str, Any]) -> None:
    rows = [row for row in content["machine"] if not row.get("error")]
    one = [row for row in rows if row["threshold_deg"] is None and row["loss_db"] is not None]
    knobs = list(dict.fromkeys(row["knob"] for row in rows))
    _scatter(axes[0], one, knobs, "cycles", lambda row: max(row["loss_db"], LEAST_LOSS))
    front = sorted((row for row in one if row["pareto"]), key=lambda row: row["cycles"])
    axes[0].step([row["cycles"] for row in front], [max(row["loss_db"], LEAST_LOSS) for row in front], where="post",
                 color="k", linewidth=1, label="frontier")
    words = [row for row in one if row["knob"] in (DEFAULT, "combination", *WORDS)]
    _scatter(axes[2], words, knobs, "word_bits", lambda row: max(row["loss_db"], LEAST_LOSS))
    judged_by = "against photographs" if content["photographs"] else "photographs assumed"
    for axis in (axes[0], axes[2]):
        axis.set_yscale("log")
        axis.set_ylabel(f"loss of PSNR, dB, {judged_by}")
    judged = [row for row in rows if row["hvsq_change"] is not None]
    _scatter(axes[1], judged, knobs, "cycles", lambda row: 100 * row["hvsq_change"])
    axes[1].set_yscale("symlog", linthresh=1)
    axes[1].set_ylabel("change of HVSQ, %")
    for axis in axes:
        axis.set_xlabel("cycles a frame (model); hollow, crossed: breaks a hard case")
        axis.grid(alpha=0.3)
    for axis in axes[:2]:
        axis.set_xscale("log")
    axes[2].set_xlabel("bits of all formats and segments, word lengths alone")
    axes[0].legend(fontsize=7, ncol=2)
    axes[0].set_title(f"{content['scene']}, {content['size']}", fontsize=10)


def _scatter(
    axis: Axes, rows: list[Mapping[str, Any]], knobs: list[str], cost: str, loss: Callable[[Mapping[str, Any]], float],
) -> None:
    """Draws a marker per knob. Settings that break a hard case have hollow markers with a red cross."""
    for number, knob in enumerate(knobs):
        own = [row for row in rows if row["knob"] == knob]
        mark, colour = _MARKS[number % len(_MARKS)], f"C{number % 10}"
        for i, row in enumerate(own):
            axis.plot(row[cost], loss(row), mark, color="k" if knob == DEFAULT else colour, markersize=7,
                      zorder=9 if knob == DEFAULT else 2, fillstyle="none" if row["broken"] else "full",
                      label=knob if i == 0 else None)
            if row["broken"]:
                axis.plot(row[cost], loss(row), "x", color="r", markersize=4)
            if cost == "word_bits" or row["knob"] not in (*WORDS, "combination", DEFAULT, "tile test"):
                axis.annotate(row["value"].partition(",")[0], (row[cost], loss(row)), fontsize=6, xytext=(4, 3),
                              textcoords="offset points")


def _simulation(axes: list[Axes], content: Mapping[str, Any]) -> None:
    rows = content["simulation"]["rows"]
    for number, row in enumerate(rows):
        axes[0].plot(1e3 * row["wall_s"], 255 * row["max_abs_error"], "o", color=f"C{number}", label=row["name"])
        axes[0].annotate(row["name"], (1e3 * row["wall_s"], 255 * row["max_abs_error"]), fontsize=8, xytext=(4, 4),
                         textcoords="offset points")
        if row["cycle_error"] is not None:
            axes[1].plot(1e3 * row["wall_s"], 100 * abs(row["cycle_error"]), "o", color=f"C{number}")
            axes[1].annotate(row["name"], (1e3 * row["wall_s"], 100 * abs(row["cycle_error"])), fontsize=8, xytext=(4, 4),
                             textcoords="offset points")
    for axis, label in zip(axes, ("worst error against the oracle, of 255", "error of cycles against the RTL, %"), strict=True):
        axis.set_xscale("log")
        axis.set_xlabel("wall time of a frame, ms")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_title(f"{content['simulation']['size']}, {content['simulation']['config']}", fontsize=10)


def _training(axes: list[Axes], content: Mapping[str, Any]) -> None:
    for number, run in enumerate(content["training"]):
        label, colour = f"{run['scene']}-{run['variant']}", f"C{number}"
        axes[0].plot(run["curve"]["iteration"], run["curve"]["psnr"], color=colour, linewidth=0.8, alpha=0.5)
        stages = [stage for stage in run["stages"] if stage["level"] == 1]
        axes[0].plot([s["iterations"] for s in stages], [s["psnr"] for s in stages], "o", color=colour, label=label)
        axes[1].plot([s["points"] for s in run["stages"]], [s["psnr"] for s in run["stages"]], "o-", color=colour, label=label)
        for stage in run["stages"]:
            axes[1].annotate(stage["stage"], (stage["points"], stage["psnr"]), fontsize=6, xytext=(3, 3),
                             textcoords="offset points")
    axes[0].set_xlabel("iterations; lines: training views while the dense model is trained, dots: test views")
    axes[1].set_xlabel("points of the stage's model")
    for axis in axes:
        axis.set_ylabel("PSNR against photographs, dB")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
