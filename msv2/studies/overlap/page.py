"""The summary and the page of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import IDEAL, LPDDR3, MEMORY_NAMES
from msv2.studies.overlap.measure import MACHINES, TURNS
from msv2.studies.page import table
from msv2.studies.performance.summary import geomean
from msv2.studies.two_eyes.measure import ONE, TWO
from spec.config import PAPER, V3

Row = Mapping[str, Any]

GOALS = {"ideal_gain": 2.9, "lpddr3_gain": 3.3, "two_eyes_gain": 3.6, "second_eye_share": 0.55}
"""What overlapped phases should give: one eye over `paper` with each memory, and both eyes with LPDDR3: their gain over two
frames of `paper`, and the largest share of the first eye's cycles that the second one costs."""


def _of(rows: Sequence[Row], machine: str, kind: str, memory: str) -> dict[str, Row]:
    return {row["frame"]: row for row in rows if (row["machine"], row["kind"], row["memory"]) == (machine, kind, memory)}


def summary(rows: Sequence[Row], paper: Sequence[Row]) -> dict[str, dict[str, float | None]]:
    """By machine and memory, geometric means over the frames: the gain of overlapping over phases in turn, that over `paper`,
    and with two eyes the share of the second one; None without frames. `one` and `two` stand for the kinds of frames."""
    out: dict[str, dict[str, float | None]] = {}
    for machine in MACHINES:
        for memory in MEMORY_NAMES:
            base = {row["frame"]: row["cycles"] for row in paper if row["memory"] == memory}
            one, two = (_of(rows, machine, kind, memory) for kind in (ONE, TWO))
            out[f"{machine}, {memory}"] = {
                "over_turns": geomean(row["in_turn"] / row["overlapped"] for row in one.values()),
                "over_turns_two": geomean(row["in_turn"] / row["overlapped"] for row in two.values()),
                "gain": geomean(base[name] / row["overlapped"] for name, row in one.items()),
                "two_eyes_gain": geomean(2 * base[name] / row["overlapped"] for name, row in two.items()),
                "second_eye_share": geomean(two[name]["overlapped"] / one[name]["overlapped"] - 1 for name in two)}
    return out


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    rows, found = content["frames"], content["summary"]
    head = ("machine", "memory", "over phases in turn, one eye", "two eyes", f"over `{PAPER.name}`, one eye",
            f"two eyes over two of `{PAPER.name}`", "second eye, share of the first")
    means = table(head, [
        (machine, MEMORY_NAMES[memory], *(_number(found[f"{machine}, {memory}"][name]) for name in (
            "over_turns", "over_turns_two", "gain", "two_eyes_gain", "second_eye_share")))
        for machine in MACHINES for memory in MEMORY_NAMES], 2)
    parts = [
        "# Overlapped phases",
        "Written by `msv2 study run overlap`; `perf/overlap.py` says what the phases share.\n\nThe first "
        "phase of frame n + 1 runs beside the second phase of frame n. **These are numbers of the cycle model**, for each of "
        "the machines with overlapped phases added. The RTL of machines with one array does this; reports/frames_overlap.md "
        "compares it with the model. The frames are those of reports/v3.md, of a camera that stands still; a frame takes the "
        "cycles until the same phase of the next one begins.",
        "## Gains", f"Geometric means. Goals: {', '.join(f'{name} {value:g}' for name, value in GOALS.items())}, where a share "
        "is a limit.", means,
        *(part for memory in MEMORY_NAMES if _of(rows, V3.name, ONE, memory) for part in (
            f"## Frames, {MEMORY_NAMES[memory]}", _frames([row for row in rows if row["memory"] == memory]))),
        "## Bounds of depth buckets", "The bounds of a frame are those that the last frame but one left. The share of pairs in "
        f"lists that the sorter cannot hold at once, after turns of {' and '.join(f'{turn:g}' for turn in TURNS)} degrees in "
        "two frames.", _turns(content["overflow"])]
    return "\n\n".join(part for part in parts if part)


def _frames(rows: Sequence[Row]) -> str:
    return table(
        ("frame", "machine", "eyes", "in turn", "overlapped", "gain", "first phase", "second phase", "array busy",
         "memory busy"),
        [(row["frame"], row["machine"], 2 if row["kind"] == TWO else 1, f"{row['in_turn']:,}", f"{row['overlapped']:,}",
          f"{row['in_turn'] / row['overlapped']:.3f}", f"{row['first']:,}", f"{row['second']:,}",
          f"{row['utilisation']['array']:.0%}", f"{row['utilisation']['memory']:.0%}") for row in rows], 2)


def _turns(rows: Sequence[Row]) -> str:
    found = [row for row in rows if row["degrees"] is not None]
    return table(("frame", "levels", "degrees", "pairs", "largest list", "share"), [
        (row["frame"], 4 if row["foveated"] else 1, f"{row['degrees']:g}", f"{row['pairs']:,}", f"{row['largest']:,}",
         f"{row['overflow_share']:.4f}") for row in found], 1) if found else ""


def steps(summaries: Mapping[str, Mapping[str, float | None]], packed: str, arrays: str) -> dict[str, float | None]:
    """The step of reports/v3.json: gains of one eye on the machine named `packed`, and those of two eyes on `arrays`."""
    one = {memory: summaries[f"{packed}, {memory}"] for memory in (LPDDR3, IDEAL)}
    two = {memory: summaries[f"{arrays}, {memory}"] for memory in (LPDDR3, IDEAL)}
    return {"lpddr3_gain": one[LPDDR3]["gain"], "ideal_gain": one[IDEAL]["gain"],
            **{f"{name}{end}": two[memory][name] for memory, end in ((LPDDR3, ""), (IDEAL, "_ideal"))
               for name in ("two_eyes_gain", "second_eye_share")}}
