"""The decode unit's tests: every word is compared with the golden decoder's."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from rtl.chunks.geometry_decode import GeometryDecode
from spec.chunks import coded_point
from spec.config import V3, AcceleratorConfig
from spec.records import gaussian_point
from tb.chunks import decode_stimuli as stimuli
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream

VARIANTS: dict[str, AcceleratorConfig] = {"v3": V3}
"""Configurations that can be tested. The unit does not depend on anything but the formats."""

DISTINCT = ("v3",)

PORTS = ("codes", "points")

CASES = {
    "every opacity": stimuli.every_opacity, "every scale": stimuli.every_scale,
    "corner quaternions": stimuli.corner_quaternions, "corner positions": stimuli.corner_positions,
    "random codes": lambda config, rng: stimuli.random_items(config, rng, 4000)}
"""Stimuli by the name of their run: exhaustive where codes are few."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit, emitted as Verilog, with a file at each stream."""
    return Playback(
        name="geometry-decode", module="geometry_decode", verilog=emitted("geometry_decode", config),
        inputs=(Stream("codes", coded_point(config)),), outputs=(Stream("points", gaussian_point(config)),))


def _plan(name: str, frames: Sequence[tuple[np.ndarray, np.ndarray]], **options: object) -> Planned:
    codes, points = (np.concatenate(parts) for parts in zip(*frames, strict=True))
    return planned(name, {"codes": codes}, {"points": points}, **options)


def most_cycles(items: int) -> int:
    """Cycles of so many items at full rate: one each, and the unit's latency."""
    return items + GeometryDecode.latency + 2


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All codes of the fields, patterns of pauses, runs cut off by resets, and frames back to back at full rate."""
    rng = np.random.default_rng(seed)
    plan = [_plan(name, [make(config, rng)]) for name, make in CASES.items()]
    streams = [stimuli.random_items(config, rng, count) for count in (40, 0, 1, 130, 0, 0, 60)]
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(_plan(name, streams, patterns=patterns, reset=False))
    for cycles in (2, 7, 50):
        plan.append(_plan(f"cut off after {cycles} cycles", streams, abort=cycles))
        plan.append(_plan(f"frames after a reset at {cycles}", streams))
    for k in range(2):
        plan.append(_plan(f"back to back {k}", streams, reset=False, quiet=0,
                          most_cycles=most_cycles(sum(len(codes) for codes, _ in streams))))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """A Gaussian in every cycle."""
    frame = stimuli.random_items(config, np.random.default_rng(seed), 2000)
    return [_plan("rate of random codes", [frame], least_rate={"codes": 1 - 1e-9}, most_cycles=most_cycles(2001))]


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [f"{item.name}: {len(item.expected['points'])} items in {recording.cycles} cycles"
            for item, recording in exact.at_full_rate(plan, outcome)]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
