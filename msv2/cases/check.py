"""Runs the cases on the oracle and on the integer renderer."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from golden.msv2_ref import pipeline, projection
from golden.oracle import render as oracle
from msv2.cases.case import RENDERERS, Album, Case, CaseFailure, Renderer, Seen, Shot, require
from spec.config import TINY, AcceleratorConfig

MACHINE: AcceleratorConfig = TINY
"""The configuration whose integer renderer and RTL run the cases. Its formats are those of every configuration."""


@dataclass(frozen=True)
class Cell:
    """The result of a case in a column.

    Attributes:
        outcome: "pass", "FAIL", or "-" where the case has no part in the column.
        error: the largest difference to the oracle's image, where there is one.
        words: the reason why it failed, or why it has no part.
        seconds: wall time.
        crashed: whether it failed by another exception than CaseFailure.
    """

    outcome: str
    error: float | None = None
    words: str = ""
    seconds: float = 0.0
    crashed: bool = False


def see_oracle(shot: Shot, weights: str = "plane") -> Seen:
    """Renders a shot with the float64 renderer; `weights` is the argument of `render` for blend tiles."""
    frame = oracle.render(shot.model, shot.camera, foveation=shot.foveation, weights=weights, background=shot.background,
                          tile_test="obb" if shot.obb else "exact")
    require(frame.visible + sum(frame.culled.values()) == len(shot.model), f"{frame.culled} must account for every point")
    return Seen(frame.image, frame.coverage, frame.depth, frame.culled["near"], frame.culled["transparent"], frame.visible,
                frame.entries, frame.tile_intersections.ravel(), frame)


def see_golden(shot: Shot) -> Seen:
    """Renders a shot with the integer renderer."""
    frame = pipeline.render(shot.model, shot.camera, config=MACHINE, foveation=shot.foveation, background=shot.background,
                            beta=shot.beta, obb=shot.obb)
    reason, n = frame.projected.reason, MACHINE.formats
    require(len(reason) == len(shot.model) and (reason <= projection.UNREAD).all(), "every point must have a reason")
    require(np.isfinite(frame.projected.conic).all(), "conics must be finite")
    counts = np.diff(frame.entries.start)
    coverage = n.transmittance.to_float(n.transmittance.raw_max) - frame.transmittance
    near, faint = int((reason == projection.NEAR).sum()), int((reason == projection.FAINT).sum())
    return Seen(frame.image, coverage, frame.depth, near, faint,
                len(np.unique(frame.entries.splat)), len(frame.entries.splat), counts, frame)


SEE: Mapping[str, Callable[[Shot], Seen]] = {"oracle": see_oracle, "golden": see_golden}


def album(case: Case, renderer: Renderer, see: Callable[[Shot], Seen]) -> Album:
    """Renders a case's shots and checks what holds for any frame: finite, within bounds, and covered unless meant to be
    empty."""
    shots = case.shots(renderer)
    seen = {name: see(shot) for name, shot in shots.items()}
    for name, picture in seen.items():
        shown = picture.image
        require(np.isfinite(shown).all() and (shown >= 0).all(), f"{name}: the image must be finite and not negative")
        if picture.coverage is not None:
            covered = picture.coverage
            require(shots[name].empty or covered.any(), f"{name}: nothing is covered, so nothing is tested")
            require(((covered >= -renderer.error) & (covered <= 1)).all(), f"{name}: coverage must be in 0..1")
    return seen


def worst_error(case: Case, renderer: Renderer, seen: Album) -> float | None:
    """The largest difference of a shot's image to the oracle's. Raises CaseFailure where it is above the shot's `rim`."""
    errors = []
    for name, shot in case.shots(renderer).items():
        if shot.rim is None:
            continue
        exact = see_oracle(shot, renderer.weights).image
        error = float(np.abs(np.minimum(seen[name].image, renderer.largest_colour)
                             - np.minimum(exact, renderer.largest_colour)).max())
        require(error <= shot.rim, f"{name}: {error * 255:.2f}/255 off the oracle, more than {shot.rim * 255:.2f}/255")
        errors.append(error)
    return max(errors, default=None)


def check_shots(case: Case, renderer: Renderer, see: Callable[[Shot], Seen]) -> float | None:
    """Checks a case's shots with one renderer. Returns the worst error; raises CaseFailure where an expectation fails."""
    seen, shots = album(case, renderer, see), case.shots(renderer)
    case.expect(seen, renderer, shots)
    first = next(iter(shots))
    require(np.array_equal(seen[first].image, see(shots[first]).image), "twice the same shot must give the same image")
    return None if renderer.name == "oracle" else worst_error(case, renderer, seen)


def run(case: Case, column: str) -> float | None:
    """Runs a case in the column `oracle` or `golden`. Returns the worst error; raises CaseFailure where an expectation
    fails."""
    errors = []
    if case.shots is not None and column in case.columns:
        errors.append(check_shots(case, RENDERERS[column], SEE[column]))
    if column in case.checks:
        errors.append(case.checks[column]())
    return max((error for error in errors if error is not None), default=None)


def takes_part(case: Case, column: str) -> bool:
    """Whether the case is run in the column `oracle` or `golden`."""
    return column in case.checks or (case.shots is not None and column in case.columns)


def cell(case: Case, column: str) -> Cell:
    """Runs a case in the column `oracle` or `golden`; a failure is returned instead of raised."""
    if not takes_part(case, column):
        return Cell("-", words=case.absent.get(column, "no part in it"))
    return told_cell(lambda: run(case, column))


def told_cell(work: Callable[[], float | None]) -> Cell:
    """Runs `work`, which returns the worst error; a failure is returned instead of raised."""
    begin = time.perf_counter()
    try:
        error = work()
    except CaseFailure as failure:
        return Cell("FAIL", words=str(failure), seconds=time.perf_counter() - begin)
    except Exception as failure:  # a crash is a failure of this case; the other cases still run
        words = f"{type(failure).__name__}: {failure}"
        return Cell("FAIL", words=words, seconds=time.perf_counter() - begin, crashed=True)
    return Cell("pass", error, seconds=time.perf_counter() - begin)
