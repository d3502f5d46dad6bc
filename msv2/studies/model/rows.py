"""The cycle model's numbers for a frame of a report of the RTL: on its machine, and on the memory as the RTL found it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from golden.host.run_options import IDEAL, LPDDR3
from golden.msv2_ref.buckets import no_bounds
from golden.scenes.level_source import RANDOM
from golden.scenes.request import parse_request, resolve
from perf import supertiles_trace
from perf.model import FrameCycles, MemoryModel, simulate
from perf.phases import LastingMemory
from perf.supertiles import simulate_supertiles
from perf.supertiles_plan import steady_bounds
from perf.supertiles_trace import SuperTrace
from perf.trace import FrameTrace, trace_request
from spec.config import MACHINES, PAPER_SMALL, AcceleratorConfig
from spec.constants import TILE
from spec.effects import EffectPlan
from spec.paths import ROOT

BUILD = ROOT / "build" / "perf"

PHASES = ("table", "geometry", "render")

RENAMED = {"default": PAPER_SMALL}
"""The machines of frames in reports of before `default` had lists by super-tile, by the names that they had."""


def request(row: Mapping[str, object], scene: str) -> argparse.Namespace:
    """The parsed arguments of a report's frame."""
    argv = [scene, "--size", "x".join(map(str, row["size"]))]
    argv += ["--gaze", ",".join(map(str, row["gaze"]))] if row.get("gaze") else []
    argv += ["--levels", str(row["levels"]), "--levels-from", RANDOM] if row["levels"] > 1 else []
    argv += ["--stereo"] if "target_cycles" in row else []
    argv += row.get("camera_options", [])
    return parse_request(*argv)


def machine(row: Mapping[str, object]) -> AcceleratorConfig:
    """The machine of a report's frame: that of its whole configuration, or only what the frame needs (tb.frame --machine)."""
    config = MACHINES[row["config"]]
    if config.supertiles and "fetch_hits" in row["events"]:
        config = RENAMED[config.name]
    config = config.with_(stereo=True) if "target_cycles" in row else config
    if row.get("machine") != "scene":
        return config
    said = row["effects"]
    active = frozenset(name for name, effect in said["effects"].items() if effect["state"] != "absent")
    return EffectPlan(said["wanted"], active, frozenset(), {}, said["sh_degree"]).machine(config)


def memory_of(row: Mapping[str, object], before: LastingMemory | None = None) -> LastingMemory:
    """The memory at the start of a report's frame. `before` is that of the frame before, if the machine was not reset since."""
    eyes = 2 if "target_cycles" in row else 1
    clearing = row["frame_cycles"] - sum(row[f"{name}_cycles"] for name in PHASES) - eyes * (-(-row["size"][1] // TILE) + 1)
    idle = row.get("idle_cycles", 0) + max(0, clearing)  # after a reset, units clear memories of theirs
    if before is None:
        lpddr3 = row.get("memory", IDEAL) == LPDDR3
        model = MemoryModel(LPDDR3) if lpddr3 else MemoryModel(IDEAL, row["latency"], row["bytes_per_cycle"])
        return LastingMemory(model, idle)
    before.wait(idle)
    return before


def model_row(
    row: Mapping[str, object], scene: str, memory: LastingMemory | None = None,
) -> tuple[FrameTrace | SuperTrace, FrameCycles]:
    """The trace of a report's frame, and its numbers from the model. `memory`: see `memory_of`; None where it was reset."""
    config = machine(row)
    how = {"memory": memory or memory_of(row), "merge": row["merge"], "pipeline": row["pipeline"],
           "display": row["pixels"] == "display"}
    if not config.supertiles:
        trace = trace_request(request(row, scene), config, cache=BUILD / "traces")
        return trace, simulate(trace, config, **how)
    trace = super_trace(row, scene, config, row.get("number", 0))
    bounds = no_bounds(trace.supertiles)  # as after a reset
    if row.get("number"):
        bounds = steady_bounds(super_trace(row, scene, config, row["number"] - 1), config)
    return trace, simulate_supertiles(trace, config, bounds=bounds, **how)


def model_rows(
    rows: Iterable[Mapping[str, object]], scene_of: Callable[[str], str],
) -> Iterator[tuple[Mapping[str, object], FrameTrace | SuperTrace, FrameCycles]]:
    """The frames of a report, each with its trace and its numbers from the model. Frames of a row must follow each other, from
    the first one on: their memory lasts. `scene_of` finds the scene of a row's name."""
    memory = None
    for row in rows:
        memory = memory_of(row, memory if row.get("number") else None)
        yield row, *model_row(row, scene_of(row["scene"]), memory)


def super_trace(row: Mapping[str, object], scene: str, config: AcceleratorConfig, number: int) -> SuperTrace:
    """The trace of a frame of a row of frames, of which the first has the number 0 and the camera that the request names."""
    args, degrees = request(row, scene), number * row.get("turn", 0.0)
    if not degrees:
        return supertiles_trace.trace_request(args, config, cache=BUILD / "traces")
    asked = resolve(args)
    return supertiles_trace.trace_request(
        args, config, cache=BUILD / "traces" / f"turned-{degrees:g}",
        request=replace(asked, camera=asked.camera.turned(degrees)))
