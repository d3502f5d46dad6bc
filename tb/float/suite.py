"""The tests of the floating-point units: every operation with millions of operands, with gaps between them, and across a
reset."""

from __future__ import annotations

from functools import cache

import numpy as np

from rtl.emit import to_verilog
from spec.config import DEFAULT, PAPER, TINY, AcceleratorConfig
from tb.common import exact
from tb.common.exact import Outcome, Planned, planned
from tb.common.patterns import Pattern
from tb.common.playback import Playback, Stream
from tb.float.device import FloatBench, operations
from tb.float.stimuli import operands, results

VARIANTS: dict[str, AcceleratorConfig] = {"tiny": TINY, "default": DEFAULT, "paper": PAPER}
"""Configurations whose formats can be tested."""

DISTINCT = ("tiny",)
"""One configuration suffices, because all have the same formats."""

RANDOM_OPERANDS, QUICK_OPERANDS, FEW_OPERANDS = 500_000, 20_000, 5_000
"""The number of random operands of an operation in the run at full rate, the same in quick tests, and that of operands in each
of the other runs."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The units, with a file at each stream. `tb.common.emission` does not cache them: its key covers rtl/ and spec/ only."""
    records = {name: operation.records(name) for name, operation in operations(config).items()}
    return Playback(
        name="float", module="float_bench", verilog=to_verilog(FloatBench(config), "float_bench"),
        inputs=tuple(Stream(f"{name}_in", pair[0]) for name, pair in records.items()),
        outputs=tuple(Stream(f"{name}_out", pair[1]) for name, pair in records.items()))


def _plan_of(
    config: AcceleratorConfig, name: str, rows: dict[str, np.ndarray], pattern: Pattern = Pattern.NEVER, seed: int = 0,
    **options: object,
) -> Planned:
    units = operations(config)
    inputs = {f"{unit}_in": values for unit, values in rows.items()}
    wanted = {f"{unit}_out": results(unit, units[unit], values) for unit, values in rows.items()}
    patterns = {port: (pattern, seed + i) for i, port in enumerate(inputs)}
    return planned(name, inputs, wanted, patterns=patterns, quiet=50, **options)


def full_plan(config: AcceleratorConfig, seed: int, count: int = RANDOM_OPERANDS) -> list[Planned]:
    """A run at full rate with random operands and every significand, runs with gaps, a run cut off by a reset, and one after
    it."""
    many = {name: operands(name, unit, count, seed + i) for i, (name, unit) in enumerate(operations(config).items())}
    few = {name: rows[:FEW_OPERANDS] for name, rows in many.items()}
    plan = [_plan_of(config, "full rate", many)]
    for pattern in (Pattern.ALWAYS, Pattern.RANDOM, Pattern.BURSTY):
        plan.append(_plan_of(config, f"{pattern.value} bubbles", few, pattern, seed))
    return [*plan, _plan_of(config, "cut off", few, abort=77), _plan_of(config, "after the reset", few)]


def quick_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The same with fewer random operands."""
    return full_plan(config, seed, QUICK_OPERANDS)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per operation with its latency and its number of results."""
    whole = [item for item in plan if item.name in outcome.recordings]
    return [f"{name}: latency {operation.kind.latency}, {sum(len(item.expected[f'{name}_out']) for item in whole)} results"
            for name, operation in operations(config).items()]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
