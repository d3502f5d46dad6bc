"""What is said of a whole machine's timing: as a dictionary, as printed lines, and as the verdict of the budget rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict

from spec.command_line import choice
from synth.budget import compare
from synth.known_late import KNOWN_LATE
from synth.linked import LinkedTiming
from synth.whole import REFRESH, WholeTiming, budgets, stale

SHOWN_PAIRS = 25
"""Pairs of units in printed tables."""


def of_corner(found: LinkedTiming) -> dict[str, object]:
    """The numbers of one corner, without the text of the worst path."""
    kept = asdict(found)
    del kept["path"], kept["corner"], kept["early"]
    return {"slack_ps": kept.pop("slack_ps"), "late_endpoints": kept.pop("late_endpoints"), "ghz": round(found.ghz, 4),
            "zero_slack_ps": round(found.zero_slack_ps, 1), **kept}


def summary(found: WholeTiming) -> dict[str, object]:
    """The numbers of a machine at all corners."""
    return {"modules": found.modules, "instances": found.instances, "cells": found.cells,
            "mapped_ps": found.mapped_ps, "logic_um2": round(found.logic_um2, 1),
            "hold_buffers": found.hold_buffers, "hold_um2": found.hold_um2,
            "overloaded_nets": len(found.overloads), "overloads": [asdict(one) for one in found.overloads[:SHOWN_PAIRS]],
            **{name: of_corner(one) for name, one in found.linked.items()}}


def lines(found: WholeTiming) -> list[str]:
    """The printed lines of a machine."""
    said = []
    for name, one in found.linked.items():
        said += [
            f"{found.config}, {name}: slack {one.slack_ps:.1f} ps at {one.clock_ps:.0f} ps with {one.uncertainty:.0%} "
            f"uncertainty, {one.ghz:.2f} GHz; {one.late_endpoints:,} late endpoints; hold {one.hold_slack_ps:.1f} ps, "
            f"{one.hold_endpoints:,} endpoints; {one.slew_nets:,} nets with slow transitions",
            *(f"  {pair.slack_ps:8.1f} ps {pair.endpoints:6,} endpoints  {' > '.join(pair.through)}"
              for pair in one.pairs[:SHOWN_PAIRS]),
            *([f"  and {len(one.pairs) - SHOWN_PAIRS} more pairs"] if len(one.pairs) > SHOWN_PAIRS else [])]
    worst = found.overloads[:1]
    return [*said, f"{found.config}: {len(found.overloads)} nets beyond their driver's limit" + "".join(
        f", the worst {one.module}.{one.net}: {one.load_ff:.0f} of {one.limit_ff:.0f} fF" for one in worst)]


def verdict(config: str) -> tuple[list[str], list[str]]:
    """What a machine's stored interfaces say: the pairs of units that are late, and what is wrong with them or their list.

    Raises:
        InputError: there are no stored interfaces.
    """
    budget = budgets()[config]
    found = budget.late()
    late = [f"{config}: {pair.excess_ps:4} ps  {pair.start} > {pair.end}: {' > '.join(pair.way)}" for pair in found]
    old = stale(budget)
    wrong = [f"{config}: the RTL of {', '.join(old)} has changed since it was measured: `{REFRESH}`"] if old else []
    return late, wrong + [f"{config}: {line}" for line in compare(found, KNOWN_LATE.get(config, {}))]


def check_budgets(configs: Sequence[str], say: Callable[[str], None]) -> int:
    """Says what the budget rule finds in these machines, or in all; returns 1 if something is wrong that is not known."""
    named = [choice("config", name, budgets()) for name in configs] or list(budgets())
    status = 0
    for name in named:
        late, wrong = verdict(name)
        for line in late:
            say(line)
        say(f"{name}: {len(late)} pairs of units are late, {len(wrong)} of them or of their list are wrong")
        for line in wrong:
            say(line)
        status |= bool(wrong)
    return int(status)
