"""The rendering array's tests: every case is compared with the golden renderer."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from spec.config import DEFAULT, PAPER, SHORT_FORMATS, TINY, AcceleratorConfig
from tb.common.patterns import Pattern
from tb.common.player import Recording, Run, play
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
    "default": DEFAULT,
    "paper": PAPER,
}
"""Configurations that can be tested."""

DISTINCT = tuple(name for name in VARIANTS if name != "paper")
"""All configurations but PAPER, which differs from DEFAULT only outside the array."""

PORTS = ("tiles", "entries", "pixels")


@dataclass(frozen=True)
class Planned:
    """A run, the case whose pixels it must give, and a name for reports."""

    name: str
    case: Case
    run: Run


@dataclass
class Outcome:
    """The outcome of a plan in one configuration.

    Attributes:
        failures: descriptions of problems by the run's name; empty when all is well.
        runs, pixels, cycles: the numbers of compared runs, compared pixels and simulated cycles.
        seconds: wall time, including the build.
        recordings: the outputs of every run that was not aborted, by name.
    """

    failures: dict[str, list[str]] = field(default_factory=dict)
    runs: int = 0
    pixels: int = 0
    cycles: int = 0
    seconds: float = 0.0
    recordings: dict[str, Recording] = field(default_factory=dict)

    @property
    def amount(self) -> str:
        """The amount of compared data, in words."""
        return f"{self.pixels} pixels"


def corner_plan(config: AcceleratorConfig) -> list[Planned]:
    """The hand-made cases, without pauses."""
    return [Planned(case.name, case, run_of(config, case)) for case in (make(config) for make in CORNERS)]


def random_plan(config: AcceleratorConfig, seed: int, count: int = 4) -> list[Planned]:
    """Random frames, in turn without pauses and with random pauses."""
    plan = []
    for k in range(count):
        case = random_case(config, f"random {k}", seed * 1000 + k)
        patterns = {} if k % 2 == 0 else {port: (Pattern.RANDOM, seed + i) for i, port in enumerate(PORTS)}
        plan.append(Planned(case.name, case, run_of(config, case, patterns=patterns)))
    return plan


def stream_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """One small frame with every pause pattern, on each port alone and on all ports together."""
    case = random_case(config, "streams", seed, tiles=8, mean_count=8)
    plan = []
    for pattern in (Pattern.ALWAYS, Pattern.RANDOM, Pattern.BURSTY):
        for ports in (*((port,) for port in PORTS), PORTS):
            patterns = {port: (pattern, seed + i) for i, port in enumerate(ports)}
            plan.append(Planned(f"{pattern.value} pauses of {', '.join(ports)}", case, run_of(config, case, patterns=patterns)))
    return plan


def frame_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames that are cut off by a reset and followed by a whole one, and frames back to back without a reset but with changing
    backgrounds."""
    case = random_case(config, "frames", seed + 1, tiles=6, mean_count=10)
    rng = np.random.default_rng(seed)
    plan = []
    for cycles in (3, 40, int(rng.integers(50, 200)), int(rng.integers(200, 600))):
        plan.append(Planned(f"cut off after {cycles} cycles", case, run_of(config, case, abort=cycles)))
        plan.append(Planned(f"whole frame after a reset at {cycles}", case, run_of(config, case)))
    for k in range(3):
        other = Case(case.name, case.headers, case.entries, rng.integers(0, config.formats.colour.raw_max + 1, 3))
        plan.append(Planned(f"back to back {k}", other, run_of(config, other, reset=False, quiet=0)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    traced = [Planned(case.name, case, run_of(config, case)) for case in traced_cases(config, seed)]
    return [
        *corner_plan(config), *random_plan(config, seed), *traced, *stream_plan(config, seed), *frame_plan(config, seed)]


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares every pixel. Raises SimulationError when the simulation itself fails."""
    begin = time.perf_counter()
    recordings = play(vrc_playback(config), [p.run for p in plan], folder, waves=waves, progress=progress)
    outcome = Outcome()
    for planned, recording in zip(plan, recordings, strict=True):
        outcome.cycles += recording.cycles
        if planned.run.abort is not None:
            continue
        outcome.runs += 1
        outcome.pixels += 256 * len(planned.case.headers)
        outcome.recordings[planned.name] = recording
        wrong = problems(config, planned.case, recording, golden_pixels(config, planned.case))
        if planned.run.quiet and recording.observed["busy"]:
            wrong.append("the array is still busy after its last pixel")
        if wrong:
            outcome.failures[planned.name] = wrong
    outcome.seconds = time.perf_counter() - begin
    return outcome


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """No lines: no run of the plan measures the array's own speed."""
    return []
