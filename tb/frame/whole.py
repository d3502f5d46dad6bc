"""Runs a golden frame through the whole machine, from Gaussians and registers in memory to pixels in memory."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from golden.host.memory_image import DisplayPixels, FramePixels, PackedPixels
from golden.msv2_ref.array import Pixels
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import VISIBLE
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BYTES
from spec.registers import STEREO_WRITE_CLIENTS, read_clients, stages, write_clients
from tb.common.runner import SimulationError, Waves, build
from tb.frame.bound import RENDER_WRITES, bound_cycles, joint_bound_cycles, render_reads
from tb.top.check import counter_errors, frame_run, mismatches
from tb.top.check_joint import joint_events
from tb.top.check_joint_warp import joint_warp_events
from tb.top.device import Machine
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun, play_frames

_SHOWN = 10

_COMMON = ("culled_outside", "spilled_entries", "ops", "skipped")
_UNCERTAIN = {False: (*_COMMON[:2], "fetch_hits", "fetch_misses", *_COMMON[2:]), True: (*_COMMON, "visits")}
"""Events that the golden frame does not determine, without and with super-tiles."""


def simulate_machine(
    frame: Frame, machine: Machine, folder: Path, *, beta: int | None, speed: MemorySpeed, display: bool = False,
    packed: bool = False, waves: Waves | None = None,
) -> tuple[dict[str, object], FramePixels | DisplayPixels | PackedPixels]:
    """The numbers of frame.json, and the pixels that the machine wrote.

    Raises:
        SimulationError: the build fails, or the machine does not finish its frame.
    """
    (found,) = simulate_row([frame], machine, folder, beta=beta, speed=speed, display=display, packed=packed, waves=waves)
    return found


def simulate_row(
    frames: Sequence[Frame], machine: Machine, folder: Path, *, beta: int | None, speed: MemorySpeed, display: bool = False,
    packed: bool = False, waves: Waves | None = None,
) -> list[tuple[dict[str, object], FramePixels | DisplayPixels | PackedPixels]]:
    """The same for golden frames that follow each other without a reset, and in a memory that nobody clears between them. With
    super-tiles, each must have the bounds of the one before.

    Raises:
        SimulationError: the build fails, or the machine does not finish a frame.
    """
    runs = [frame_run(frame, beta, speed, f"frame {n}", display=display, packed=packed, reset=n == 0, poison=n == 0)
            for n, frame in enumerate(frames)]
    results, build_s = played(machine, runs, folder, waves)
    return [
        ({**compared([frame], result, mismatches(frame, result.pixels), counter_errors(frame, result)),
          **performance(frame, result, speed), "build_s": build_s,
          **({} if frame.pairs is None else {"lists": frame.bounds.lists})}, result.pixels)
        for frame, result in zip(frames, results, strict=True)]


def compared(
    eyes: Sequence[Frame], result: FrameResult, wrong: Sequence[Mapping[str, object]], counters: Sequence[str],
) -> dict[str, object]:
    """What was compared in a frame of one or two eyes, and what differs. Tiles and visible Gaussians are those of the source
    eye, because both eyes share them."""
    source = eyes[0]
    return {
        "bit_exact": not wrong and not result.errors,
        "pixels_checked": len(eyes) * source.registers.width * source.registers.height,
        "tiles": len(source.registers.header), "visible": int((source.projected.reason == VISIBLE).sum()),
        "entries": sum(len(eye.entries.splat) for eye in eyes), "groups": sum(int(eye.groups[-1]) + 1 for eye in eyes),
        "ops": result.registers["ops"], "skipped": result.registers["skipped"],
        "mismatches": len(wrong), "first_mismatches": wrong[:_SHOWN],
        "stream_errors": result.errors, "counter_errors": counters,
    }


def played(
    machine: Machine, runs: Sequence[FrameRun], folder: Path, waves: Waves | None,
) -> tuple[list[FrameResult], float]:
    """The machine's output for frames, and the seconds that building the simulator took.

    Raises:
        SimulationError: the build fails, or the machine does not finish a frame.
    """
    begin = time.perf_counter()
    build(machine.design(), waves)
    build_s = time.perf_counter() - begin
    results = play_frames(machine, runs, folder, waves=waves, progress=True)
    for run, result in zip(runs, results, strict=True):
        if not result.done:
            name = run.name if len(runs) > 1 else "the frame"
            raise SimulationError(", ".join([f"{name} ended with error {result.error.name}", *result.errors]))
    return results, round(build_s, 3)


def performance(
    frame: Frame, result: FrameResult, speed: MemorySpeed, *, second: Frame | None = None,
) -> dict[str, object]:
    """Cycles, beats and utilisation of a frame, or of both eyes together where `second` is the target eye's frame."""
    r, config = result.registers, frame.config
    bounds = bound_cycles(frame, r["ops"], _beats(r, "read", render_reads(config)), _beats(r, "write", RENDER_WRITES),
                          speed.bytes_per_cycle, second=second)
    return measured(config, result, speed, bounds, expected_events(frame))


