"""The handover's tests. What goes in must come out in the expected number of cycles, through the line buffer and through the
double buffer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from spec.config import PAPER_SMALL, TINY, AcceleratorConfig
from spec.records import chunk_item
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.sort_tmu.chunk_stimuli import items_of, random_chunks

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "tiny-double": TINY.with_(incremental=False), "paper_small": PAPER_SMALL,
    "paper_small-double": PAPER_SMALL.with_(incremental=False)}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "tiny-double")
"""Configurations with different units. PAPER_SMALL's line buffer equals TINY's, and its double buffer is only longer."""

PORTS = ("sink", "source")


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The buffer of a configuration, emitted as Verilog, with a file at each stream."""
    record = chunk_item(config)
    return Playback(
        name=f"handover-{'line' if config.incremental else config.sort_chunk}", module="handover",
        verilog=emitted("handover", config), inputs=(Stream("sink", record),),
        outputs=(Stream("source", record),), observed=(("busy", 1),))


def plan_of(config: AcceleratorConfig, name: str, items: np.ndarray, **options: object) -> Planned:
    """The run that passes items; `options` are those of `planned`."""
    return planned(name, {"sink": items}, {"source": items}, observed={"busy": 0}, **options)


def cycles_of(config: AcceleratorConfig, items: np.ndarray) -> int:
    """Cycles of a run without pauses whose first item is offered after one cycle. A line buffer takes two cycles more than
    there are items. A half of a double buffer is filled once it is free and the previous half is full; it is read once it is
    full and the previous half has been read."""
    if config.incremental:
        return 1 + len(items) + 2
    top = config.sort_chunk
    lengths: list[int] = []
    for length in np.diff(np.concatenate(([0], np.flatnonzero(items["last"]) + 1))).tolist():
        lengths += [min(top, length - start) for start in range(0, length, top)]
    taken = left = 0  # cycles after which the last entry was accepted, and after which it left
    free = [0, 0]  # the cycles from which each half may be written
    for number, length in enumerate(lengths):
        taken = max(taken, free[number % 2]) + length
        left = max(left, taken + 1) + length
        free[number % 2] = left
    return 1 + left


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Groups of every kind of length at full speed, with pauses, cut off by resets, and back to back."""
    rng, top = np.random.default_rng(seed), config.sort_chunk
    lengths = {
        "equal": [top // 2] * 6, "long and short": [top, 1, top, 0, 0, 2, top - 1, 1, 1, top + 1, 3],
        "larger than a half": [3 * top + 2, 2 * top, top + 1, top], "short": rng.integers(0, 5, 300).tolist(),
        "any": rng.integers(0, 2 * top, 12).tolist()}
    plan = []
    for name, values in lengths.items():
        items = items_of(config, random_chunks(config, rng, values))
        plan.append(plan_of(config, f"{name} groups", items, most_cycles=cycles_of(config, items)))
    streams = items_of(config, random_chunks(config, rng, [*rng.integers(0, min(top, 300), 12).tolist(), top + 5, 0, 1]))
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, name, streams, patterns=patterns, reset=False))
    for cycles in (3, top // 2, top + 20, 2 * top):
        plan.append(plan_of(config, f"cut off after {cycles} cycles", streams, abort=cycles))
        plan.append(plan_of(config, f"groups after a reset at {cycles}", streams))
    for k in range(3):
        plan.append(plan_of(config, f"back to back {k}", streams, reset=False, quiet=0))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: Sequence[Planned], outcome: Outcome) -> list[str]:
    """One line per run without pauses with its cycles."""
    lines = []
    for item, recording in exact.recorded(plan, outcome):
        if item.most_cycles is not None:
            entries = len(item.run.inputs["sink"])
            lines.append(f"{item.name}: {entries} items, {entries / recording.cycles:.4f} a cycle in {recording.cycles} cycles")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
