"""The tests of the colour unit by super-tiles: every place is compared with the golden renderer's splat records."""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from rtl.culling.colour import splat_interval
from rtl.emit import to_verilog
from rtl.supertiles.colour import PairColour
from spec.config import TINY_EYES, TINY_V3, V3, V3_EYES, AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.joint import EYES
from spec.memory import read_data
from spec.records import surviving_splat
from spec.supertiles import batch_place
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.common.runner import Waves
from tb.common.scenes import traced_frames, traced_size
from tb.culling.colour_stimuli import Case, fine_case, limits_case
from tb.supertiles.colour_stimuli import (
    USED,
    JointCase,
    extreme_case,
    frame_case,
    inputs,
    joint_case,
    places,
    random_case,
)

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3, "tiny_eyes": TINY_EYES, "v3_eyes": V3_EYES}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units: they take a pair every 16 and every 2 cycles, of one eye or of two."""

PORTS = ("survivors", "data", "places")

SETTLING = 120
"""Most cycles of a run in addition to those of its pairs: the pipelines."""

ONE_LEVEL = tuple(1 << level for level in range(MAX_LEVELS))


def _emit(config: AcceleratorConfig, sh_degree: int) -> str:
    return to_verilog(PairColour(config, sh_degree=sh_degree), "pair_colour")


@cache
def playback(config: AcceleratorConfig, sh_degree: int = 3) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"pair-colour-{splat_interval(config)}-{sh_degree}{'-joint' * config.joint}"
    return Playback(
        name=name, module="pair_colour", verilog=emitted(name, config, partial(_emit, sh_degree=sh_degree)),
        inputs=(Stream("survivors", surviving_splat(config)), Stream("data", read_data(config))),
        outputs=(Stream("places", batch_place(config)),),
        settings=(("sh_degree", 2), *((("joint", 1), ("shared_colour", 1)) if config.joint else ())), observed=())


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    settings = {"sh_degree": case.sh_degree} | ({"joint": 0, "shared_colour": case.sh_degree % 2} if config.joint else {})
    return planned(name or case.name, inputs(config, case), {"places": places(config, case)}, settings=settings, **options)


def joint_plan_of(config: AcceleratorConfig, joint: JointCase, name: str | None = None, **options: object) -> Planned:
    """The run that plays a joint frame's pairs."""
    settings = {"sh_degree": joint.case.sh_degree, "joint": 1, "shared_colour": int(joint.shared)}
    return planned(name or joint.case.name, joint.inputs(config), {"places": joint.places(config)}, settings=settings,
                   **options)


def joint_plan(config: AcceleratorConfig, seed: int, sh_degree: int = 3) -> list[Planned]:
    """Joint frames of every degree, with colours of each eye and with one for both: pauses, resets, back to back with frames
    of one eye, and at full rate."""
    plan = []
    for degree, shared in product(range(sh_degree + 1), (False, True)):
        case = joint_case(config, seed + degree, degree, 150, shared=shared)
        plan.append(joint_plan_of(config, case))
        case, name = joint_case(config, seed, degree, 40, shared=shared), f"{case.case.name}:"
        for pattern, patterns in every_pattern(PORTS, seed).items():
            plan.append(joint_plan_of(config, case, f"{name} {pattern}", patterns=patterns, reset=False))
        for cycles in (3, 77):
            plan.append(joint_plan_of(config, case, f"{name} cut off after {cycles} cycles", abort=cycles))
            plan.append(joint_plan_of(config, case, f"{name} after a reset at {cycles}"))
        for kind, levels, alone in (("one level", ONE_LEVEL, 0.3), ("all levels", USED, 0.3), ("both eyes", ONE_LEVEL, 0.0),
                                    ("one eye", ONE_LEVEL, 0.5)):
            case = joint_case(config, seed, degree, 300, shared=shared, levels=levels, alone=alone)
            plan.append(joint_plan_of(config, case, f"{name} rate of {kind}", most_cycles=_most_cycles(config, case)))
    for k in range(6):
        degree = k * 3 % (sh_degree + 1)
        if k % 3 == 1:
            plan.append(plan_of(config, random_case(config, seed + k, degree, 10 + k), f"joint, back to back {k}",
                                reset=False, quiet=0))
        else:
            case = joint_case(config, seed + k, degree, 10 + k, shared=k % 2 == 0)
            plan.append(joint_plan_of(config, case, f"joint, back to back {k}", reset=False, quiet=0))
    return plan


