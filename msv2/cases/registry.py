"""All cases that renderers can run. `msv2.cases.streams` has those of the machine alone."""

from __future__ import annotations

from msv2.cases import (
    chunks,
    colour,
    compact,
    coverage,
    eyes,
    guard_band,
    inputs,
    order,
    projection,
    raw_words,
    saturated,
    self_check,
    supertiles,
)
from msv2.cases.case import Case

CASES: tuple[Case, ...] = tuple(sorted(
    (case for part in (
        projection, coverage, inputs, colour, saturated, order, eyes, self_check, chunks, compact, supertiles, guard_band,
        raw_words)
     for case in part.CASES),
    key=lambda case: case.id))


def case_named(name: str) -> Case:
    """The case with this name or id. Raises KeyError where there is none."""
    for case in CASES:
        if name in (case.name, case.id):
            return case
    raise KeyError(f"case {name!r} is not accepted: choose one of {', '.join(case.id for case in CASES)}")
