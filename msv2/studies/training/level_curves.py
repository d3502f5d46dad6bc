"""HVSQ of a level against its points during its training, which shows the gain of opacity enhancement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class LevelCurve:
    """The lowest HVSQ that training reached at each number of points.

    Attributes:
        level: the level, 2 to 4, where L1 is 1.
        points: the numbers of points, in ascending order.
        hvsq: the ratio of HVSQ on the gate's validation views to its target; at most 1 passes.
        kept: the number of points of the final level.
    """

    level: int
    points: tuple[int, ...]
    hvsq: tuple[float, ...]
    kept: int


def level_curves(records: Iterable[Mapping[str, Any]], counts: Sequence[int], suffix: str = "") -> tuple[LevelCurve, ...]:
    """The curves of the levels from 2 on, from the log of a chain.

    An evaluation at the gate is logged with the iteration after it, which may have pruned. So it belongs to the points of the
    iteration before. The last evaluation is that of the result.

    Args:
        records: the records of the log, in order.
        counts: the points of each final level, L1 first.
        suffix: the suffix of the stages' names.
    """
    by_stage: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        by_stage.setdefault(record["stage"], []).append(record)
    curves = []
    for level in range(2, len(counts) + 1):
        own = by_stage.get(f"level{level}{suffix}", [])
        best: dict[int, float] = {}
        before = counts[level - 2]
        for place, record in enumerate(own):
            points = int(record["points"]) if place == len(own) - 1 else before
            if "hvsq" in record:
                best[points] = min(best.get(points, float("inf")), record["hvsq"] / record["target"])
            before = int(record["points"])
        if best:
            curves.append(LevelCurve(level, tuple(sorted(best)), tuple(best[n] for n in sorted(best)), counts[level - 1]))
    return tuple(curves)
