"""The machine's tests: frames back to back in one simulation, with errors, aborts and resets between; every pixel and every
counter is compared."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from spec.codes import ErrorCode
from spec.config import (
    BALANCED,
    DEFAULT,
    PAPER,
    PAPER_SMALL,
    SHORT_FORMATS,
    TINY,
    TINY_EYES,
    TINY_EYES_OVERLAP,
    TINY_EYES_WARP,
    TINY_OVERLAP,
    TINY_STREAMS,
    TINY_V3,
    V3,
    V3_EYES,
    V3_EYES_OVERLAP,
    V3_EYES_WARP,
    V3_OVERLAP,
    V3_PACKED,
    V3_RECORDS,
    V3_STREAMS,
    AcceleratorConfig,
)
from spec.host_settings import settings
from spec.memory import FIRST_PAGE_BEATS
from spec.registers import CHUNK_READ_CLIENTS, read_clients, write_clients
from tb.common.exact import Outcome
from tb.common.runner import Waves
from tb.common.scenes import traced_frames, traced_size
from tb.frame.bound import least_cycles
from tb.top.check import frame_run
from tb.top.device import Machine, machine
from tb.top.plan_buckets import bucket_plan
from tb.top.plan_joint import broken_joint_plan, good_joint_plan
from tb.top.plan_joint_warp import broken_joint_warp_plan, good_joint_warp_plan
from tb.top.plan_stereo import broken_stereo_plan, good_stereo_plan
from tb.top.planned import SPEEDS, PlannedFrame, failing, failing_table, pixels_of, planned, problems
from tb.top.player import play_frames
from tb.top.stimuli import case, cloud, crowd, small_cases

TINY_RECORDS = TINY.with_(name="tiny_records", order="spatial", chunks=True, records="compact")
"""The small machine with chunks of compact records, and lists by tile."""

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "tiny_baseline": TINY.with_(name="tiny_baseline", incremental=False), "default": DEFAULT,
    "paper": PAPER, "paper_small": PAPER_SMALL,
    "tiny_stereo": TINY.with_(name="tiny_stereo", stereo=True),
    "tiny_stereo_baseline": TINY.with_(name="tiny_stereo_baseline", stereo=True, incremental=False, warp_lanes=4),
    "tiny_short": TINY.with_(name="tiny_short", formats=SHORT_FORMATS, sh_degree=BALANCED.sh_degree),
    "tiny_records": TINY_RECORDS, "tiny_chunks": TINY_RECORDS.with_(name="tiny_chunks", records="wide"),
    "tiny_records_stereo": TINY_RECORDS.with_(name="tiny_records_stereo", stereo=True), "v3_records": V3_RECORDS,
    "tiny_v3": TINY_V3, "v3": V3, "tiny_streams": TINY_STREAMS, "v3_streams": V3_STREAMS,
    "tiny_v3_baseline": TINY_V3.with_(name="tiny_v3_baseline", incremental=False, buckets=False),
    "tiny_v3_packed": TINY_V3.with_(name="tiny_v3_packed", packed=True), "v3_packed": V3_PACKED,
    "tiny_streams_packed": TINY_STREAMS.with_(name="tiny_streams_packed", packed=True),
    "tiny_eyes": TINY_EYES, "tiny_eyes_streams": TINY_STREAMS.with_(name="tiny_eyes_streams", joint=True),
    "tiny_eyes_packed": TINY_EYES.with_(name="tiny_eyes_packed", packed=True),
    "tiny_eyes_full": TINY_STREAMS.with_(name="tiny_eyes_full", joint=True, packed=True), "v3_eyes": V3_EYES,
    "tiny_eyes_warp": TINY_EYES_WARP, "v3_eyes_warp": V3_EYES_WARP,
    "tiny_overlap": TINY_OVERLAP, "v3_overlap": V3_OVERLAP,
    "tiny_overlap_streams": TINY_STREAMS.with_(name="tiny_overlap_streams", overlap=True, packed=True),
    "tiny_eyes_overlap": TINY_EYES_OVERLAP, "v3_eyes_overlap": V3_EYES_OVERLAP,
    "tiny_eyes_overlap_full": TINY_STREAMS.with_(name="tiny_eyes_overlap_full", joint=True, overlap=True, packed=True)}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "tiny_baseline", "tiny_stereo", "tiny_stereo_baseline", "tiny_short", "tiny_records", "tiny_chunks",
            "tiny_records_stereo", "tiny_v3", "tiny_v3_baseline", "tiny_v3_packed", "tiny_streams", "tiny_eyes",
            "tiny_eyes_streams", "tiny_eyes_packed", "tiny_eyes_full", "tiny_eyes_warp")
"""Configurations with different machines: both ways of handing over, the presets' number formats, chunks, packed frames, four
arrays, and joint frames. Larger machines are simulated with whole frames (`tb.frame`)."""


def good_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Every case on two memories, the second time without a reset and without clearing the memory of the previous frame.

    Frames have the formats of `pixels_of`, and the second run of a case has another one than the first. Machines with stereo
    or with joint frames play frames of two eyes instead, and some of one eye among them.
    """
    if config.warps_joint:
        return good_joint_warp_plan(config, seed)
    if config.stereo:
        return good_stereo_plan(config, seed)
    if config.joint:
        return good_joint_plan(config, seed)
    cases, names = small_cases(config, seed), list(SPEEDS)
    plan = [planned(case, "usual memory", **pixels_of(config, n)) for n, case in enumerate(cases)]
    return plan + [
        planned(case, f"{names[1 + n % 4]} memory, back to back", names[1 + n % 4], **pixels_of(config, n + 1), reset=False,
                poison=False)
        for n, case in enumerate(cases)]


