"""The tests of the tile test by super-tiles: every pair, mask and count is compared with the golden renderer's."""

from __future__ import annotations

import numpy as np

from spec.config import TINY_EYES, TINY_STREAMS, TINY_V3, V3, V3_EYES, V3_STREAMS, AcceleratorConfig
from spec.constants import TILE
from spec.joint import SHIFT_MOST
from spec.queues import LINES_AHEAD
from spec.records import frame_supertiles
from tb.common import exact
from tb.common.exact import Outcome, Planned, backpressure, every_pattern, planned
from tb.common.scenes import traced_frames, traced_size
from tb.culling.tile_test_stimuli import (
    SHAPES,
    Case,
    case_of,
    corner_cases,
    many_cases,
    random_case,
    random_splats,
    sharp_case,
)
from tb.supertiles.joint_tiles import JointSuperCase, joint_random_case
from tb.supertiles.tile_test_device import playback
from tb.supertiles.tile_test_stimuli import SuperCase, numbered, wide_case

VARIANTS: dict[str, AcceleratorConfig] = {config.name: config for config in (
    TINY_V3, TINY_STREAMS, V3, V3_STREAMS, TINY_EYES, TINY_STREAMS.with_(name="tiny_eyes_streams", joint=True), V3_EYES)}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units: they test a run of tiles every 8 cycles and every cycle, with and without quarters, and
with joint frames."""

PORTS = ("splats", "table", "pairs", "survivors")

_SETTLING = 90
"""Most cycles of a phase in addition to those of its runs and pairs: the latency of the unit."""


def plan_of(case: SuperCase, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    one_eye = {"joint": 0, "shift": 5} if case.config.joint else {}
    return planned(name or case.name, case.inputs, case.expected, observed=case.observed,
                   settings=case.base.settings | one_eye, **options)


def joint_plan_of(case: JointSuperCase, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case of joint frames."""
    return planned(name or case.name, case.inputs, case.expected, observed=case.observed, settings=case.settings, **options)


def most_cycles(case: SuperCase) -> int:
    """Most cycles of a case at full rate. While the levels of the tiles come, a machine with joint frames clears its memory of
    the super-tiles that the source has (`rtl.supertiles.pair_union`)."""
    cleared = frame_supertiles(case.config) if case.config.joint else 0
    return sum(max(len(levels), cleared) + first + second + 2 * _SETTLING
               for (_, levels), (first, second) in zip(case.base.frames, case.cycles(), strict=True))


def timed(case: SuperCase, **options: object) -> Planned:
    """A run that must be at full rate."""
    return plan_of(case, most_cycles=most_cycles(case), **options)


def of(case: Case) -> SuperCase:
    """The case, with both phases."""
    return SuperCase(numbered(case))


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, every pattern on every port, runs cut off by resets, and runs back to back at full rate."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(of(case)) for case in corner_cases(config, rng)]
    plan.append(plan_of(of(sharp_case(config, rng, 400))))
    size = min(config.row_width, 290), 90
    case = of(random_case(config, rng, "streams", *size, 60, frames=3))
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(case, name, patterns=patterns, reset=False))
    tiles = -(-size[0] // TILE) * -(-size[1] // TILE)
    for cycles in (3, tiles - 1, tiles + 3, tiles + 70, tiles + 200, 2 * tiles + 700, 4 * tiles + 2000):
        plan.append(plan_of(case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(case, f"frames after a reset at {cycles}"))
    plan += [plan_of(of(case), reset=False) for case in many_cases(config, rng)]
    for k in range(6):
        width, height = (int(n) for n in rng.integers(1, (min(config.row_width, 900), min(config.row_width, 200))))
        case = of(random_case(config, rng, f"back to back {k}", width, height, 100, obb=k % 4 == 3))
        plan.append(timed(case, reset=False, quiet=20))
    rows = random_splats(config, rng, 2 * LINES_AHEAD, config.row_width, 4 * TILE, "giants")
    plan.append(timed(wide_case(config, rng, rows, "rate of wide splats"), reset=False))
    first = SuperCase(case.base, again=False)
    plan += [plan_of(first, "no second phase"), plan_of(case, "a second phase after none", reset=False)]
    plan.append(plan_of(of(sharp_case(config, rng, 1500, ("slanted",)))))
    for name, patterns in backpressure(PORTS[:2], PORTS[2:], seed).items():
        plan.append(plan_of(of(random_case(config, rng, name, *size, 60, frames=3)), patterns=patterns, reset=False))
    return plan + (joint_plan(config, seed) if config.joint else [])


def joint_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Joint frames of every shape of splats and with every kind of shift, every pattern on every port, runs cut off by resets,
    and runs in turn with frames of one eye."""
    rng = np.random.default_rng(seed)
    widest = min(config.row_width, 400)
    plan = []
    for number, shape in enumerate(SHAPES):
        for shift in (0, 3, -SHIFT_MOST, SHIFT_MOST, -1 - number):
            size = (int(rng.integers(1, widest)), int(rng.integers(1, 100)))
            case = joint_random_case(config, rng, f"joint {shape}, shift {shift}, {size}", *size, 50, shift, shape=shape)
            plan.append(joint_plan_of(case, reset=number % 2 == 0))
    plan.append(joint_plan_of(joint_random_case(config, rng, "joint, widest", config.row_width, 40, 30, SHIFT_MOST)))
    plan.append(joint_plan_of(joint_random_case(config, rng, "joint boxes", 200, 90, 60, -2, obb=True)))
    case = joint_random_case(config, rng, "joint streams", 190, 70, 50, 3, frames=3)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(joint_plan_of(case, f"joint {name}", patterns=patterns, reset=False))
    one = of(random_case(config, rng, "one eye", 190, 70, 40))
    for cycles in (3, 90, 400, 1500):
        plan.append(joint_plan_of(case, f"joint, cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(one, f"one eye after a reset at {cycles}"))
        plan.append(joint_plan_of(case, f"joint frames after one eye, {cycles}", reset=False))
    return plan


def traced_plan(config: AcceleratorConfig, size: str, **scenes: object) -> list[Planned]:
    """Real scenes' frames at full rate, with the exact test and with boxes."""
    plan = []
    for name, frame in traced_frames(config, size, **scenes).items():
        for obb in (False, True):
            plan.append(timed(of(case_of(frame, f"traced {name}{', boxes' * obb}", obb=obb)), reset=False))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *traced_plan(config, traced_size(config, "640x360"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per traced frame with its speed."""
    return [
        f"{item.name}: {len(item.expected['pairs']) - 1} pairs of {recording.observed['survivors_count']} splats with "
        f"{recording.observed['entries']} intersections, in {recording.cycles} cycles of at most {item.most_cycles}"
        for item, recording in exact.at_full_rate(plan, outcome)]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
