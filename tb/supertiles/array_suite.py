"""Tests of the array of machines with super-tiles: its pixels are those of the golden array, which knows no batches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spec.config import SHORT_FORMATS, TINY_EYES, TINY_STREAMS, TINY_V3, V3, V3_STREAMS, AcceleratorConfig
from tb.common import exact
from tb.common.exact import Outcome, every_pattern
from tb.common.patterns import Pattern
from tb.common.player import Recording, Run
from tb.common.runner import Waves
from tb.supertiles.array_device import batch_array_playback
from tb.supertiles.array_stimuli import Visits, split, stopping_case
from tb.vrc_array.array_check import golden_pixels, problems
from tb.vrc_array.array_device import background_bits, rows_per_tile
from tb.vrc_array.array_stimuli import CORNERS, Case, random_case

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny_v3": TINY_V3,
    "tiny_v3-1-level": TINY_V3.with_(levels=1),
    "tiny_v3-no-depth": TINY_V3.with_(depth=False),
    "tiny_v3-baseline": TINY_V3.with_(incremental=False),
    "v3-short": V3.with_(levels=1, depth=False, formats=SHORT_FORMATS),
    "v3": V3,
    "tiny_streams": TINY_STREAMS,
    "v3_streams": V3_STREAMS,
    "tiny_eyes": TINY_EYES,
    "tiny_eyes_streams": TINY_STREAMS.with_(joint=True),
}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""All configurations."""

PORTS = ("visits", "entries", "pixels")

_QUIET = 3000
"""Cycles that must follow the last item: a small array takes so long for its last visits, of which nothing may come out."""


@dataclass(frozen=True)
class Planned(exact.Planned):
    """A run, and the frame whose pixels it must produce."""

    frame: Visits | None = None


def plan_of(config: AcceleratorConfig, frame: Visits, name: str | None = None, **options: object) -> Planned:
    """The run that plays a frame; `options` are those of `Run`. The array of a stream renders the frame's quarter of tiles."""
    case, settings = frame.case, {"background": background_bits(config, frame.case.background)}
    if config.streams > 1:
        settings["quarter"] = frame.quarter
    run = Run(
        name or case.name, {"visits": frame.visits, "entries": frame.entries},
        {"pixels": len(case.headers) * rows_per_tile(config)}, settings,
        **{"quiet": _QUIET, **options})
    return Planned(run, {}, frame=frame)


def corner_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The hand-made cases of the array, split into batches."""
    return [plan_of(config, split(config, make(config), seed + k)) for k, make in enumerate(CORNERS)]


def random_plan(config: AcceleratorConfig, seed: int, count: int = 4) -> list[Planned]:
    """Random frames, in turn without pauses and with random pauses: super-tiles of up to 16 tiles and up to 8 batches."""
    plan = []
    for k in range(count):
        case = random_case(config, f"random {k}", seed * 1000 + k)
        patterns = {} if k % 2 == 0 else {port: (Pattern.RANDOM, seed + i) for i, port in enumerate(PORTS)}
        plan.append(plan_of(config, split(config, case, seed + k, batches=8), patterns=patterns))
    return plan


def hazard_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Tiles that are visited again at once, or after one other tile, with few intersections or none between."""
    plan = []
    for tiles in (1, 2, 3):
        case = random_case(config, f"revisits of {tiles}", seed + tiles, tiles=12, mean_count=12)
        plan.append(plan_of(config, split(config, case, seed, tiles=tiles, batches=12)))
    return plan


def stop_plan(config: AcceleratorConfig, seed: int, count: int = 6) -> list[Planned]:
    """Tiles that stop early. In all runs but the first two the last super-tile is not finished, which shows which of its tiles
    are known to have stopped."""
    return [
        plan_of(config, split(
            config, stopping_case(config, f"stopping {k}", seed + k), seed + k, batches=4, unfinished=k > 1))
        for k in range(count)]


def stream_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """One small frame with every pause pattern, on each port alone and on all ports together."""
    frame = split(config, random_case(config, "streams", seed, tiles=8, mean_count=8), seed)
    return [plan_of(config, frame, name, patterns=patterns) for name, patterns in every_pattern(PORTS, seed).items()]


def frame_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames that are cut off by a reset and followed by a whole one, and frames back to back without a reset."""
    case = random_case(config, "frames", seed + 1, tiles=6, mean_count=10)
    plan = []
    for k, cycles in enumerate((3, 150, 700)):
        plan.append(plan_of(config, split(config, case, seed + k), f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(config, split(config, case, seed + k), f"whole frame after a reset at {cycles}"))
    for k in range(3):
        other = Case(case.name, case.headers, case.entries, (case.background * (k + 2)) % 512)
        plan.append(plan_of(config, split(config, other, seed + k), f"back to back {k}", reset=False))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [
        *corner_plan(config, seed), *random_plan(config, seed), *hazard_plan(config, seed), *stop_plan(config, seed),
        *stream_plan(config, seed), *frame_plan(config, seed)]


def judge(config: AcceleratorConfig, item: Planned, recording: Recording) -> list[str]:
    """Everything that is wrong with a recording: pixels, the tiles that have stopped, and whether the array is at rest."""
    frame, last = item.frame, int(item.frame.visits["sequence"][-1])
    wrong = problems(config, frame.case, recording, golden_pixels(config, frame.case), frame.quarter)
    if config.joint and not wrong:
        rows = recording.outputs["pixels"]["eye"].reshape(len(frame.eyes), rows_per_tile(config))
        wrong += [f"tile {tile}: a row is not of eye {eye}" for tile, eye in enumerate(frame.eyes) if (rows[tile] != eye).any()]
    for name, value in (("busy", 0), ("current", last), ("done", frame.done)):
        if recording.observed[name] != value:
            wrong.append(f"{name} is {recording.observed[name]:#x} at the end, not {value:#x}")
    return wrong


def run_plan(
    config: AcceleratorConfig, plan: list[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares every pixel. Raises SimulationError when the simulation itself fails."""
    return exact.run_plan(
        batch_array_playback(config), plan, folder, waves=waves, progress=progress,
        judge=lambda item, recording: judge(config, item, recording))


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """No lines: no run of the plan measures the array's own speed."""
    return []
