"""The page with the tables, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.cycles import cycles_by, cycles_of, explained
from msv2.studies.page import table
from msv2.studies.threshold.summary import CLOCK_HZ, over_poses, picked, rendered
from spec.constants import ECC_THRESHOLD_DEG

OVERHEAD_GOAL = 1.05
"""The largest accepted ratio of a frame's cycles to those of both eyes' geometry and of the busiest stage's rendering work."""

INTRODUCTION = f"""# Selective warping: the threshold

Made by `make table-ecc`. Both eyes look at one point, the source eye at its frame's centre. HVSQ (1e-5, lower is better) is
the mean of both eyes, each judged at its own gaze: against *the rendered pair*, both eyes rendered by the machine from the same
model, and against *dense*, both eyes of the dense model rendered without a gaze. *Tiles* and *entries* are of the target eye,
in percent of all its tiles and of the entries it has where it is rendered as a whole; *foveal* tiles have a pixel inside the
threshold, *holes* are rendered again. The floor is the share of entries in foveal tiles. Cycles are of the machine `paper`;
frames per second are at {CLOCK_HZ / 1e9:g} GHz, both eyes together. *Of one eye*, *of two eyes*: those cycles over the cycles
of the source eye, and of both eyes, rendered without warping. *Warping costs* is what all cycles are over both eyes' geometry
and the busiest stage's work on what is rendered. Depth costs no cycles: it is summed beside the colours.
"""

HEAD = ("threshold", "HVSQ vs rendered pair", "HVSQ vs dense", "tiles foveal", "holes", "warped", "entries: floor", "holes",
        "rendered in all", "{cycles}", "frames/s", "of one eye", "of two eyes", "warping costs")
"""The columns of a scene's table; `cycles` stands for the name of the cycles' source."""


def markdown(scenes: Sequence[Mapping[str, Any]], picture: str) -> str:
    """The page for the scenes' records."""
    parts = [INTRODUCTION, explained(scene["poses"][0] for scene in scenes) + "\n",
             f"![HVSQ against frames per second]({picture})\n", _picks(scenes), _costs(scenes)]
    return "\n".join([*filter(None, parts), *map(_scene, scenes)])


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return f"{table(head, rows)}\n"


def _title(scene: Mapping[str, Any]) -> str:
    width, height = scene["poses"][0]["size"]
    return f"{scene['scene']}, {width}x{height}"


def _picks(scenes: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for scene in scenes:
        pick, whole = picked(scene["poses"]), rendered(scene["poses"], "rendered")
        target = "-" if pick["target_hvsq"] is None else f"{1e5 * pick['target_hvsq']:.3f}"
        rows.append([_title(scene), target, f"{1e5 * whole['hvsq_dense']:.3f}", pick["verdict"]])
    return "\n".join([
        "## The threshold that is picked", "",
        "The lowest whose binocular HVSQ against the dense model is not above v1-H's, the predecessor's model (the same L1, "
        "levels trained without opacity enhancement), both of whose eyes are rendered. The paper picks 18 degrees.", "",
        _table(("scene", "v1-H, both eyes rendered", "ours, both eyes rendered", "picked"), rows)])


def _costs(scenes: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for scene in scenes:
        rtl, pose = scene.get("rtl"), scene["poses"][0]
        if not rtl:
            continue
        golden = next(row for row in pose["thresholds"] if row["threshold_deg"] == ECC_THRESHOLD_DEG)
        both, kind, ratios = rtl["stereo"], cycles_by(pose), (golden["cycles"]["of_one_eye"], golden["cycles"]["of_two_eyes"])
        if "target" in rtl:
            one, other = rtl["source"]["cycles"], rtl["target"]["cycles"]
            kind, ratios = "RTL", (both["cycles"] / one, both["cycles"] / (one + other))
        reached = "reached" if both["stereo_overhead"] <= OVERHEAD_GOAL else "missed"
        rows.append([
            _title(scene), f"{both['cycles']:,}", f"{both['stereo_overhead']:.3f}", reached,
            f"{golden['cycles']['total']:,} ({golden['cycles']['overhead']:.3f})", _percent(golden["entries"]["floor_share"]),
            _percent(golden["entries"]["holes_share"]), *(f"{ratio:.3f} ({kind})" for ratio in ratios),
            f"{1e5 * golden['hvsq']['dense']['mean']:.3f}",
            f"{1e5 * pose['rendered']['hvsq']['dense']['mean']:.3f}"])
    if not rows:
        return ""
    return "\n".join([
        "## What warping costs, by the RTL", "",
        f"The first pose at {ECC_THRESHOLD_DEG:g} degrees through the RTL of the machine `paper`, both eyes compared bit for "
        "bit. *Overhead*: cycles of the frame over both eyes' geometry phases and the busiest stage's work on the entries that "
        f"are rendered; the goal is {OVERHEAD_GOAL:g}. *Of one eye*, *of two eyes*: against eyes rendered alone, by the RTL "
        "where it was asked for, else without it, as the word beside the number says.", "",
        _table(("scene", "RTL cycles", "overhead", "goal", "cycles without the RTL (overhead)", "entries: floor", "holes",
                "of one eye", "of two eyes", "HVSQ vs dense", "rendered pair's"), rows)])


def _scene(scene: Mapping[str, Any]) -> str:
    poses, units = scene["poses"], scene["units"]
    rows = [[f"{row['threshold_deg']:g} deg", f"{1e5 * row['hvsq_rendered']:.3f}", f"{1e5 * row['hvsq_dense']:.3f}",
             *(_percent(row[name]) for name in ("tiles_foveal", "tiles_holes", "tiles_warped", "floor_share", "holes_share",
                                                "target_entries_share")),
             f"{row['cycles']:,.0f}", f"{row['fps']:,.0f}", f"{row['of_one_eye']:.3f}", f"{row['of_two_eyes']:.3f}",
             f"{100 * (row['overhead'] - 1):.1f} %"] for row in over_poses(poses)]
    for name, which in (("both eyes rendered", "rendered"), ("v1-H, both eyes rendered", "v1")):
        row = rendered(poses, which)
        if row is not None:
            rows.append([name, "0.000" if which == "rendered" else "-", f"{1e5 * row['hvsq_dense']:.3f}", *["-"] * 6,
                         f"{row['cycles']:,.0f}", f"{row['fps']:,.0f}", "-", "1.000" if which == "rendered" else "-", "-"])
    disparity = ", ".join(f"{pose['median_disparity_px']:.1f}" for pose in poses)
    why = f" ({units['reason']})" if units["reason"] else ""
    warnings = sorted({warning for pose in poses for row in pose["thresholds"] for warning in row["warnings"]})
    return "\n".join([
        f"## {_title(scene)}", "",
        f"{len(poses)} poses ({', '.join(pose['camera'] for pose in poses)}), means over them; {scene['levels']}, "
        f"{scene['points']:,} points; judged by {scene['judged_by']}. Scale {units['scale']}: {units['units_per_metre']:g} "
        f"units per metre{why}; median disparities {disparity} px.", "",
        _table([name.format(cycles=cycles_of(poses[0])) for name in HEAD], rows),
        *(f"Warning: {warning}.\n" for warning in warnings)])


def _percent(share: float) -> str:
    return f"{share:.1%}"
