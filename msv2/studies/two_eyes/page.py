"""The summary and the page of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import IDEAL, MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.performance.summary import geomean
from msv2.studies.two_eyes.headset import section
from msv2.studies.two_eyes.measure import MACHINES, ONE, SHARED, TWO
from spec.config import PAPER, V3_EYES, V3_EYES_LARGE, V3_EYES_STREAMS

Row = Mapping[str, Any]

SHARE_GOAL, GAIN_GOAL = 0.80, 2.8
"""The largest share of the first eye's cycles that the second one costs, and how many times fewer cycles both eyes take than
two frames of `paper`, as geometric means, where the phases of a frame follow each other."""


def _cycles(rows: Sequence[Row], kind: str, machine: str, memory: str) -> dict[str, float]:
    return {row["frame"]: row["cycles"] for row in rows
            if (row["kind"], row["machine"], row["memory"]) == (kind, machine, memory)}


def summary(rows: Sequence[Row], paper: Sequence[Row]) -> dict[str, object]:
    """By machine and memory, `second_eye_share` and `two_eyes_gain`, and by frame what they are made of; None without frames.
    With shared colours, frames without harmonics count as they are.

    Args:
        rows: those of `measure.cycle_rows`.
        paper: rows of frames of one eye on `paper`, with `frame`, `memory` and `cycles`.
    """
    out: dict[str, object] = {}
    for machine in MACHINES:
        for memory in MEMORY_NAMES:
            one, two = (_cycles(rows, kind, machine, memory) for kind in (ONE, TWO))
            shared = {**two, **_cycles(rows, SHARED, machine, memory)}
            base = {row["frame"]: row["cycles"] for row in paper if row["memory"] == memory}
            found = {"machine": machine, "memory": memory}
            for end, both in (("", two), ("_shared", shared)):
                shares = {frame: both[frame] / one[frame] - 1 for frame in both}
                gains = {frame: 2 * base[frame] / both[frame] for frame in both if frame in base}
                found |= {f"second_eye_share{end}": geomean(shares.values()), f"two_eyes_gain{end}": geomean(gains.values()),
                          f"shares{end}": shares, f"gains{end}": gains}
            out[f"{machine}, {memory}"] = found
    return out


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _db(value: float | None) -> str:
    return "equal" if value is None or math.isinf(value) else f"{value:.1f}"


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    rows, found = content["frames"], content["summary"].values()
    means = table(
        ("machine", "memory", "second eye, share of the first", "with shared colours",
         f"gain over two frames of `{PAPER.name}`", "with shared colours"),
        [(f["machine"], MEMORY_NAMES[f["memory"]], _number(f["second_eye_share"], 3), _number(f["second_eye_share_shared"], 3),
          _number(f["two_eyes_gain"], 2), _number(f["two_eyes_gain_shared"], 2)) for f in found], 2)
    parts = [
        "# Two eyes from one set of lists", "Written by `msv2 study run two_eyes`. docs/stereo.md describes joint frames, and "
        f"docs/formats.md defines them.\n\nThe cycles are those of the cycle model. `{V3_EYES.name}` has one array and writes "
        f"display pixels; `{V3_EYES_STREAMS.name}` has four arrays and packs the frames of both eyes; the RTL of both renders "
        "joint frames (reports/frames_eyes.json). The frames are those of reports/v3.md: four levels and the gaze in the "
        "centre of the left eye, which is the source; the right eye looks at the same point.",
        "## Cycles",
        f"Geometric means over the frames. The phases of a frame follow each other. The goals are a share of at most "
        f"{SHARE_GOAL:.2f} and a gain of at least {GAIN_GOAL}. The goals were set for four arrays and packed frames. Places of "
        "two eyes fill the batch buffer twice as fast, so that tiles are visited more often; the last machine, "
        f"`{V3_EYES_LARGE.name}`, has twice the places, for either frame. Its share is smaller because frames of one eye take "
        f"longer on it, while those of two take as long as on `{V3_EYES_STREAMS.name}`. Shared colours change frames with "
        "harmonics alone.", means,
        *(part for f in found for part in (
            f"### {f['machine']}, {MEMORY_NAMES[f['memory']]}",
            _frames(rows, f)) if f["shares"]),
        "## Where the second eye's cycles go", f"`{V3_EYES_STREAMS.name}`, {MEMORY_NAMES[IDEAL]}: cycles of both phases, "
        "one eye / two eyes, and the items that stages take in the second frame over those in the first.", _stages(rows),
        "## The eyes of a headset", section(content),
        "## Pairs", "Pairs of splats and super-tiles of both eyes over those of the source, with the shift of the median "
        "disparity, in tiles; with none; and with the best one of -4..4.", _shifts(content["shifts"]),
        "## Pixels",
        "The target of the joint frame, in the source's order, beside the target alone, in its own order, and beside the "
        "float64 oracle's target, whose order is its own: PSNR in dB. The source's pixels are compared with those of the "
        "source alone. *Keys* is the share of splats, in view of both eyes, whose two depth keys differ, and by how much at "
        "most; *pixels* that of the target's pixels that differ. The orbit's first camera looks along an axis of the captured "
        "scenes, so that the distance between its eyes does not enter z; camera 3 looks askew.", _quality(content["quality"])]
    return "\n\n".join(part for part in parts if part)


def _of(rows: Sequence[Row], kind: str, found: Row) -> dict[str, Row]:
    return {row["frame"]: row for row in rows
            if (row["kind"], row["machine"], row["memory"]) == (kind, found["machine"], found["memory"])}


def _frames(rows: Sequence[Row], found: Row) -> str:
    one, two, shared = (_of(rows, kind, found) for kind in (ONE, TWO, SHARED))
    return table(
        ("frame", "one eye", "two eyes", "share", "share, shared colours", f"gain over two of `{PAPER.name}`",
         "bytes, times one", "pairs, times one"),
        [(name, f"{one[name]['cycles']:,}", f"{row['cycles']:,}", f"{found['shares'][name]:.3f}",
          f"{found['shares_shared'][name]:.3f}" if name in shared else "-", _number(found["gains"].get(name), 2),
          f"{row['total_bytes'] / one[name]['total_bytes']:.2f}", f"{row['pairs'] / one[name]['pairs']:.3f}")
         for name, row in two.items()], 1)


def _stages(rows: Sequence[Row]) -> str:
    found = {"machine": V3_EYES_STREAMS.name, "memory": IDEAL}
    one, two = _of(rows, ONE, found), _of(rows, TWO, found)
    names = ("projection", "tile_test", "fetch", "colour", "batch", "array")
    return table(
        ("frame", "geometry", "render", *names),
        [(name, *(f"{one[name]['phases'][phase]:,} / {row['phases'][phase]:,}" for phase in ("geometry", "render")),
          *(f"{row['busy'][stage] / max(1, one[name]['busy'][stage]):.2f}" for stage in names))
         for name, row in two.items()], 1)


def _shifts(rows: Sequence[Row]) -> str:
    return table(
        ("frame", "shift", "pairs of one eye", "both", "without shift", "best", "best shift"),
        [(row["frame"], row["shift"], f"{row['one']:,}", *(f"{row[name] / row['one']:.3f}"
          for name in ("median", "unshifted", "best")), row["best_shift"]) for row in rows], 1)


def _quality(rows: Sequence[Row]) -> str:
    return table(
        ("frame", "camera", "units per metre", "median disparity, px", "source", "keys", "pixels", "joint to alone",
         "alone to oracle", "joint to oracle", "shared colours to own", "shared colours to oracle"),
        [(row["frame"], row["camera"], f"{row['units_per_metre']:g} ({row['scale']})", f"{row['disparity_px']:.1f}",
          "equal" if row["source_equal"] else "DIFFERS",
          f"{row['keys_differ']:.2%}, by {row['largest_key_difference']}", f"{row['pixels_differ']:.3%}",
          *(_db(row[name]) for name in ("joint_vs_alone_db", "alone_vs_oracle_db", "joint_vs_oracle_db", "shared_vs_own_db",
                                        "shared_vs_oracle_db"))) for row in rows], 1)
