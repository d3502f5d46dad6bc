"""Maps one module to gates or cells: repeats the flow until the clock is met or nothing can be made faster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path

from synth import flow, timing
from synth.memories import as_rows
from synth.settings import Settings

FASTER = 0.8
"""Factor on the time of a sum in each step in which it is made faster, because a path through it has negative slack."""

UNTIMED_BUDGET = 0.5
"""Share of the clock that a sum may take by its estimate if its slack is not known or only one run is made."""

Blocks = Mapping[str, Sequence[int]]


def to_gates(
    name: str, source: str, boxes: Sequence[str], scratch: Path, below: list[Path], blocks: Blocks | None, settings: Settings,
    is_timed: bool,
) -> dict:
    """The module as NAND2 equivalents; takes the arguments of `to_cells`, of which some are unused."""
    return _as_result(flow.count_nand2(source, name, scratch, boxes, settings.memory_limit), None)


def to_cells(
    name: str, source: str, boxes: Sequence[str], scratch: Path, below: list[Path], blocks: Blocks | None, settings: Settings,
    is_timed: bool,
) -> dict:
    """The module as library cells.

    As long as the clock is not met, each further run makes the sums on paths with negative slack one step faster, except where
    hints in `blocks` say how they are added. Where no sum can be made faster, the logic between them is balanced. The run with
    the best slack is returned; with equal slack or if the clock is met, the one with the smallest area.
    """
    (technology, liberty), found, is_timed = settings.library(), [], is_timed and timing.available()
    clock, balanced = settings.clock_ps, False
    budgets = {} if is_timed and settings.runs > 1 else {"": UNTIMED_BUDGET * clock / technology.delay}
    while True:
        folder = scratch / f"run{len(found)}"
        netlist = flow.synthesise(
            source, name, technology, liberty, folder, blocks or {}, boxes, budgets, settings.memory_limit, clock,
            balanced=balanced)
        if not is_timed:
            return _as_result(netlist, None)
        netlists = [*below, netlist.verilog]
        seen = timing.analyse(netlists, name, clock, technology, liberty, folder, bool(netlist.memories))
        found.append((min(seen.slack_ps, 0.0), -netlist.area, netlist, seen.slack_ps))
        late = {}
        for label in seen.late_sums & set(netlist.sums) if blocks is None else ():
            if netlist.sums[label].time <= budgets.get(label, inf):  # otherwise the sum is already as fast as it can be
                late[label] = FASTER * netlist.sums[label].time
        if seen.slack_ps >= 0 or len(found) == settings.runs or (balanced and not late):
            break
        balanced |= not late
        budgets |= late
    return _as_result(*max(found, key=lambda run: run[:2])[2:])


def _as_result(netlist: flow.Netlist, slack_ps: float | None) -> dict:
    sums = {label: cut._asdict() for label, cut in netlist.sums.items() if cut.blocks}
    return {"area": netlist.area, "cells_by_type": netlist.cells, "memories": as_rows(netlist.memories),
            "stores": netlist.stores, "sums": sums,
            "slack_ps": slack_ps, "netlist": str(netlist.verilog)}
