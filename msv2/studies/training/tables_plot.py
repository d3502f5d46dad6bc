"""The plots for the tables: latency against points and intersections, and HVSQ of levels against their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msv2.studies.cycles import CYCLES
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.training.labels import CRITERION_LABELS
from msv2.studies.training.latency import CRITERIA, Version, proportionality
from msv2.studies.training.level_curves import LevelCurve


@dataclass(frozen=True)
class Shown:
    """The plotted data of a scene.

    Attributes:
        name: the scene's name.
        versions: the pruned versions of its dense model; empty if they were not requested.
        curves, plain_curves: the curves of its levels with and without opacity enhancement; empty likewise.
    """

    name: str
    versions: Sequence[Version]
    curves: Sequence[LevelCurve]
    plain_curves: Sequence[LevelCurve]


def save_plots(scenes: Sequence[Shown], path: Path) -> None:
    """Draws a PNG with a row per scene: latency against points and against intersections per tile, and the levels' HVSQ."""
    columns = 3 if any(shown.curves or shown.plain_curves for shown in scenes) else 2
    figure, axes = find_pyplot().subplots(
        len(scenes), columns, figsize=(4.7 * columns, 3.8 * len(scenes)), squeeze=False, constrained_layout=True)
    for row, shown in zip(axes, scenes, strict=True):
        if shown.versions:
            _latency(row[0], shown, "points", "points")
            _latency(row[1], shown, "entries", "tile-ellipse intersections per tile")
            row[0].legend(fontsize=8)
        if shown.curves or shown.plain_curves:
            _levels(row[2], shown)
        for axis in row:
            axis.set_visible(axis.has_data())
    save_figure(figure, path)


def _latency(axis: Any, shown: Shown, quantity: str, label: str) -> None:
    for colour, criterion in zip(("C0", "C1"), CRITERIA, strict=True):
        own = [v for v in shown.versions if v.criterion == criterion]
        name = CRITERION_LABELS[criterion]
        x = [v.points if quantity == "points" else v.work.entries_per_tile for v in own]
        axis.plot(x, [v.work.cycles for v in own], "o-", color=colour, linewidth=1, label=f"{name}, model")
        if all(v.rtl is not None for v in own):
            axis.plot(x, [v.rtl.cycles for v in own], "x--", color=colour, linewidth=1, label=f"{name}, RTL")
    told = ", ".join(
        f"{CYCLES[kind]}: r = {of[quantity]['pearson']:.3f}" for kind, of in proportionality(shown.versions).items())
    axis.set(xlabel=label, ylabel="cycles per frame", xlim=(0, None), ylim=(0, None))
    axis.set_title(f"{shown.name}: {told}", fontsize=9)
    axis.grid(alpha=0.3)


def _levels(axis: Any, shown: Shown) -> None:
    for curves, style, name in ((shown.curves, "o-", "opacity enhancement"), (shown.plain_curves, "x--", "without")):
        for curve in curves:
            axis.plot(curve.points, curve.hvsq, style, color=f"C{curve.level}", linewidth=1, label=f"L{curve.level}, {name}")
    axis.axhline(1.0, color="0.5", linewidth=0.8)
    axis.set(xlabel="points of the level", ylabel="lowest HVSQ reached / target (validation)", xlim=(0, None))
    axis.set_title(f"{shown.name}: levels as training saw them; at most 1 passes", fontsize=9)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
