"""Means over poses, and the choice of the threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

CLOCK_HZ = 1e9
"""Clock of the machine, for frames per second; it is the paper's."""

Pose = Mapping[str, Any]


def mean_of(rows: Sequence[Mapping[str, Any]], *path: str) -> float:
    """The mean of a number that is nested in the rows under these names."""
    values = []
    for row in rows:
        for name in path:
            row = row[name]
        values.append(float(row))
    return float(np.mean(values))


def over_poses(poses: Sequence[Pose]) -> list[dict[str, float]]:
    """One row per threshold, with means over the poses."""
    found = []
    for index, first in enumerate(poses[0]["thresholds"]):
        rows = [pose["thresholds"][index] for pose in poses]
        tiles = [{name: row["tiles"][name] / row["tiles"]["all"] for name in ("foveal", "holes", "warped")} for row in rows]
        of_full = [row["entries"]["target"] / max(row["entries"]["target_if_rendered"], 1) for row in rows]
        cycles = mean_of(rows, "cycles", "total")
        found.append({
            "threshold_deg": first["threshold_deg"], "hvsq_rendered": mean_of(rows, "hvsq", "rendered", "mean"),
            "hvsq_dense": mean_of(rows, "hvsq", "dense", "mean"), "hvsq_dense_target": mean_of(rows, "hvsq", "dense", "target"),
            **{f"tiles_{name}": mean_of(tiles, name) for name in ("foveal", "holes", "warped")},
            "entries": mean_of(rows, "entries", "source") + mean_of(rows, "entries", "target"),
            "target_entries_share": float(np.mean(of_full)), "floor_share": mean_of(rows, "entries", "floor_share"),
            "holes_share": mean_of(rows, "entries", "holes_share"), "cycles": cycles, "fps": CLOCK_HZ / cycles,
            **{name: mean_of(rows, "cycles", name) for name in ("overhead", "of_one_eye", "of_two_eyes")}})
    return found


def rendered(poses: Sequence[Pose], which: str) -> dict[str, float] | None:
    """Means over the poses with both eyes rendered, for `which` of "rendered" and "v1"; None where there is no such model."""
    rows = [pose[which] for pose in poses]
    if any(row is None for row in rows):
        return None
    cycles = mean_of(rows, "cycles", "total")
    return {"hvsq_dense": mean_of(rows, "hvsq", "dense", "mean"), "cycles": cycles, "fps": CLOCK_HZ / cycles,
            "entries": mean_of(rows, "entries", "source") + mean_of(rows, "entries", "target")}


def picked(poses: Sequence[Pose]) -> dict[str, Any]:
    """The lowest threshold whose binocular HVSQ against the dense model is not above that of the v1 model's rendered pair.

    `threshold_deg` is None if no threshold qualifies or if there is no v1 model; `verdict` states the result in words.
    """
    target, rows = rendered(poses, "v1"), over_poses(poses)
    if target is None:
        return {"threshold_deg": None, "target_hvsq": None, "verdict": "no v1 model: nothing to pick by"}
    for row in sorted(rows, key=lambda row: row["threshold_deg"]):
        if row["hvsq_dense"] <= target["hvsq_dense"]:
            return {"threshold_deg": row["threshold_deg"], "target_hvsq": target["hvsq_dense"],
                    "verdict": f"{row['threshold_deg']:g} degrees"}
    best = min(row["hvsq_dense"] for row in rows)
    return {"threshold_deg": None, "target_hvsq": target["hvsq_dense"],
            "verdict": f"none: at best {best / target['hvsq_dense']:.2f} times v1's HVSQ"}
