"""The goals and the page of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import IDEAL_CYCLES, cycles_cells, cycles_heads
from msv2.studies.page import table
from msv2.studies.performance.summary import geomean
from msv2.studies.presets.measure import EXACT
from msv2.studies.tradeoff.choose import pareto
from spec.config import V3

Row = Mapping[str, Any]

GOALS = {"balanced": (0.1, 1.3), "fast": (0.5, 1.6)}
"""For each preset the loss in dB that it may have, and how many times as fast as the exact frame it should be with LPDDR3."""

BY_DEFINITION = "support radius"
"""Choices whose names begin so break hard cases by definition, because those state in closed form what is covered."""


def goals(rows: Sequence[Row]) -> list[dict[str, object]]:
    """For each scene and preset the fastest choice within its loss, among those that keep the support radius; and the geometric
    means over the scenes, each with its own choice."""
    out: list[dict[str, Any]] = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        mine = [row for row in rows if row["scene"] == scene and not row["choice"].startswith(BY_DEFINITION)]
        exact = next(row for row in mine if row["choice"] == EXACT.name)
        for preset, (loss, wanted) in GOALS.items():
            best = min((row for row in mine if row["loss_db"] <= loss), key=lambda row: row["cycles"])
            found = exact["cycles"] / best["cycles"]
            out.append({"goal": f"{scene}: {preset}, {loss:g} dB", "wanted": wanted, "found": found, "choice": best["choice"],
                        "reached": found >= wanted})
    for number, (preset, (loss, wanted)) in enumerate(GOALS.items()):
        mean = geomean(goal["found"] for goal in out[number :: len(GOALS)])
        out.append({"goal": f"geometric mean: {preset}, {loss:g} dB", "wanted": wanted, "found": mean, "choice": "as above",
                    "reached": mean is not None and mean >= wanted})
    return out


def frontier(rows: Sequence[Row]) -> list[Row]:
    """The rows of a scene that no other one beats in both cycles and loss, by ascending cycles."""
    return [rows[i] for i in pareto((row["cycles"], round(row["loss_db"], 3)) for row in rows)]


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    rows = content["rows"]
    parts = [
        "# What accuracy buys on v3", "Written by `msv2 study run presets`. Frames of `v3` without a gaze; the fastest one "
        "within each loss counts. The loss is that of PSNR against the photographs of the embedded scene; for other scenes "
        "photographs are assumed from which the exact frame is 30 dB away ([docs/tradeoff.md](../docs/tradeoff.md)). On `v3` a "
        "compact record has all harmonics of degree 1 to 3 in one beat, so only degree 0, which needs no such beat, saves "
        "time, and word lengths save none. *Averaged* base colours are what the model's own pictures show of each point on "
        "average; *% of the work* leaves out the points that contribute least to these pictures for each intersection. Both "
        "are the host's doing."
        + (f" Missing: {', '.join(content['missing'])}." if content["missing"] else ""),
        "## Goals", table(("goal", "wanted", "found", "by", "reached"), (
            (goal["goal"], f"≥ {goal['wanted']:g}", f"{goal['found']:.3f}", goal["choice"],
             "yes" if goal["reached"] else "**no**")
            for goal in content["goals"]), left=1, words=("by", "reached"))]
    for scene in dict.fromkeys(row["scene"] for row in rows):
        parts += [f"## {scene}", _scene([row for row in rows if row["scene"] == scene])]
    parts += ["## Frames of four levels by SH degree", "640x360, the gaze in the centre, display pixels; packed frames where "
              "the machine packs.", _foveated(content["foveated"])]
    return "\n\n".join(parts)


def _scene(rows: Sequence[Row]) -> str:
    exact, best = next(row for row in rows if row["choice"] == EXACT.name), frontier(rows)
    heads = cycles_heads(rows)
    cells = [(f"**{row['choice']}**" if row in best else row["choice"], f"{100 * row['points']:.1f} %",
              "equal" if row["psnr_db"] is None else f"{row['psnr_db']:.2f}", f"{row['loss_db']:+.3f}", *cycles_cells(row),
              f"{exact['cycles'] / row['cycles']:.3f}", f"{exact[IDEAL_CYCLES] / row[IDEAL_CYCLES]:.3f}") for row in rows]
    head = ("choice", "points", f"PSNR against exact `{V3.name}`, dB", "loss, dB", *heads, "speed, LPDDR3", "speed, ideal")
    return table(head, cells, left=1) + (
        "\n\nBold: on the frontier of cycles with LPDDR3 and loss. Another support radius breaks hard cases by definition, and "
        "degree 0 breaks the one whose base colour is negative without harmonics ([reports/tradeoff.md](tradeoff.md)). "
        "All presets have other formats; with these, the order of equal depths changes some cycles.")


def _foveated(rows: Sequence[Row]) -> str:
    cells = []
    for row in rows:
        first = next(r for r in rows if (r["scene"], r["machine"]) == (row["scene"], row["machine"]))
        cells.append((row["scene"], f"`{row['machine']}`", row["degree"], *cycles_cells(row),
                      f"{first['cycles'] / row['cycles']:.3f}", f"{first[IDEAL_CYCLES] / row[IDEAL_CYCLES]:.3f}"))
    return table(("scene", "machine", "SH degree", *cycles_heads(rows), "speed, LPDDR3", "speed, ideal"), cells, left=2)
