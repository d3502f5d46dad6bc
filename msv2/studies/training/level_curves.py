"""HVSQ of a level against its points, as the gate saw it while the level was made: what opacity enhancement buys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class LevelCurve:
    """The lowest HVSQ that training reached at each number of points.

    Attributes:
        level: 1-based, 2 to 4.
        points: fewest first.
        hvsq: on the gate's validation views, over its target: at most 1 passes.
        kept: points of the level that came out.
    """

    level: int
    points: tuple[int, ...]
    hvsq: tuple[float, ...]
    kept: int


def level_curves(records: Iterable[Mapping[str, Any]], counts: Sequence[int], suffix: str = "") -> tuple[LevelCurve, ...]:
    """The curves of levels 2 on, from a chain's log.

    A look at the gate is logged with the iteration after it, which may have pruned: what was looked at are the points of the
    iteration before. The last look is at the result.

    Args:
        records: of the log, in order.
        counts: points of each level that came out, L1 first.
        suffix: of the stages' names.
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
