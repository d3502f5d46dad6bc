"""The tile merge unit's tests: every frame's groups are compared with the golden renderer's."""

from __future__ import annotations

from functools import cache
from math import isqrt

import numpy as np

from spec.config import PAPER, PAPER_SMALL, TINY, TINY_V3, V3, AcceleratorConfig
from spec.records import COUNT_BITS, frame_lists, intersection_tile, tile_group
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, backpressure, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames, traced_size
from tb.sort_tmu.tile_merge_stimuli import (
    Case,
    average_cases,
    case_of,
    corner_cases,
    random_case,
    shape_cases,
    threshold_cases,
)

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER, "tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper", "tiny_v3")
"""Configurations with the smallest and the largest frames, and with the fewest lists; the others are between."""

PORTS = ("hits", "groups")

_SETTLING = 80
"""Most cycles of a frame in addition to one per intersection and one per tile: the division that computes the threshold, and
the registers of both stages."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    bits = frame_lists(config).bit_length()
    return Playback(
        name=f"tmu-{frame_lists(config)}", module="tile_merge_unit",
        verilog=emitted("tile_merge_unit", config),
        inputs=(Stream("hits", intersection_tile(config)),), outputs=(Stream("groups", tile_group(config)),),
        settings=(("tiles_x", bits), ("tile_count", bits), ("beta", COUNT_BITS), ("auto", 1)),
        observed=(("saturated", 1), ("outside", 1), ("beta_used", COUNT_BITS), ("busy", 1)))


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(
        name or case.name, {"hits": case.items(config)}, {"groups": case.groups(config)}, observed=case.observed(config),
        settings=case.settings, **options)


def _widest(config: AcceleratorConfig) -> int:
    """Tiles of a row of the largest square frame that the counters hold; with super-tiles, lists are dealt like tiles."""
    return isqrt(frame_lists(config))


def _cycles(case: Case) -> int:
    """Most cycles of a case whose frames are counted and grouped one after another, with memory clear from the start."""
    return sum(len(hits) + 1 + case.tiles + _SETTLING for hits in case.frames)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, every bit of the threshold, every pattern on every port, runs cut off by resets, and runs
    back to back at full rate."""
    rng, widest = np.random.default_rng(seed), _widest(config)
    plan = [plan_of(config, case) for case in corner_cases(widest)]
    plan += [plan_of(config, case, reset=False, quiet=20, most_cycles=_cycles(case))
             for case in (*threshold_cases(rng), *average_cases(widest), *shape_cases(rng, widest))]
    for k in range(6):
        plan.append(plan_of(config, random_case(rng, f"random {k}", min(20, widest), 1500)))
    case = random_case(rng, "streams", 8, 300)
    paused = {**every_pattern(PORTS, seed), **backpressure(PORTS[:1], PORTS[1:], seed)}
    for name, patterns in paused.items():
        plan.append(plan_of(config, case, name, patterns=patterns, reset=False))
    clear = frame_lists(config)
    for cycles in (3, clear - 1, clear + 40, clear + 700, clear + 1000):
        plan.append(plan_of(config, case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, case, f"frames after a reset at {cycles}"))
    for k in range(8):
        case = random_case(rng, f"back to back {k}", min(24, widest), 2000)
        plan.append(plan_of(config, case, reset=False, quiet=20, most_cycles=_cycles(case)))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """Real scenes' frames at full rate."""
    plan = []
    for name, frame in traced_frames(config, size).items():
        for beta in (None, 200):
            case = case_of(frame, f"traced {name}, {'fixed' if beta else 'auto'} beta", beta)
            plan.append(plan_of(config, case, reset=not plan, most_cycles=_cycles(case) + (0 if plan else frame_lists(config))))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs. With super-tiles there are no traced frames, whose tiles are no lists."""
    traced = [] if config.supertiles else traced_plan(config, traced_size(config, "640x360"))
    return [*unit_plan(config, seed), *traced]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per traced frame with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome, "traced"):
        groups, hits = item.expected["groups"], len(item.run.inputs["hits"]) - 1
        cycles = recording.cycles - item.run.reset * frame_lists(config)  # without clearing the memory after a reset
        lines.append(
            f"{item.name} {recording.observed['beta_used']}: {hits} hits and {len(groups)} tiles, in "
            f"{groups['group'][-1] + 1} groups, {(hits + len(groups)) / cycles:.4f} a cycle in {cycles} cycles")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
