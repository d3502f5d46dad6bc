"""Compares the machine's frames of two eyes with the golden renderer's."""

from __future__ import annotations

import numpy as np

from golden.host.memory_image import memory_image
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from tb.top.check import differences, room, wrong_counters
from tb.top.expected import expected_pass
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun


def stereo_run(
    frame: StereoFrame, beta: int | None, speed: MemorySpeed | None = None, name: str = "frame", *, obb: bool = False,
    **options: object,
) -> FrameRun:
    """The run of a golden frame of two eyes, with exactly as much memory as both need; see `check.frame_run`."""
    source = frame.source
    entries_beats, spill_beats = (max(both) for both in zip(room(source), room(frame.target), strict=True))
    image = memory_image(
        source.config, source.words, source.registers, beta=beta, obb=obb, entries_beats=entries_beats, spill_beats=spill_beats,
        second=frame.registers)
    speed, rendered = speed or MemorySpeed(), rendered_pixels(frame.target)
    expected = (
        expected_pass(source, speed, display=True, pixels=2 * source.registers.width * source.registers.height - rendered),
        expected_pass(frame.target, speed, display=True, pixels=rendered))
    return FrameRun(name, image, speed, expected=expected, **options)


def stereo_mismatches(frame: StereoFrame, result: FrameResult) -> list[dict[str, object]]:
    """Every value in which an eye's frame from memory differs from the golden one: first the source eye's, then the
    target's."""
    eyes = ((frame.pair.source_eye, frame.source_pixels, result.pixels),
            (frame.pair.target_eye, frame.target_pixels, result.target))
    return [{"eye": eye, **wrong} for eye, wanted, got in eyes for wrong in differences(wanted, got)]


def stereo_events(frame: StereoFrame) -> dict[str, int]:
    """The values that the machine's counters must have after the frame: the events of both passes and those of the warp
    unit."""
    source, target = expected_events(frame.source), expected_events(frame.target)
    both = {name: source[name] + target[name] for name in source}
    return {**both, "pixels": source["pixels"] + rendered_pixels(frame.target), **frame.events}


def rendered_pixels(frame: Frame) -> int:
    """Number of pixels in the rendered tiles."""
    r = frame.registers
    width, height = (np.minimum(size - TILE * np.arange(-(-size // TILE)), TILE) for size in (r.width, r.height))
    pixels = np.outer(height, width).reshape(-1)
    return int(pixels.sum() if frame.rendered is None else pixels[frame.rendered].sum())


def stereo_counter_errors(frame: StereoFrame, result: FrameResult) -> list[str]:
    """Descriptions of the counters that differ from the golden frame's values and from the memory's counts."""
    return wrong_counters(stereo_events(frame), result) if frame.source.config.counters else []
