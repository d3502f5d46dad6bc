"""The hard cases on the differentiable renderer: images, finite gradients, the oracle's derivatives."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from msv2.cases.gradients import FAULTS, caught, run, takes_part
from msv2.cases.registry import CASES, case_named

QUICK = {1, 6, 9, 11, 14, 17, 18, 21, 23, 28, 32, 40}
"""Numbers of the cases of the quick tests."""

SHOWN = [case for case in CASES if takes_part(case)]


@pytest.mark.parametrize("case", [
    pytest.param(case, id=case.id, marks=() if case.number in QUICK else pytest.mark.long) for case in SHOWN])
def test_case(case):
    run(case)


def test_cases_without_a_part_say_why():
    assert all(case.absent["gradient"] for case in CASES if not takes_part(case))
    assert takes_part(case_named("alpha-one-backward")) and len(SHOWN) > 40


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_seeded_fault_turns_its_case_red(fault):
    seen, words = caught(fault)
    assert seen, words
