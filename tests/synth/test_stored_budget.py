"""The stored interfaces of the machines: they are of today's RTL, and the pairs of units that are late are the known ones."""

from __future__ import annotations

import pytest

from synth.__main__ import main
from synth.known_late import KNOWN_LATE
from synth.whole import STORE, budgets
from synth.whole_report import verdict


def test_there_is_a_list_for_every_stored_machine() -> None:
    assert "paper" in budgets() and set(budgets()) == set(KNOWN_LATE)


SHORT = ("paper", "v3_eyes_warp")
"""Machines that have a unit of every name; those of the others differ in their parameters, and are for the long tests."""


@pytest.mark.parametrize("name", [
    name if name in SHORT else pytest.param(name, marks=pytest.mark.long) for name in sorted(budgets())])
def test_the_units_of_a_machine_fit_into_its_clock(name: str) -> None:
    """Except for the pairs of `synth.known_late`, which are exactly as late as is said there; and the numbers are of today."""
    assert verdict(name)[1] == []


def test_the_command_says_what_is_late(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--budget", "--config", "paper"]) == 0
    shown = capsys.readouterr().out
    pair = max(KNOWN_LATE["paper"].items(), key=lambda item: item[1])
    assert f"paper: {pair[1]:4} ps  {pair[0][0]} > {pair[0][1]}: " in shown
    assert f"{len(KNOWN_LATE['paper'])} pairs of units are late, 0 of them" in shown and STORE.is_file()