def joint_performance(frame: JointFrame, result: FrameResult, speed: MemorySpeed) -> dict[str, object]:
    """The same of a joint frame, of both eyes together."""
    r, config = result.registers, frame.config
    bounds = joint_bound_cycles(frame, r["ops"], _beats(r, "read", render_reads(config)), _beats(r, "write", RENDER_WRITES),
                                speed.bytes_per_cycle)
    return measured(config, result, speed, bounds, joint_events(frame))


def joint_warp_performance(frame: WarpedJointFrame, result: FrameResult, speed: MemorySpeed) -> dict[str, object]:
    """The same of a joint frame with a warped target, of both sweeps together."""
    r, config = result.registers, frame.config
    bounds = joint_bound_cycles(frame.sweeps, r["ops"], _beats(r, "read", render_reads(config)),
                                _beats(r, "write", (*RENDER_WRITES, *STEREO_WRITE_CLIENTS)), speed.bytes_per_cycle)
    return measured(config, result, speed, bounds, joint_warp_events(frame))


def measured(
    config: AcceleratorConfig, result: FrameResult, speed: MemorySpeed, bounds: dict[str, int], events: Iterable[str],
) -> dict[str, object]:
    """Cycles, beats and utilisation of a frame with these bounds and these events that the golden frame determines."""
    r = result.registers
    watched = {stage: {what: r[f"{stage}_{what}"] for what in ("busy", "starved", "blocked")} for stage in stages(config)}
    render = r["cycles_render"]
    return {
        "cycles": result.cycles, "idle_cycles": result.idle_cycles,
        "frame_cycles": r["cycles_total"], "table_cycles": r["cycles_table"],
        "geometry_cycles": r["cycles_geometry"], "render_cycles": render,
        "overlapped_cycles": max(r["cycles_geometry"], render),
        "bound_cycles": max(bounds.values()), "bounds": bounds,
        "utilisation": round(max(bounds.values()) / render, 4) if render else None,
        "stage_cycles": watched, "stalls": {stage: cycles["blocked"] for stage, cycles in watched.items()},
        "events": {name: r[name] for name in (*events, *_UNCERTAIN[config.supertiles])},
        "dram_bytes": {
            "read": BEAT_BYTES * result.reads, "write": BEAT_BYTES * result.writes,
            "reads": {name: BEAT_BYTES * r[f"read_beats_{name}"] for name in read_clients(config)},
            "writes": {name: BEAT_BYTES * r[f"write_beats_{name}"] for name in write_clients(config)}},
        "activates": result.activates, "refreshes": result.refreshes,
        "memory_busy_cycles": result.busy, **speed.record,
        "wall_s": round(result.seconds, 3), "cpu_s": round(result.cpu_seconds, 3),
        "cycles_per_s": round(result.cycles / result.seconds)}


def _beats(registers: Mapping[str, int], way: str, clients: tuple[str, ...]) -> int:
    return sum(registers[f"{way}_beats_{name}"] for name in clients)


def picture(frame: Frame, pixels: FramePixels | DisplayPixels | PackedPixels) -> np.ndarray:
    """The picture of a frame from memory, (height, width, 3): float64, or uint8 where the frame has display pixels."""
    if not isinstance(pixels, FramePixels):
        return pixels.colour.astype(np.uint8)
    return replace(frame, pixels=tiled(frame, pixels)).image


def tiled(frame: Frame, pixels: FramePixels) -> Pixels:
    """A frame from memory, split into tiles. The pixels of border tiles that lie outside the frame are the golden ones."""
    r, fields = frame.registers, []
    for name in Pixels._fields:
        whole = np.array(getattr(frame.pixels, name)).reshape(r.tiles_y, r.tiles_x, TILE, TILE, -1).swapaxes(1, 2)
        whole = whole.reshape(r.tiles_y * TILE, r.tiles_x * TILE, -1)
        whole[: r.height, : r.width] = getattr(pixels, name).reshape(r.height, r.width, -1)
        by_tile = whole.reshape(r.tiles_y, TILE, r.tiles_x, TILE, -1).swapaxes(1, 2)
        fields.append(by_tile.reshape(getattr(frame.pixels, name).shape))
    return Pixels(*fields)
