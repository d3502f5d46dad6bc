"""The projection unit's tests: every splat and every counter is compared with the golden renderer's."""

from __future__ import annotations

from functools import cache

import numpy as np

from rtl.culling.frame import COUNTER_BITS
from rtl.culling.projection_unit import COUNTS
from spec.config import DEFAULT, PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.memory import frame_settings
from spec.records import gaussian_point, projected_splat
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, backpressure, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames, traced_size
from tb.culling import TINY_RECORDS
from tb.culling.projection_stimuli import (
    EDITS,
    PRINCIPAL_POINTS,
    REASONS,
    SETTINGS,
    Case,
    case_of,
    guard_band_case,
    guard_band_ends,
    mixed_case,
    part_case,
    shortened,
    smallest_slant_case,
    traced_case,
    uniform_case,
)

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER, "tiny_records": TINY_RECORDS, "default": DEFAULT}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper_small", "paper", "tiny_records", "default")
"""Configurations with different units: they take a point every 8 cycles, every 4 cycles, and every cycle; the last two get one
opacity for all levels, and the very last has longer indices."""

PORTS = ("sink", "source")

_SETTLING = 200
"""Most cycles from a frame's last point to its `end` at the source."""

_RATE_POINTS = 500

MANY = ("ordinary", "edges of the frame", "needles", "saturating means", "any bits in view")
"""Of `EDITS`, those that are played with many points."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    widths = {f.name: f.width for f in frame_settings(config).fields}
    return Playback(
        name=f"projection-{config.point_interval}{'-compact' * config.compact}", module="projection_unit",
        verilog=emitted("projection_unit", config),
        inputs=(Stream("sink", gaussian_point(config)),), outputs=(Stream("source", projected_splat(config)),),
        settings=tuple((name, widths[name]) for name in SETTINGS),
        observed=tuple((name, COUNTER_BITS) for name in COUNTS))


def plan_of(case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(
        name or case.name, {"sink": case.items}, {"source": case.splats}, observed=case.observed, settings=case.settings,
        **options)


def most_cycles(case: Case) -> int:
    """Cycles of a case at full rate: an interval per point, and the latency of the unit."""
    return case.config.point_interval * (case.points + len(case.frames)) + _SETTLING


def least_rate(config: AcceleratorConfig) -> dict[str, float]:
    """The least points accepted per cycle in which one is offered, with a margin for rounding."""
    return {"sink": (1 - 1e-9) / config.point_interval}


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Every kind of point, frames of every size, patterns of pauses, runs cut off by resets, and runs back to back."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(case_of(config, rng, name)) for name in EDITS]
    for size in ((1, 1), (16, 16), (17, 33), (config.row_width, config.row_width)):
        plan.append(plan_of(case_of(config, rng, "ordinary", size=size, count=120, turned=False)))
        plan.append(plan_of(case_of(config, rng, "edges of the frame", size=size, count=120)))
    widest = config.row_width, config.row_width
    for name in MANY:  # enough for low bits that rounding mostly hides
        plan.append(plan_of(case_of(config, rng, name, size=widest, count=4000), f"many, {name}"))
    plan += [plan_of(guard_band_case(config, rng, number)) for number in range(len(guard_band_ends(config)))]
    streams = mixed_case(config, rng, "streams", [40, 0, 1, 130, 0, 0, 60])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(streams, name, patterns=patterns, reset=False))
    for cycles in (3, 60, 200, 900):
        plan.append(plan_of(mixed_case(config, rng, f"cut off after {cycles} cycles", [1000]), abort=cycles))
        plan.append(plan_of(streams, f"frames after a reset at {cycles}"))
    for k in range(3):
        case = mixed_case(config, rng, f"back to back {k}", [70, 3, 150])
        plan.append(plan_of(case, reset=False, quiet=0, most_cycles=most_cycles(case)))
    plan += [plan_of(part_case(config, rng, number)) for number in range(len(PRINCIPAL_POINTS))]
    plan.append(plan_of(smallest_slant_case(config, rng)))
    full = uniform_case(config, rng, "visible", _RATE_POINTS)
    for name, patterns in backpressure(PORTS[:1], PORTS[1:], seed).items():
        plan.append(plan_of(full, name, patterns=patterns, reset=False))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Points that all have the same fate. They must be accepted as often as the configuration says."""
    rng, plan = np.random.default_rng(seed), []
    for fate in (*REASONS, "visible"):
        case = uniform_case(config, rng, fate, _RATE_POINTS)
        plan.append(plan_of(case, most_cycles=most_cycles(case), least_rate=least_rate(config)))
    return plan


def traced_plan(config: AcceleratorConfig, size: str, most: int | None = None) -> list[Planned]:
    """Real scenes' frames at full rate, each with no more than `most` points."""
    plan = []
    for name, frame in traced_frames(config, size).items():
        case = traced_case(frame, f"traced {name}")
        case = case if most is None else shortened(case, most)
        plan.append(plan_of(case, reset=not plan, most_cycles=most_cycles(case), least_rate=least_rate(config)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs. Of trained scenes they contain as many points as the slowest machine takes in a minute."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "640x360"), 100_000)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        points, splats = len(item.run.inputs["sink"]) - 1, len(item.expected["source"]) - 1
        lines.append(
            f"{item.name}: {points} points, {splats} splats, {recording.cycles / points:.4f} cycles a point, "
            f"{recording.cycles} cycles from the first point in to the end out")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
