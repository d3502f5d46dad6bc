"""The project's targets for training with the measured values, as Markdown; verdicts are computed. The module needs no
torch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msv2.studies.training import labels
from msv2.studies.training.labels import reached

Row = tuple[str, str, str]
"""The target, the measured value, and the verdict."""


def targets_rows(scene: Mapping[str, Any]) -> Iterator[Row]:
    """The targets about which a scene's record has data. All are measured on test views, except the evaluations at gates.

    Args:
        scene: a record of `msv2.studies.training.tables.measure_scene`.
    """
    if "ablation" in scene and scene["scene"] in labels.TARGET_DENSE_PSNR:
        least, psnr = labels.TARGET_DENSE_PSNR[scene["scene"]], scene["ablation"][0]["psnr"]
        yield f"dense PSNR >= {least:g} dB", f"{psnr:.2f} dB", reached(psnr >= least)
    yield from _pruning(scene.get("pruning", ()))
    if "comparison" in scene:
        yield from _levels({row["method"]: row for row in scene["comparison"]}, scene["fewer_percent"])


def _pruning(rows: Sequence[Mapping[str, Any]]) -> Iterator[Row]:
    for row in rows:
        if row["tuned"]:
            for asked, measured, good in own_targets(row):
                yield f"L1 of {row['variant']}: {asked}", measured, reached(good)
    for row in rows:
        if row["criterion"] in labels.PUBLISHED and row["equal"] is not None:
            asked, measured, good = equal_target(row)
            yield f"{asked} than by {labels.CRITERION_LABELS[row['criterion']]}", measured, reached(good)


def own_targets(row: Mapping[str, Any]) -> Iterator[tuple[str, str, bool]]:
    """For one of our rows in the pruning table, its targets, the measured values, and whether they are reached."""
    least, cut = labels.TARGET_PSNR_PERCENT[row["variant"]], labels.TARGET_CUT.get(row["variant"])
    yield f"PSNR >= {least:g} % of dense", f"{row['psnr_percent']:.2f} %", row["psnr_percent"] >= least
    if cut is not None:
        yield f"intersections cut >= {cut:g} times", f"{row['cut']:.2f} times", row["cut"] >= cut


def equal_target(row: Mapping[str, Any]) -> tuple[str, str, bool]:
    """The same for a baseline's row: the target for our loop at the baseline's PSNR, on the gate's views."""
    equal, asked = row["equal"], "ours needs fewer intersections at equal PSNR"
    if equal["ours"] is None:
        return asked, f"ours never looked at {equal['psnr']:.2f} dB", False
    times = equal["entries"] / max(equal["ours"], 1.0)
    share = f"{times:.2f} times fewer" if times > 1 else f"{1 / times:.2f} times as many"
    return asked, f"{share} at {equal['psnr']:.2f} dB", times > 1


def _levels(by_method: Mapping[str, Mapping[str, Any]], fewer: Sequence[float]) -> Iterator[Row]:
    ours, smfr = by_method[labels.OURS], by_method[labels.SMFR]
    for views, hvsq in (("validation", ours["hvsq_validation"]), ("test", ours["hvsq"])):
        limit = labels.TARGET_HVSQ_EXCESS_PERCENT[views]
        excess = [100 * (value / hvsq[0] - 1) for value in hvsq[1:]]
        yield (f"HVSQ of L2, L3, L4 <= {limit:g} % above L1's, {views} views", ", ".join(f"{value:+.1f} %" for value in excess),
               reached(max(excess) <= limit))
    over = ours["over_l1_percent"]
    yield (f"storage <= {labels.TARGET_STORAGE_PERCENT:g} % over L1's", f"{over:+.1f} %",
           reached(over <= labels.TARGET_STORAGE_PERCENT))
    times = smfr["hvsq"][-1] / ours["hvsq"][-1]
    yield (f"SMFR's HVSQ of L4 several times ours (>= {labels.TARGET_SMFR_TIMES:g})", f"{times:.2f} times",
           reached(times >= labels.TARGET_SMFR_TIMES))
    yield ("opacity enhancement leaves fewer points in L3 and L4", ", ".join(f"{-value + 0.0:+.1f} %" for value in fewer[2:]),
           reached(min(fewer[2:]) > 0))
