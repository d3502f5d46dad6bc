"""Case 57: a case that shows nothing tests nothing, so it must fail."""

from __future__ import annotations

from msv2.cases.case import RENDERERS, Case, CaseFailure, Shot, require
from msv2.cases.check import SEE, check_shots
from msv2.cases.makers import splats, view


def _blind(column: str) -> None:
    """A case whose model is behind the camera, and which is not marked as empty, must fail for its missing coverage."""
    case = Case(0, "blind", "", "", shots=lambda renderer: {"shot": Shot(splats((0, 0, -1)), view())},
                expect=lambda album, renderer, shots: None)
    try:
        check_shots(case, RENDERERS[column], SEE[column])
    except CaseFailure as failure:
        require("nothing is covered" in str(failure), f"it must fail for its coverage, not {failure}")
    else:
        require(False, "a case without coverage must fail")


NO_COVERAGE_FAILS = Case(
    57, "no-coverage-fails", "a case on a frame in which nothing is covered, without saying so", "fails by design",
    checks={"oracle": lambda: _blind("oracle"), "golden": lambda: _blind("golden")}, rtl=False,
    absent={"gradient": "the same harness", "rtl": "is compared with golden frames, which have coverage by this case"})

CASES = (NO_COVERAGE_FAILS,)
