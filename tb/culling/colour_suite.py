"""The colour unit's tests. Every read and every written splat record must be right and in place, at the required speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rtl.culling.colour import splat_interval
from spec.config import PAPER, PAPER_SMALL, TINY, V3_RECORDS, AcceleratorConfig
from spec.constants import MAX_LEVELS
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.runner import Waves
from tb.common.scenes import traced_frames, traced_size
from tb.culling import TINY_RECORDS
from tb.culling.colour_device import MOST_DELAY, playback
from tb.culling.colour_stimuli import Case, extreme_case, fine_case, frame_case, limits_case, random_case

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER, "tiny_records": TINY_RECORDS, "v3_records": V3_RECORDS}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper_small", "paper", "tiny_records", "v3_records")
"""Configurations with different units: they take a splat every 32, 16 and 4 cycles, and with compact records every 16 and 2."""

PORTS = ("survivors", "data", "reads", "writes")

SETTLING = 250
"""Most cycles of a run in addition to those of its splats: the memory's latency and the pipelines."""

ONE_LEVEL = tuple(1 << level for level in range(MAX_LEVELS))


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, *, delay: int = 20, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(
        name or case.name, case.inputs(config), case.expected(config), observed=case.observed,
        settings={**case.settings, "delay": delay}, **options)


def unit_plan(config: AcceleratorConfig, seed: int, sh_degree: int = 3) -> list[Planned]:
    """Every degree up to `sh_degree`, extremes, empty frames, memory errors, pauses, resets, and runs back to back."""
    plan = []
    for degree in range(sh_degree + 1):
        plan.append(plan_of(config, random_case(config, seed + degree, degree, [150])))
        plan.append(plan_of(config, random_case(config, seed + degree, degree, [2000], name=f"many, {degree}")))
        plan.append(plan_of(config, extreme_case(config, degree)))
        plan.append(plan_of(config, fine_case(config, seed, degree, 1500)))
        if degree:
            plan.append(plan_of(config, limits_case(config, seed, degree)))
        frames = random_case(config, seed + degree, degree, [0, 1, 0, 0, 7, 30, 0], name=f"frames, {degree}")
        plan.append(plan_of(config, frames))
        bad = random_case(config, seed, degree, [20, 20], name=f"errors of memory, {degree}", bad=[5, 6, 17])
        plan += [plan_of(config, bad), plan_of(config, random_case(config, seed, degree, [9], name=f"no errors, {degree}"))]
    nothing = random_case(config, seed, sh_degree, [40], levels=(0, 0, 0, 1, 15), name="splats without a level")
    plan.append(plan_of(config, nothing))
    case = random_case(config, seed, sh_degree, [25, 15])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, case, name, patterns=patterns, reset=False))
    for cycles in (3, 40, 77, 150, 301):
        plan.append(plan_of(config, case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, case, f"frames after a reset at {cycles}"))
    for k in range(3):
        again = random_case(config, seed + k, k % (sh_degree + 1), [10 + k])
        plan.append(plan_of(config, again, f"back to back {k}", reset=False, quiet=0))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs at full rate: one splat per interval, whatever its level, with the longest memory latency that costs no time. With
    compact records a splat with more levels than that takes a cycle for each."""
    plan = []
    for degree in range(4):
        case = random_case(config, seed, degree, [300], levels=ONE_LEVEL, name=f"rate, degree {degree}")
        plan.append(plan_of(config, case, delay=MOST_DELAY - 8, most_cycles=300 * splat_interval(config) + SETTLING))
        if config.compact:
            case = random_case(config, seed, degree, [300], name=f"rate of all levels, degree {degree}")
            levels = np.bitwise_count(case.frames[0]["levels"].astype(np.uint8))
            most = int(np.maximum(levels, splat_interval(config)).sum()) + SETTLING
            plan.append(plan_of(config, case, delay=MOST_DELAY - 8, most_cycles=most))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The survivors of real scenes' frames."""
    plan = []
    for name, frame in traced_frames(config, size).items():
        case = frame_case(f"traced {name}", frame)
        plan.append(plan_of(config, case, delay=90))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "320x180"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        splats = int(np.sum(item.run.inputs["survivors"]["end"] == 0))
        lines.append(
            f"{item.name}: {splats} splats, {len(item.expected['writes'])} views, {recording.cycles} cycles, "
            f"{recording.cycles / max(splats, 1):.2f} a splat")
    return lines


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    sh_degree: int = 3,
) -> Outcome:
    """Plays a plan and compares all results. Raises SimulationError when the simulation itself fails."""
    return exact.run_plan(playback(config, sh_degree), plan, folder, waves=waves, progress=progress)
