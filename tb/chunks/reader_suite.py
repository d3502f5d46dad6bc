"""The tests of the reader of chunks: every request and every point is compared with the golden ones."""

from __future__ import annotations

import numpy as np

from rtl.chunks.geometry_decode import GeometryDecode
from spec.chunks import CHUNK
from spec.config import TINY_V3, V3_RECORDS, AcceleratorConfig
from tb.chunks.reader_device import playback
from tb.chunks.reader_stimuli import Case, boundary_cases, case
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned

VARIANTS: dict[str, AcceleratorConfig] = {
    "v3_records": V3_RECORDS, "wide": V3_RECORDS.with_(name="v3_wide", records="wide"), "tiny_v3": TINY_V3}
"""Configurations that can be tested: compact records, wide ones in chunks, and those whose indices name chunk and place."""

DISTINCT = ("v3_records", "wide", "tiny_v3")

PORTS = ("tested", "data", "reads", "points")

LATENCY = 130
"""Cycles from a request to its beat that the unit hides."""


def plan_of(item: Case, name: str | None = None, *, delay: int = 20, frame: int = 1, **options: object) -> Planned:
    """The run that plays a case; the unit starts where `frame` changes. `options` are those of `planned`."""
    settings = {"geometry_base": item.base, "delay": delay, "frame": frame}
    return planned(name or item.name, item.inputs, item.expected, observed={"busy": int(item.busy), "error": int(item.error)},
                   settings=settings, **options)


def most_cycles(item: Case, delay: int) -> int:
    """Cycles of one frame at full rate: one per Gaussian, and the time from the first chunk to its first point."""
    return item.points + delay + GeometryDecode.latency + 10


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Boundaries of chunks, patterns of pauses, fast and slow memory, runs cut off by resets, and frames back to back."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(item) for item in boundary_cases(config, rng)]
    plan.append(plan_of(case(config, rng, "the error is forgotten", [[7, 8]]), frame=2, reset=False))
    frames = [rng.integers(1, CHUNK + 1, 12), [], rng.integers(1, 5, 60), [1]]
    streams = case(config, rng, "streams", frames, first=5, read=0.7)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(streams, name, patterns=patterns, reset=False))
    for delay in (0, 1, 299):
        plan.append(plan_of(streams, f"memory after {delay} cycles", delay=delay, reset=False, quiet=400))
    for cycles in (3, 30, 200):
        plan.append(plan_of(streams, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(streams, f"frames after a reset at {cycles}"))
    return [*plan, plan_of(case(config, rng, "a frame whose end does not come", [[64, 3, 5]], ends=False))]


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """A Gaussian in every cycle, whatever the length of chunks down to an eighth of the latency, and where they begin."""
    rng, plan = np.random.default_rng(seed), []
    for length, first in ((CHUNK, 0), (CHUNK, 1), (63, 0), (9, 1), (10, 0)):
        item = case(config, rng, f"rate of chunks of {length} from {first}", [[length] * (2000 // length)], first=first)
        plan.append(plan_of(item, delay=LATENCY, most_cycles=most_cycles(item, LATENCY)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [f"{item.name}: {len(item.expected['points']) - 1} Gaussians, {len(item.expected['reads'])} beats in "
            f"{recording.cycles} cycles" for item, recording in exact.at_full_rate(plan, outcome)]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
