"""Compares the machine's joint frames of two eyes (`spec.joint`) with the golden renderer's."""

from __future__ import annotations

from math import ceil
from typing import Protocol, TypeAlias

import numpy as np

from golden.host.memory_image import DisplayPixels, FramePixels, PackedPixels, memory_image, spill_beats
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.saturations import joint_saturations
from golden.msv2_ref.supertiles import list_counts
from spec.memory import BEAT_ENTRIES, page_beats
from tb.frame.bound import joint_ops
from tb.top.check import mismatches, wrong_counters
from tb.top.check_packed import joint_packed_errors
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun
from tb.top.progress import Pass

Pixels: TypeAlias = FramePixels | DisplayPixels | PackedPixels


def joint_run(
    frame: JointFrame, beta: int | None, speed: MemorySpeed | None = None, name: str = "frame", *, obb: bool = False,
    display: bool = False, packed: bool = False, **options: object,
) -> FrameRun:
    """The run of a golden joint frame, with exactly as much memory as it needs; see `check.frame_run`."""
    counts = list_counts(frame.pairs, frame.bounds)
    spill = spill_beats(frame.config, np.bincount(frame.source.groups, counts).astype(np.int64))
    image = memory_image(
        frame.config, frame.source.words, frame.registers.source, beta=beta, obb=obb, display=display, packed=packed,
        entries_beats=page_beats(counts), spill_beats=spill, second=frame.registers)
    return FrameRun(name, image, speed or MemorySpeed(), expected=(_expected(frame),), **options)


def _expected(frame: JointFrame) -> Pass:
    """The expected work, for the progress bar: what memory, the projection unit and the array must do at least."""
    r, points, pairs = frame.registers.source, frame.counts["points"], len(frame.pairs.splat)
    beats, config = ceil(points / 2) + pairs // BEAT_ENTRIES + len(r.header), frame.config
    return Pass(beats, max(beats, 2 * points * config.point_interval),
                max(joint_ops(frame) // config.streams, 2 * pairs * config.point_interval), 2 * r.width * r.height)


class _Eyes(Protocol):
    """The pixels of both eyes."""

    @property
    def pixels(self) -> Pixels: ...
    @property
    def target(self) -> Pixels | None: ...


def joint_mismatches(frame: JointFrame, result: _Eyes) -> list[dict[str, object]]:
    """Every value in which an eye's frame from memory differs from the golden one, as `check.mismatches` tells them: first the
    source eye's, then the target's."""
    names = ("source", "target") if frame.pair is None else (frame.pair.source_eye, frame.pair.target_eye)
    return [{"eye": name, **wrong} for name, eye, got in zip(names, frame.eyes, (result.pixels, result.target), strict=True)
            for wrong in mismatches(eye, got)]


def joint_events(frame: JointFrame) -> dict[str, int]:
    """The values that the machine's counters must have after the frame, for those counters that the golden frame determines."""
    found, r = dict(frame.counts), frame.registers.source
    found["culled_faint"] = found.pop("culled_opacity")
    return {**found, "groups": int(frame.source.groups[-1]) + 1, "pixels": 2 * r.width * r.height,
            **JointBatches(frame).events, **joint_saturations(frame)}


def joint_counter_errors(frame: JointFrame, result: FrameResult) -> list[str]:
    """Descriptions of the counters that differ from the golden frame's values and from the memory's counts."""
    if not frame.config.counters:
        return []
    batches = JointBatches(frame)
    visits = [batches.stream_visits(stream) for stream in range(frame.config.streams)]
    limits = {"visits": (sum(int(v.final.sum()) for v in visits), sum(len(v.final) for v in visits)),
              "ops": (0, joint_ops(frame)), "skipped": (0, sum(len(v.order) for v in visits))}
    packed = joint_packed_errors(batches, result) if isinstance(result.pixels, PackedPixels) else []
    return wrong_counters(joint_events(frame), result) + packed + [
        f"counter {name} must be in {low}..{high}, not {result.registers[name]!r}"
        for name, (low, high) in limits.items() if not low <= result.registers[name] <= high]
