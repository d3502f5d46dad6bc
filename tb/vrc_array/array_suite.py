"""The rendering array's tests: every case is compared with the golden renderer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spec.config import PAPER, PAPER_SMALL, SHORT_FORMATS, TINY, AcceleratorConfig
from tb.common import exact
from tb.common.exact import Outcome, every_pattern
from tb.common.patterns import PERIOD, Pattern
from tb.common.player import Recording
from tb.common.runner import Waves
from tb.vrc_array.array_check import golden_pixels, problems, run_of
from tb.vrc_array.array_device import vrc_playback
from tb.vrc_array.array_stimuli import CORNERS, Case, random_case
from tb.vrc_array.traced import traced_cases

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY,
    "tiny-1-level": TINY.with_(levels=1),
    "tiny-no-depth": TINY.with_(depth=False),
    "tiny-no-support": TINY.with_(support_sigma=None),
    "tiny-baseline": TINY.with_(incremental=False),
    "tiny-short": TINY.with_(levels=1, depth=False, formats=SHORT_FORMATS),
    "paper_small": PAPER_SMALL,
    "paper": PAPER,
}
"""Configurations that can be tested."""

DISTINCT = tuple(name for name in VARIANTS if name != "paper")
"""All configurations but PAPER, which differs from PAPER_SMALL only outside the array."""

PORTS = ("tiles", "entries", "pixels")


@dataclass(frozen=True)
class Planned(exact.Planned):
    """A run, and the case whose pixels it must produce; `least_waits` is the least permitted value of `waits` at its end."""

    case: Case | None = None
    least_waits: int = 0


def plan_of(
    config: AcceleratorConfig, case: Case, name: str | None = None, *, least_waits: int = 0, **options: object,
) -> Planned:
    """The run that plays a case; `options` are those of `Run`."""
    return Planned(run_of(config, case, name, **options), {}, case=case, least_waits=least_waits)


def corner_plan(config: AcceleratorConfig) -> list[Planned]:
    """The hand-made cases, without pauses."""
    return [plan_of(config, make(config)) for make in CORNERS]


def random_plan(config: AcceleratorConfig, seed: int, count: int = 4) -> list[Planned]:
    """Random frames, in turn without pauses and with random pauses."""
    plan = []
    for k in range(count):
        case = random_case(config, f"random {k}", seed * 1000 + k)
        patterns = {} if k % 2 == 0 else {port: (Pattern.RANDOM, seed + i) for i, port in enumerate(PORTS)}
        plan.append(plan_of(config, case, patterns=patterns))
    return plan


def stream_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """One small frame with every pause pattern, on each port alone and on all ports together, and with pixels that are not
    taken for so long that ops wait, and are counted."""
    case = random_case(config, "streams", seed, tiles=8, mean_count=8)
    ebb = PERIOD // 3  # cycles in which no pixel is taken
    return [*(plan_of(config, case, name, patterns=patterns) for name, patterns in every_pattern(PORTS, seed).items()),
            plan_of(config, case, "pixels are not taken for long", patterns={PORTS[2]: (Pattern.TIDAL, seed)},
                    least_waits=ebb // 2)]


def frame_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames that are cut off by a reset and followed by a whole one, and frames back to back without a reset but with changing
    backgrounds."""
    case = random_case(config, "frames", seed + 1, tiles=6, mean_count=10)
    rng = np.random.default_rng(seed)
    plan = []
    for cycles in (3, 40, int(rng.integers(50, 200)), int(rng.integers(200, 600))):
        plan.append(plan_of(config, case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, case, f"whole frame after a reset at {cycles}"))
    for k in range(3):
        other = Case(case.name, case.headers, case.entries, rng.integers(0, config.formats.colour.raw_max + 1, 3))
        plan.append(plan_of(config, other, f"back to back {k}", reset=False, quiet=0))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    traced = [plan_of(config, case) for case in traced_cases(config, seed)]
    return [
        *corner_plan(config), *random_plan(config, seed), *traced, *stream_plan(config, seed), *frame_plan(config, seed)]


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares every pixel. Raises SimulationError when the simulation itself fails."""
    def judge(item: Planned, recording: Recording) -> list[str]:
        busy = ["the array is still busy after its last pixel"] if item.run.quiet and recording.observed["busy"] else []
        waits = recording.observed["waits"]
        few = [f"ops waited for {waits} cycles, fewer than {item.least_waits}"] if waits < item.least_waits else []
        return [*problems(config, item.case, recording, golden_pixels(config, item.case)), *busy, *few]

    return exact.run_plan(vrc_playback(config), plan, folder, waves=waves, progress=progress, judge=judge)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """No lines: no run of the plan measures the array's own speed."""
    return []
