"""The chunk test's tests: every header that leaves the unit and both counters are compared with the golden renderer's."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from rtl.chunks.level_bounds import octagon_layout
from rtl.culling.frame import COUNTER_BITS
from spec.chunks import TEST_INTERVAL, TESTED_CHUNKS, header_item
from spec.config import TINY_EYES, TINY_V3, V3_RECORDS, AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import frame_settings
from tb.chunks.chunk_test_stimuli import (
    KINDS,
    SETTINGS,
    Case,
    case_of,
    for_two_eyes,
    mixed_case,
    model_case,
    sharp_case,
    uniform_case,
)
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream

NARROW = V3_RECORDS.with_(name="records_narrow", records="wide", row_width=256, support_sigma=None, stereo=True)
"""A machine with narrower frames and a wider margin."""

VARIANTS: dict[str, AcceleratorConfig] = {"v3_records": V3_RECORDS, "records_narrow": NARROW, "tiny_v3": TINY_V3,
                                       "tiny_eyes": TINY_EYES}
"""Configurations that can be tested."""

DISTINCT = ("v3_records", "records_narrow", "tiny_v3", "tiny_eyes")
"""Configurations with different units."""

PORTS = ("headers", "tested")

COUNTERS = ("chunks_read", "chunks_skipped")

_SETTLING = 100
"""Most cycles from a frame's last header to its `end` at the output."""

_RATE_CHUNKS = 400


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    widths = {f.name: f.width for f in frame_settings(config).fields}
    return Playback(
        name=f"chunk-test-{config.name}", module="chunk_test", verilog=emitted("chunk_test", config),
        inputs=(Stream("headers", header_item(config)),), outputs=(Stream("tested", header_item(config)),),
        settings=(*((name, widths[name]) for name in (*SETTINGS, *(("target_position", "joint") if config.joint else ()))),
                  *((name, octagon_layout(config).size * MAX_LEVELS)
                    for name in ("bounds", *(["target_bounds"] if config.joint else [])))),
        observed=tuple((name, COUNTER_BITS) for name in COUNTERS))


def plan_of(case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(name or case.name, {"headers": case.items}, {"tested": case.tested}, observed=case.observed,
                   settings=case.settings, **options)


def most_cycles(case: Case) -> int:
    """Cycles of a case at full rate: an interval per header, in joint frames two, and the latency of the unit."""
    return TEST_INTERVAL * (case.chunks * (1 + (case.target is not None)) + len(case.frames)) + _SETTLING


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Every kind of header, frames of every size, patterns of pauses, runs cut off by resets, and runs back to back."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(case_of(config, rng, kind), f"{kind} {i}") for kind in KINDS for i in range(6)]
    for size in ((1, 1), (16, 16), (17, 33), (config.row_width, config.row_width)):
        plan += [plan_of(case_of(config, rng, kind, size=size, turned=False), f"{kind}, {size[0]}x{size[1]}") for kind in KINDS]
    # enough for low bits that rounding mostly hides
    plan += [plan_of(case_of(config, rng, kind, 2500), f"many, {kind} {i}") for kind in KINDS for i in range(3)]
    plan += [plan_of(model_case(config, rng, count)) for count in (1, 64, 5000)]
    streams = mixed_case(config, rng, "streams", [40, 0, 1, 130, 0, 0, 60])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(streams, name, patterns=patterns, reset=False))
    plan.append(plan_of(replace(streams, name="an empty frame comes last", frames=(*streams.frames, streams.frames[1]))))
    for cycles in (3, 60, 200, 900):
        plan.append(plan_of(mixed_case(config, rng, f"cut off after {cycles} cycles", [1000]), abort=cycles))
        plan.append(plan_of(streams, f"frames after a reset at {cycles}"))
    for k in range(3):
        case = mixed_case(config, rng, f"back to back {k}", [70, 3, 150])
        plan.append(plan_of(case, reset=False, quiet=0, most_cycles=most_cycles(case)))
    return [*plan, *sharp_plan(config, seed), *(joint_plan(config, seed) if config.joint else [])]


def sharp_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Boxes whose fate depends on their last bit, in frames of every size: in small ones most of them lie at a corner."""
    rng, widest = np.random.default_rng((seed, 1)), config.row_width
    sizes = (40, 40), (70, 50), (130, 90), (widest // 2, widest // 3), (widest, min(widest, 1080)), (widest, widest)
    return [plan_of(sharp_case(config, rng, size, 1200)) for size in sizes]


def joint_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Joint frames with every kind of header and with every distance of the eyes, and patterns of pauses."""
    rng = np.random.default_rng(seed)
    plan = []
    for kind in KINDS:
        for distance in (0.0, 0.1, 1.0, 30.0):
            case = for_two_eyes(config, rng, case_of(config, rng, kind, 200), distance)
            plan.append(plan_of(case, f"joint, {kind}, {distance} apart", most_cycles=most_cycles(case)))
    streams = for_two_eyes(config, rng, mixed_case(config, rng, "streams", [40, 0, 1, 130, 0, 0, 60]), 2.0)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(streams, f"joint, {name}", patterns=patterns, reset=False))
    plan.append(plan_of(replace(streams, target=None), "one eye after two", reset=False))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Headers that are all read, or all skipped. One must be accepted every interval."""
    rng, plan = np.random.default_rng(seed), []
    for read in (True, False):
        case = uniform_case(config, rng, read, _RATE_CHUNKS)
        plan.append(plan_of(case, most_cycles=most_cycles(case), least_rate={"headers": (1 - 1e-9) / TEST_INTERVAL}))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        chunks, read = len(item.run.inputs["headers"]) - 1, len(item.expected["tested"]) - 1
        lines.append(f"{item.name}: {chunks} chunks, {read} read, {recording.cycles / chunks:.4f} cycles a chunk, queue of "
                     f"{TESTED_CHUNKS}")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