def _most_cycles(config: AcceleratorConfig, joint: JointCase) -> int:
    """Cycles of a joint frame's pairs without pauses: an interval for each evaluation of harmonics, and a cycle more where
    only one eye has a level; a cycle for each item; and one for each place."""
    places = np.bitwise_count(joint.survivors["levels"].astype(np.uint8)).reshape(-1, EYES)
    shades = np.ones(len(places), np.int64) if joint.shared else (places > 0).sum(axis=1)
    alone = ((places > 0).sum(axis=1) == 1) & (not joint.shared)
    steps = (splat_interval(config) * shades + alone) * (joint.case.sh_degree > 0)
    return int(np.maximum(np.maximum(steps, EYES), places.sum(axis=1)).sum()) + SETTLING


def unit_plan(config: AcceleratorConfig, seed: int, sh_degree: int = 3) -> list[Planned]:
    """Every degree up to `sh_degree`, extremes, pauses, resets, and runs back to back."""
    plan = []
    for degree in range(sh_degree + 1):
        plan.append(plan_of(config, random_case(config, seed + degree, degree, 150)))
        plan.append(plan_of(config, extreme_case(config, degree)))
        plan.append(plan_of(config, fine_case(config, seed, degree, 1000)))
        if degree:
            plan.append(plan_of(config, limits_case(config, seed, degree)))
        case = random_case(config, seed, degree, 40)
        for name, patterns in every_pattern(PORTS, seed).items():
            plan.append(plan_of(config, case, f"{name}, degree {degree}", patterns=patterns, reset=False))
        for cycles in (3, 40, 77, 150):
            plan.append(plan_of(config, case, f"degree {degree} cut off after {cycles} cycles", abort=cycles))
            plan.append(plan_of(config, case, f"degree {degree} after a reset at {cycles}"))
    for k in range(5):
        again = random_case(config, seed + k, k * 3 % (sh_degree + 1), 10 + k)
        plan.append(plan_of(config, again, f"back to back {k}", reset=False, quiet=0))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int, sh_degree: int = 3) -> list[Planned]:
    """Runs at full rate: a pair of one level takes an interval, without harmonics one cycle; a pair of more levels takes a
    cycle for each of them at least."""
    plan = []
    for degree in range(sh_degree + 1):
        for name, levels in (("one level", ONE_LEVEL), ("all levels", range(1, 1 << MAX_LEVELS))):
            case = random_case(config, seed, degree, 300, levels=levels, name=f"rate of {name}, degree {degree}")
            used = np.bitwise_count(case.frames[0]["levels"].astype(np.uint8))
            least = splat_interval(config) if degree else 1
            plan.append(plan_of(config, case, most_cycles=int(np.maximum(used, least).sum()) + SETTLING))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The pairs of real scenes' frames."""
    return [plan_of(config, frame_case(f"traced {name}", frame)) for name, frame in traced_frames(config, size).items()]


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    joint = joint_plan(config, seed) if config.joint else []
    return [*unit_plan(config, seed), *rate_plan(config, seed), *joint, *traced_plan(config, traced_size(config, "320x180"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        pairs = len(item.run.inputs["survivors"])
        lines.append(f"{item.name}: {pairs} pairs, {len(item.expected['places'])} places, {recording.cycles} cycles, "
                     f"{recording.cycles / max(pairs, 1):.2f} a pair")
    return lines


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    sh_degree: int = 3,
) -> Outcome:
    """Plays a plan and compares all results. Raises SimulationError when the simulation itself fails."""
    return exact.run_plan(playback(config, sh_degree), plan, folder, waves=waves, progress=progress)
