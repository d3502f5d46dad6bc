"""The testbench of the float units: its oracles against rational arithmetic, its plan through Verilator."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from spec.config import TINY
from spec.formats import SmallFloat
from tb.float.device import operations
from tb.float.stimuli import operands, results
from tb.float.suite import full_plan, run_plan
from tests.helpers.float_units import BINARY, expected, value

OPERATIONS = operations(TINY)


@pytest.mark.parametrize("name", [name for name, operation in OPERATIONS.items() if operation.kind in BINARY])
def test_what_is_expected_is_exact(name):
    operation = OPERATIONS[name]
    rows = operands(name, operation, 400, 1)
    wanted = results(name, operation, rows)
    for row, result in zip(rows, wanted, strict=True):
        a, b = (value(operation.operands[port], int(row[port])) for port in "ab")
        sign = -1 if "subtract" in rows.dtype.names and row["subtract"] else 1
        exact = BINARY[operation.kind](a, b * sign)
        assert expected(operation.result, exact) == (result["result"], result["saturated"]), row


def test_sums_with_a_longer_operand_are_exact():
    """The case that float64 alone gets wrong is among the stimuli."""
    operation = OPERATIONS["add_view_work"]
    rows = operands("add_view_work", operation, 100_000, 2)
    a, b = (operation.operands[port].to_float(rows[port]) for port in "ab")
    doubly = operation.result.quantise(np.where(rows["subtract"], a - b, a + b))
    wrong = rows[doubly.astype(np.int64) != results("add_view_work", operation, rows)["result"]]
    assert len(wrong) > 10
    for row, result in zip(wrong, results("add_view_work", operation, wrong), strict=True):
        exact = value(operation.operands["a"], int(row["a"])) + value(operation.operands["b"], int(row["b"])) * (
            -1 if row["subtract"] else 1)
        assert expected(operation.result, Fraction(exact)) == (result["result"], result["saturated"]), row


def test_stimuli_reach_every_end():
    """Saturated results, flushed ones, zeros of exact cancellation and ordinary ones all occur."""
    for name in ("add_view", "mul_work", "divide_work"):
        operation = OPERATIONS[name]
        rows = operands(name, operation, 20_000, 3)
        got, number = results(name, operation, rows), operation.result
        assert isinstance(number, SmallFloat)
        a, b = (operation.operands[port].to_float(rows[port]) for port in "ab")
        zero = (got["result"] == 0) & (a != 0) & (b != 0)
        assert min(got["saturated"].sum(), zero.sum(), ((got["result"] != 0) & (got["saturated"] == 0)).sum()) > 100, name


@pytest.mark.long
def test_every_unit_through_verilator(tmp_path):
    outcome = run_plan(TINY, full_plan(TINY, 1, 50_000), tmp_path)
    assert outcome.failures == {} and outcome.runs == 5
