"""Estimates how long the rest of a chain of stages will take, from the seconds that iterations of each kind of stage took.

An iteration costs differently from one kind of stage to another, and differently as points come and go. So each kind has a
moving mean of its own. A kind that has not begun is estimated from the kinds that have, by what iterations of both cost in
other runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

USUAL = {"dense": 1.0, "prune": 0.75, "scale-decay": 0.65, "finetune": 1.6, "level": 2.6, "separate": 1.2}
"""What an iteration of each kind of stage costs, with one of dense training as the unit: seconds over iterations in
`reports/training.json` and `training_fern.json`, the geometric mean of both scenes. It counts only until a kind's own
iterations have been measured."""

OTHER = 1.0
"""The same for a kind of which nothing is known."""

MEMORY = 0.995
"""Weight of what was measured before at each iteration: the mean extends over about 200, in which there are
several checks of a gate."""


def kind_of(stage: str) -> str:
    """The kind of a stage by its name: level2, level3-plain and level4 are alike, as are prune and prune-count."""
    return next((kind for kind in USUAL if re.match(rf"{kind}(\d|-|$)", stage)), stage)


class Remaining:
    """The seconds that are left of a chain.

    Args:
        plan: name and expected iterations of each stage, in order; the names are unique.
        spent: `iterations` and `seconds` of the stages that an earlier run of the chain has begun.
    """

    def __init__(self, plan: Sequence[tuple[str, int]], spent: Mapping[str, Mapping[str, float]] | None = None) -> None:
        self._plan = tuple(plan)
        self._seconds: dict[str, float] = {}
        self._weight: dict[str, float] = {}
        for name, each in (spent or {}).items():
            if each["iterations"]:
                self._add(name, each["seconds"], each["iterations"])

    def took(self, stage: str, seconds: float) -> None:
        """Takes note of the duration of an iteration of a stage."""
        self._add(stage, seconds, 1)

    def _add(self, stage: str, seconds: float, iterations: float) -> None:
        kind, kept = kind_of(stage), MEMORY**iterations
        weight = (1 - kept) / (1 - MEMORY)  # of that many iterations in a row of the same duration
        self._seconds[kind] = kept * self._seconds.get(kind, 0.0) + weight * seconds / iterations
        self._weight[kind] = kept * self._weight.get(kind, 0.0) + weight

    def rate(self, stage: str) -> float | None:
        """Seconds for an iteration of a stage: as measured for its kind, or by the measured kinds; None before any
        measurement."""
        kind = kind_of(stage)
        if kind in self._weight:
            return self._seconds[kind] / self._weight[kind]
        if not self._weight:
            return None
        usual = sum(weight * USUAL.get(other, OTHER) for other, weight in self._weight.items())
        return sum(self._seconds.values()) / usual * USUAL.get(kind, OTHER)

    def seconds(self, stage: str, done: int) -> float | None:
        """Seconds from the iteration `done` of a stage to the end of the chain; None before any measurement."""
        names = [name for name, _ in self._plan]
        total, first = 0.0, names.index(stage)
        for index, (name, iterations) in enumerate(self._plan[first:]):
            left = max(iterations - done, 0) if index == 0 else iterations
            rate = self.rate(name)
            if rate is None:
                return None
            total += left * rate
        return total
