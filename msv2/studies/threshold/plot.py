"""Draws the paper's figure: binocular HVSQ against frames per second, with a point per threshold.

HVSQ is measured against the dense model where levels are trained. Untrained levels are so far from it that warping would not
show, so that HVSQ is then measured against the rendered pair.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from msv2.studies.cycles import cycles_of
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.threshold.scenes import TRAINED
from msv2.studies.threshold.summary import over_poses, rendered


def save_plot(scenes: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draws a PNG with a panel per scene: our thresholds as points, and both eyes rendered by our model and by v1-H."""
    columns = min(2, len(scenes))
    lines = -(-len(scenes) // columns)
    figure, axes = find_pyplot().subplots(
        lines, columns, figsize=(5 * columns, 3.8 * lines), squeeze=False, constrained_layout=True)
    for axis, scene in zip(axes.flat, scenes, strict=False):
        _panel(axis, scene)
    for axis in axes.flat:
        axis.set_visible(axis.has_data())
    save_figure(figure, path)


def _panel(axis: Any, scene: Mapping[str, Any]) -> None:
    rows, trained = over_poses(scene["poses"]), scene["levels"] == TRAINED
    x, y = [row["fps"] for row in rows], [1e5 * row["hvsq_dense" if trained else "hvsq_rendered"] for row in rows]
    axis.plot(x, y, "o-", color="C0", label="selective warping")
    for row, at in zip(rows, zip(x, y, strict=True), strict=True):
        axis.annotate(f"{row['threshold_deg']:g}°", at, textcoords="offset points", xytext=(5, 5), fontsize=8)
    for which, label, mark in (("rendered", "both eyes rendered", "C1s"), ("v1", "v1-H, both eyes rendered", "C3^")):
        row = rendered(scene["poses"], which)
        if row is not None and (trained or which == "rendered"):
            axis.plot(row["fps"], 1e5 * row["hvsq_dense"] if trained else 0.0, mark, label=label)
            if which == "v1":
                axis.axhline(1e5 * row["hvsq_dense"], color="C3", linewidth=0.8, linestyle=":")
    axis.set_title(scene["scene"], fontsize=10)
    axis.set_xlabel(f"frames/s, both eyes ({cycles_of(scene['poses'][0])}, 1 GHz)")
    axis.set_ylabel(f"binocular HVSQ vs {'dense' if trained else 'rendered pair'}, 1e-5")
    axis.legend(fontsize=8)
