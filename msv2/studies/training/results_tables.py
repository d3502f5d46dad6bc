"""The tables of training in docs/results.md, made from reports/training*.json. The module needs no torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from msv2.studies.page import table
from msv2.studies.training import headline as headline_text
from msv2.studies.training import tables_text

Reports = Mapping[str, Mapping[str, Any]]

PICTURE = "![latency of pruned versions against points and intersections; HVSQ against points](../reports/training.png)"


def _scenes(reports: Reports) -> list[Mapping[str, Any]] | None:
    """The scenes of all reports of training, in the order of the reports' names; None if there is no report."""
    names = [name for name in sorted(reports) if name.startswith("training") and "scenes" in reports[name]]
    return [scene for name in names for scene in reports[name]["scenes"]] if names else None


def _of_scenes(key: str, shown: Callable[[Mapping[str, Any]], str]) -> Callable[[Reports], str | None]:
    """A function that makes a table for each scene with `key`, under the scene's name. It returns None without any report."""
    def text(reports: Reports) -> str | None:
        every = _scenes(reports)
        if every is None:
            return None
        scenes = [scene for scene in every if key in scene]
        if not scenes:
            return "(not measured yet)"
        return "\n".join(f"**{tables_text.scene_title(scene)}**\n\n{shown(scene)}" for scene in scenes)

    return text


def _targets(reports: Reports) -> str | None:
    scenes = _scenes(reports)
    return None if scenes is None else tables_text.targets_table(scenes)


def _latency(reports: Reports) -> str | None:
    text = _of_scenes("latency", tables_text.agreement_table)(reports)
    return text if text is None else f"{PICTURE}\n\n{text}"


def _pooling(reports: Reports) -> str | None:
    """A table of levels and storage by the display for which their pooling is made."""
    if "pooling" not in reports:
        return None
    cells = []
    for row in reports["pooling"]["rows"]:
        size = "{}x{}".format(*row["size"])
        of_frame = f"{row['pooling_width']} px wide" if row["pooling_width"] else "of its own width"
        shares = ", ".join(f"{100 * count / row['points'][0]:.0f} %" for count in row["points"][1:])
        cells.append([f"{row['scene']}, {size}", of_frame, shares, f"+{row['storage_overhead_percent']:.1f} %",
                      f"dense's / {row['cut_foveated']:.2f}"])
    return table(["run", "pooling as of a frame", "points of L2, L3, L4 in L1's", "storage over L1's",
                  "intersections, foveated"], cells)


def _headline(reports: Reports) -> str | None:
    return headline_text.text(reports["training_headline"]["rows"]) if "training_headline" in reports else None


TRAINING_TABLES: dict[str, Callable[[Reports], str | None]] = {
    "training_targets": _targets,
    "training_representations": _of_scenes("comparison", lambda scene: tables_text.comparison_table(scene["comparison"])),
    "training_points": _of_scenes("comparison", tables_text.points_table),
    "training_ablation": _of_scenes("ablation", lambda scene: tables_text.ablation_table(scene["ablation"])),
    "training_pruning": _of_scenes("pruning", lambda scene: tables_text.pruning_table(scene["pruning"])),
    "training_latency": _latency, "training_pooling": _pooling, "training_headline": _headline,
}