def broken_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Frames that end early. Each is followed by a frame that must be correct, and there is no reset between them where the
    machine needs none. Where the machine packs frames, they are packed."""
    if config.warps_joint:
        return broken_joint_warp_plan(config, seed)
    if config.stereo:
        return broken_stereo_plan(config, seed)
    if config.joint:
        return broken_joint_plan(config, seed)
    rng = np.random.default_rng(seed)
    scene = case(config, "scene", cloud(rng, 200, sh=1), (64, 48))
    chunk = config.sort_chunk
    spilling = case(config, "spilling scene", crowd(rng, 2 * chunk + 5), (16, 16), beta=0)
    plan = []
    how = {"packed": True} if config.packed else {}

    def add(*frames: PlannedFrame, reset: bool = False) -> None:
        plan.extend([*frames, planned(scene, f"after: {frames[-1].name}", reset=reset, **how)])

    least = least_cycles(scene.frame)  # no frame takes fewer
    for cycles in (1, 40, 250, least // 3, 2 * least // 3, least - 1):
        add(planned(scene, f"reset after {cycles} cycles", cut=cycles, **how), reset=True)
        add(planned(scene, f"abort after {cycles} cycles", error=ErrorCode.ABORTED, abort=cycles, **how))
    for name in ("geometry", "tiles", "colour", *(CHUNK_READ_CLIENTS if config.chunks else ())):
        clients = {"error_clients": 1 << read_clients(config).index(name)}
        add(failing(scene, name, ErrorCode.READ_ERROR, clients, **how))
    if config.supertiles:
        add(failing(scene, "supertiles", ErrorCode.READ_ERROR, {"error_clients": 1 << read_clients(config).index("tiles")},
                    **how))
    writers = write_clients(config)
    for name in (name for name in writers if name != "spill"):
        add(failing(scene, name, ErrorCode.WRITE_ERROR, {"error_clients": 1 << 16 + writers.index(name)}, **how))
    add(failing(spilling, "spill", ErrorCode.WRITE_ERROR, {"error_clients": 1 << 16 + writers.index("spill")}, **how))
    if config.packed:
        add(failing_table(scene, {"error_clients": 1 << 16 + writers.index("frame")}))
    numbers = {setting.name: setting.number for setting in settings(config)}
    for name, value in (("near", 0), ("width", 0), ("height", 1 << 13), ("view_shift", 3), ("depth_scale", 1 << 27),
                        *([("display", 0)] if config.packed else [])):
        if name not in numbers:
            continue
        registers = {"bad_setting": numbers[name], "cycles_render": 0}
        add(planned(scene, f"{name} = {value}", error=ErrorCode.BAD_SETTING, registers=registers, changes={name: value}, **how))
    first_pages = {"entries_beats": FIRST_PAGE_BEATS}
    add(planned(spilling, "no room for second pages", error=ErrorCode.ENTRIES_FULL, changes=first_pages, **how))
    add(planned(spilling, "no room for runs", error=ErrorCode.SPILL_FULL, changes={"spill_beats": 2}, **how))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[PlannedFrame]:
    """Frames of real scenes."""
    return [PlannedFrame(frame_run(frame, None, name=f"traced {name}"), frame)
            for name, frame in traced_frames(config, size).items()]


def full_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """All runs."""
    traced = traced_plan(config, traced_size(config, "256x144", "96x64"))
    return [*good_plan(config, seed), *broken_plan(config, seed), *bucket_plan(config), *traced]


@cache
def _machine(config: AcceleratorConfig) -> Machine:
    return machine(config)


def run_plan(
    config: AcceleratorConfig, plan: Sequence[PlannedFrame], folder: Path, *, waves: Waves | None = None,
    progress: bool = False,
) -> Outcome:
    """Plays a plan and compares all results. Raises SimulationError when the simulation itself fails."""
    begin, outcome = time.perf_counter(), Outcome()
    results = play_frames(_machine(config), [item.run for item in plan], folder, waves=waves, progress=progress)
    for item, result in zip(plan, results, strict=True):
        outcome.runs += 1
        outcome.cycles += result.cycles
        outcome.items += item.frame.registers.width * item.frame.registers.height * (item.error is ErrorCode.NONE)
        outcome.recordings[item.name] = result
        wrong = problems(item, result)
        if wrong:
            outcome.failures[item.name] = wrong
    outcome.seconds = time.perf_counter() - begin
    return outcome


def figures(config: AcceleratorConfig, plan: Sequence[PlannedFrame], outcome: Outcome) -> list[str]:
    """One line per frame of a real scene with its cycles."""
    lines = []
    for item in plan:
        if item.name.startswith("traced"):
            r = outcome.recordings[item.name].registers
            lines.append(f"{item.name}: {len(item.frame.entries.splat)} entries, geometry {r['cycles_geometry']}, rendering "
                         f"{r['cycles_render']} cycles")
    return lines
