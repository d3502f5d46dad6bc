"""Compares the machine's joint frames with a warped target (`spec.joint_warp`) with the golden renderer's."""

from __future__ import annotations

from math import ceil

import numpy as np

from golden.host.memory_image import memory_image, spill_beats
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.msv2_ref.saturations import joint_saturations
from golden.msv2_ref.supertiles import list_counts
from spec.memory import BEAT_ENTRIES, page_beats
from tb.frame.bound import joint_ops
from tb.top.check import differences, wrong_counters
from tb.top.check_stereo import rendered_pixels
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun
from tb.top.progress import Pass


def joint_warp_run(
    frame: WarpedJointFrame, beta: int | None, speed: MemorySpeed | None = None, name: str = "frame", *, obb: bool = False,
    **options: object,
) -> FrameRun:
    """The run of a golden joint frame with a warped target, with exactly as much memory as it needs; see `check.frame_run`."""
    counts = list_counts(frame.joint.pairs, frame.joint.bounds)
    spill = spill_beats(frame.config, np.bincount(frame.source.groups, counts).astype(np.int64))
    image = memory_image(
        frame.config, frame.source.words, frame.registers.source, beta=beta, obb=obb, display=True,
        entries_beats=page_beats(counts), spill_beats=spill, second=frame.registers)
    return FrameRun(name, image, speed or MemorySpeed(), expected=(_expected(frame),), **options)


def _expected(frame: WarpedJointFrame) -> Pass:
    """The expected work, for the progress bar: what memory, the projection unit and the array must do at least."""
    r, points, pairs = frame.registers.source, frame.joint.counts["points"], len(frame.sweeps.pairs.splat)
    beats, config = ceil(points / 2) + pairs // BEAT_ENTRIES + len(r.header), frame.config
    return Pass(beats, max(beats, 2 * points * config.point_interval),
                max(joint_ops(frame.sweeps) // config.streams, pairs * config.point_interval), 2 * r.width * r.height)


def joint_warp_mismatches(frame: WarpedJointFrame, result: FrameResult) -> list[dict[str, object]]:
    """Every value in which an eye's frame from memory differs from the golden one: first the source eye's, then the
    target's."""
    names = ("source", "target") if frame.pair is None else (frame.pair.source_eye, frame.pair.target_eye)
    wanted = frame.source_pixels, frame.target_pixels
    return [{"eye": name, **wrong} for name, pixels, got in zip(names, wanted, (result.pixels, result.target), strict=True)
            for wrong in differences(pixels, got)]


def joint_warp_events(frame: WarpedJointFrame) -> dict[str, int]:
    """The values that the machine's counters must have after the frame, for those counters that the golden frame determines."""
    found, r = dict(frame.joint.counts), frame.registers.source
    found["culled_faint"] = found.pop("culled_opacity")
    return {**JointBatches(frame.sweeps).events, **joint_saturations(frame.sweeps), **found, **frame.events,
            "groups": frame.groups, "pixels": r.width * r.height + rendered_pixels(frame.target)}


def joint_warp_counter_errors(frame: WarpedJointFrame, result: FrameResult) -> list[str]:
    """Descriptions of the counters that differ from the golden frame's values and from the memory's counts."""
    if not frame.config.counters:
        return []
    batches = JointBatches(frame.sweeps)
    visits = [batches.stream_visits(stream) for stream in range(frame.config.streams)]
    limits = {"visits": (sum(int(v.final.sum()) for v in visits), sum(len(v.final) for v in visits)),
              "ops": (0, joint_ops(frame.sweeps)), "skipped": (0, sum(len(v.order) for v in visits)),
              "cycles_target": (int(frame.holes.any()), result.registers["cycles_render"] if frame.holes.any() else 0)}
    return wrong_counters(joint_warp_events(frame), result) + [
        f"counter {name} must be in {low}..{high}, not {result.registers[name]!r}"
        for name, (low, high) in limits.items() if not low <= result.registers[name] <= high]
