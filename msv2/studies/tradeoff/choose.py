"""Conclusions from the measured points: losses, the Pareto frontier, and the fastest setting within a budget."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msv2.studies.tradeoff.knobs import BOTH_RENDERED, DEFAULT, PRESET

Row = dict[str, Any]

ASSUMED_PSNR_DB = 30.0
"""Assumed PSNR of a model against photographs where there are none. Better models are more sensitive to errors of
arithmetic."""

SAME_SPEED = 0.002
"""Relative difference of cycles below which two settings count as equally fast. The order of equal depths alone causes this
much."""

SAME_HVSQ = 0.001
"""Relative difference below which HVSQ counts as equal."""


@dataclass(frozen=True)
class Budget:
    """An accepted loss: decibels against the photographs, or a relative change of HVSQ in either direction."""

    name: str
    preset: str = ""
    decibels: float | None = None
    hvsq: float | None = None

    def holds(self, row: Mapping[str, Any]) -> bool:
        """Whether a row stays within the budget and breaks no hard case."""
        if row.get("error") or row["broken"]:
            return False
        if self.decibels is not None:
            return row["loss_db"] is not None and row["loss_db"] <= self.decibels
        return row["hvsq_change"] is not None and abs(row["hvsq_change"]) <= self.hvsq

    def loss(self, row: Mapping[str, Any]) -> float:
        """The loss of a row, in the budget's terms."""
        value = row["loss_db"] if self.decibels is not None else row["hvsq_change"]
        return math.inf if value is None else abs(value)


BUDGETS = (
    Budget("0.01 dB", "precise", decibels=0.01), Budget("0.1 dB", "balanced", decibels=0.1),
    Budget("0.5 dB", "fast", decibels=0.5), Budget("HVSQ equal", hvsq=SAME_HVSQ), Budget("HVSQ +5 %", hvsq=0.05))


def uncorrelated_psnr(psnr_oracle_db: float, model_db: float = ASSUMED_PSNR_DB) -> float:
    """PSNR against a photograph for which the float64 renderer has `model_db`, if both errors are uncorrelated."""
    return -10 * math.log10(10 ** (-psnr_oracle_db / 10) + 10 ** (-model_db / 10))


def with_losses(rows: Sequence[Row], *, psnr_photo: str = "psnr_photo_db") -> None:
    """Adds loss_db, loss_assumed, hvsq_change and speedup to every row, relative to the row's baseline.

    The baseline is the default's row, and for frames of two eyes the row with both eyes rendered. The loss is the larger of two
    values: the loss measured against the photographs, and the loss that follows from the distance to the float64 renderer if
    that is not correlated with the model's error. So a setting gains nothing if it happens to hide an error of one model.
    Variants are other models, for which the measured loss counts. HVSQ against the float64 renderer is almost zero for the
    default, so that without photographs there is no relative change.
    """
    default = next(row for row in rows if row["knob"] == DEFAULT)
    both = next((row for row in rows if row.get("threshold_deg") == BOTH_RENDERED), None)
    for row in rows:
        base = both if row.get("threshold_deg") is not None else default
        if row.get("error") or base is None or base.get("error"):
            row.update(loss_db=None, loss_assumed=False, hvsq_change=None, speedup=None)
            continue
        row["loss_assumed"] = row[psnr_photo] is None or base[psnr_photo] is None
        if row["loss_assumed"]:
            row["loss_db"] = _moved(base, row, ASSUMED_PSNR_DB)
        else:
            measured = base[psnr_photo] - row[psnr_photo]
            row["loss_db"] = measured if row.get("variant") else max(measured, _moved(base, row, base[psnr_photo]))
        against_photographs = not row["loss_assumed"] and row["hvsq"] is not None and base["hvsq"]
        row["hvsq_change"] = row["hvsq"] / base["hvsq"] - 1 if against_photographs else None
        row["speedup"] = base["cycles"] / row["cycles"]


def _moved(base: Row, row: Row, model_db: float) -> float:
    """The loss in decibels that follows from the distance to the float64 renderer."""
    return uncorrelated_psnr(base["psnr_oracle_db"], model_db) - uncorrelated_psnr(row["psnr_oracle_db"], model_db)


def pareto(points: Iterable[tuple[float, float]]) -> list[int]:
    """Indices of the points (cost, loss) that no other point beats, by ascending cost; smaller is better in both.

    Of equal points the first is taken. A point that is better than another one in neither value is left out.
    """
    points = list(points)
    order = sorted(range(len(points)), key=lambda i: (*points[i], i))
    best, front = math.inf, []
    for i in order:
        if points[i][1] < best:
            front.append(i)
            best = points[i][1]
    return front


def frontier(rows: Sequence[Row]) -> None:
    """Sets `pareto` in the rows: whether a row is on the frontier of cycles against loss in decibels.

    Only rows of one eye and of the scene's own model that break no hard case can be. Values are rounded to steps of SAME_SPEED
    and of a thousandth of a decibel. Of equal rows the first is taken, which favours the default.
    """
    for row in rows:
        row["pareto"] = False
    fit = [row for row in rows if _comparable(row) and not row["broken"] and row["loss_db"] is not None]
    step = math.log1p(SAME_SPEED)
    for i in pareto((round(math.log(row["cycles"]) / step), round(max(row["loss_db"], 0.0), 3)) for row in fit):
        fit[i]["pareto"] = True


def _comparable(row: Row) -> bool:
    if row.get("error") or row["knob"] == PRESET or not row.get("in_rtl", True):
        return False
    return row.get("threshold_deg") is None and not row.get("variant")


def _faster(row: Row, other: Row) -> bool:
    """Whether a row has fewer cycles; if both are equally fast, fewer bits, and then fewer basis functions."""
    ratio = row["cycles"] / other["cycles"]
    if abs(ratio - 1) > SAME_SPEED:
        return ratio < 1
    return _size(row) < _size(other)


def _size(row: Row) -> tuple[float, ...]:
    return row["word_bits"], row.get("functions", 0), row["loss_db"]


def candidate_parts(rows: Sequence[Row], budget: Budget) -> list[tuple[str, str]]:
    """For every knob its fastest setting within the budget that beats the default, ordered by ascending loss."""
    default = next(row for row in rows if row["knob"] == DEFAULT)
    best: dict[str, Row] = {}
    for row in rows:
        if not _comparable(row) or row["knob"] in (DEFAULT, "combination") or not budget.holds(row):
            continue
        if _faster(row, best.get(row["knob"], default)):
            best[row["knob"]] = row
    return [(row["knob"], row["value"]) for row in sorted(best.values(), key=budget.loss)]


def recommended(rows: Sequence[Row], budget: Budget) -> Row | None:
    """The fastest row of one eye within the budget. The default is within every budget, if it breaks no hard case."""
    found = None
    for row in rows:
        if _comparable(row) and budget.holds(row) and (found is None or _faster(row, found)):
            found = row
    return found
