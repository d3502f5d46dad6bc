"""The tile test's tests: every intersection and every survivor is compared with the golden renderer's."""

from __future__ import annotations

from functools import cache

import numpy as np

from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.records import intersection_item, projected_splat, surviving_splat, tile_level
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, backpressure, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames, traced_size
from tb.culling import TINY_RECORDS
from tb.culling.tile_test_stimuli import Case, case_of, corner_cases, many_cases, random_case, sharp_case

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER, "tiny_stereo": TINY.with_(name="tiny_stereo", stereo=True),
    "tiny_records": TINY_RECORDS}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper_small", "paper", "tiny_stereo", "tiny_records")
"""Configurations with different units: they test a run of tiles every 8 cycles, every 4 cycles and every cycle; one has tiles
that are not rendered, and one gets one opacity for all levels."""

PORTS = ("splats", "table", "entries", "survivors")

_SETTLING = 90
"""Most cycles of a frame in addition to those of its table, runs and intersections: the latency of the unit."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit of a configuration, emitted as Verilog, with a file at each stream."""
    widths = {f.name: f.width for f in frame_settings(config).fields}
    return Playback(
        name=f"tiles-{config.row_width}-{config.point_interval}{'-stereo' * config.stereo}{'-compact' * config.compact}",
        module="tile_test", verilog=emitted("tile_test", config),
        inputs=(Stream("splats", projected_splat(config)), Stream("table", tile_level(config))),
        outputs=(Stream("entries", intersection_item(config)), Stream("survivors", surviving_splat(config))),
        settings=tuple((name, widths[name]) for name in ("width", "height", "obb")),
        observed=(("touched", 32), ("filtered", 32), ("busy", 1)))


def plan_of(case: Case, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(
        name or case.name, case.inputs, case.expected, observed=case.observed, settings=case.settings, **options)


def most_cycles(case: Case) -> int:
    """Most cycles of a case at full rate: one per table item, then an interval per run of tiles, and one more for every
    further intersection of a run."""
    interval, total = case.config.point_interval, 0
    for (_, levels), cost in zip(case.frames, case.costs(), strict=True):
        total += len(levels) + (interval - 1) * cost.runs + cost.steps + _SETTLING
    return total


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, every pattern on every port, runs cut off by resets, and runs back to back at full rate."""
    rng = np.random.default_rng(seed)
    plan = [plan_of(case) for case in corner_cases(config, rng)]
    plan.append(plan_of(sharp_case(config, rng, 1500)))
    size = min(config.row_width, 170), 90
    case = random_case(config, rng, "streams", *size, 120, frames=3)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(case, name, patterns=patterns, reset=False))
    tiles = -(-size[0] // TILE) * -(-size[1] // TILE)
    for cycles in (3, tiles - 1, tiles + 3, tiles + 40, tiles + 70, tiles + 200, 2 * tiles + 700):
        plan.append(plan_of(case, f"cut off after {cycles} cycles", abort=cycles))
        plan.append(plan_of(case, f"frames after a reset at {cycles}"))
    plan += [plan_of(case, reset=False) for case in many_cases(config, rng)]
    for k in range(8):
        width, height = (int(n) for n in rng.integers(1, (min(config.row_width, 700), min(config.row_width, 200))))
        case = random_case(config, rng, f"back to back {k}", width, height, 150, obb=k % 4 == 3)
        plan.append(plan_of(case, reset=False, quiet=20, most_cycles=most_cycles(case)))
    plan.append(plan_of(sharp_case(config, rng, 3000, ("slanted",))))
    for name, patterns in backpressure(PORTS[:2], PORTS[2:], seed).items():
        plan.append(plan_of(random_case(config, rng, name, *size, 120, frames=3), patterns=patterns, reset=False))
    return plan


def traced_plan(config: AcceleratorConfig, size: str, **scenes: object) -> list[Planned]:
    """Real scenes' frames at full rate, with the exact test and with boxes."""
    plan = []
    for name, frame in traced_frames(config, size, **scenes).items():
        for obb in (False, True):
            case = case_of(frame, f"traced {name}{', boxes' * obb}", obb=obb)
            plan.append(plan_of(case, reset=False, most_cycles=most_cycles(case)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *traced_plan(config, traced_size(config, "640x360"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per traced frame with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome, "traced"):
        splats, table = item.run.inputs["splats"], item.run.inputs["table"]
        levels = np.stack([table["level"], table["blend"]], 1).astype(np.int64)
        rendered = (table["rendered"] == 1,) if config.stereo else ()
        case = Case(item.name, config, item.run.settings["width"], item.run.settings["height"], (
            (splats[:-1], levels),), bool(item.run.settings["obb"]), rendered)
        (cost,), cycles = case.costs(), recording.cycles - len(table)
        lines.append(
            f"{item.name}: {len(splats) - 1} splats, {cost.runs} runs, {cost.entries} entries, "
            f"{recording.observed['filtered']} pairs filtered, in {cycles} cycles after the table's {len(table)}: "
            f"{cost.runs / cycles:.4f} runs and {cost.entries / cycles:.4f} entries a cycle")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
