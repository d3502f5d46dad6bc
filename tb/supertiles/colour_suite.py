"""The tests of the colour unit by super-tiles: every place is compared with the golden renderer's splat records."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np

from rtl.culling.colour import splat_interval
from rtl.emit import to_verilog
from rtl.supertiles.colour import PairColour
from spec.config import TINY_V3, V3, AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import read_data
from spec.records import surviving_splat
from spec.supertiles import batch_place
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.common.runner import Waves
from tb.common.scenes import traced_frames, traced_size
from tb.culling.colour_stimuli import Case, fine_case
from tb.supertiles.colour_stimuli import extreme_case, frame_case, inputs, places, random_case

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3", "v3")
"""Configurations with different units: they take a pair every 16 and every 2 cycles."""

PORTS = ("survivors", "data", "places")

SETTLING = 120
"""Most cycles of a run in addition to those of its pairs: the pipelines."""

ONE_LEVEL = tuple(1 << level for level in range(MAX_LEVELS))


def _emit(config: AcceleratorConfig, sh_degree: int) -> str:
    return to_verilog(PairColour(config, sh_degree=sh_degree), "pair_colour")


@cache
def playback(config: AcceleratorConfig, sh_degree: int = 3) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"pair-colour-{splat_interval(config)}-{sh_degree}"
    return Playback(
        name=name, module="pair_colour", verilog=emitted(name, config, partial(_emit, sh_degree=sh_degree)),
        inputs=(Stream("survivors", surviving_splat(config)), Stream("data", read_data(config))),
        outputs=(Stream("places", batch_place(config)),), settings=(("sh_degree", 2),), observed=())


def plan_of(config: AcceleratorConfig, case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(name or case.name, inputs(config, case), {"places": places(config, case)},
                   settings={"sh_degree": case.sh_degree}, **options)


def unit_plan(config: AcceleratorConfig, seed: int, sh_degree: int = 3) -> list[Planned]:
    """Every degree up to `sh_degree`, extremes, pauses, resets, and runs back to back."""
    plan = []
    for degree in range(sh_degree + 1):
        plan.append(plan_of(config, random_case(config, seed + degree, degree, 150)))
        plan.append(plan_of(config, extreme_case(config, degree)))
        plan.append(plan_of(config, fine_case(config, seed, degree, 1000)))
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
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "320x180"))]


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
