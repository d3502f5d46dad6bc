"""The hard cases on the oracle and the integer renderer; on the differentiable one: test_training_stability.py."""

from __future__ import annotations

import pytest

from msv2.cases.check import Cell, run, takes_part
from msv2.cases.golden_faults import FAULTS, caught, told
from msv2.cases.registry import CASES, case_named

NUMBERS = set(range(1, 78)) - {53, 54, 55, 58}
"""Of the list in docs/stability.md, without those of the machine alone and of the seeded faults."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
@pytest.mark.parametrize("column", ["oracle", "golden"])
def test_case(case, column):
    if takes_part(case, column):
        run(case, column)
    else:
        assert case.absent[column]


def test_every_hard_case_is_there_once():
    assert {case.number for case in CASES} == NUMBERS
    assert len({case.id for case in CASES}) == len(CASES)
    assert all(case.what and case.expected for case in CASES)
    assert all(takes_part(case, "golden") or takes_part(case, "oracle") for case in CASES)
    assert case_named("banding") is case_named("20-banding")
    with pytest.raises(KeyError, match="'nothing' is not accepted"):
        case_named("nothing")


@pytest.mark.parametrize("fault", [pytest.param(fault, id=f"{fault.column}: {fault.name}") for fault in FAULTS])
def test_seeded_fault_turns_its_case_red(fault):
    run(case_named(fault.case), fault.column)
    seen, words = caught(fault)
    assert seen, words


def test_a_crash_catches_no_fault():
    assert told(Cell("FAIL")) and not told(Cell("FAIL", crashed=True)) and not told(Cell("pass"))
