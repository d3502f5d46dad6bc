"""Compares the machine's frames with the golden renderer's: every bit of the pixels, and the counters."""

from __future__ import annotations

import numpy as np

from golden.host.memory_image import DisplayPixels, FramePixels, PackedPixels, memory_image, spill_beats
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels, list_lengths
from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import page_beats
from tb.frame.bound import array_ops
from tb.top.check_packed import packed_counter_errors, packed_differences
from tb.top.expected import expected_pass
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun


def frame_run(
    frame: Frame, beta: int | None, speed: MemorySpeed | None = None, name: str = "frame", *, obb: bool = False,
    display: bool = False, packed: bool = False, **options: object,
) -> FrameRun:
    """The run of a golden frame, with exactly as much memory as it needs.

    Args:
        frame: the golden frame.
        beta, obb: the values that `pipeline.render` was given.
        speed: the memory's speed.
        name: the run's name, for messages.
        display: whether the machine writes display pixels.
        packed: whether it packs the frame.
        options: further arguments of FrameRun.
    """
    entries_beats, spill = room(frame)
    image = memory_image(frame.config, frame.words, frame.registers, beta=beta, obb=obb, display=display, packed=packed,
                         entries_beats=entries_beats, spill_beats=spill)
    speed = speed or MemorySpeed()
    return FrameRun(name, image, speed, expected=(expected_pass(frame, speed, display=display or packed),), **options)


def room(frame: Frame) -> tuple[int, int]:
    """The beats that a golden frame needs for its lists and for its spilled runs."""
    counts = list_lengths(frame)
    return page_beats(counts), spill_beats(frame.config, np.bincount(frame.groups, counts).astype(np.int64))


def mismatches(frame: Frame, pixels: FramePixels | DisplayPixels | PackedPixels) -> list[dict[str, object]]:
    """Every value in which a frame from memory differs from the golden one, in the order of tiles; of a packed frame its
    entries and beats, too."""
    if isinstance(pixels, PackedPixels):
        golden = display_pixels(frame)
        return packed_differences(golden, pixels) + differences(golden, DisplayPixels(pixels.colour, pixels.coverage))
    return differences(display_pixels(frame) if isinstance(pixels, DisplayPixels) else frame_pixels(frame), pixels)


def differences(wanted: np.ndarray, pixels: FramePixels | DisplayPixels) -> list[dict[str, object]]:
    """Every value in which a frame from memory differs from (height, width) golden records, in the order of tiles."""
    found, tiles_x = [], -(-wanted.shape[1] // TILE)
    for name, got in pixels._asdict().items():
        golden = wanted[name]
        wrong = (got != golden).reshape(*got.shape[:2], -1).any(axis=2)
        for y, x in np.argwhere(wrong).tolist():
            tile = y // TILE * tiles_x + x // TILE
            found.append({"field": name, "tile": tile, "x": x, "y": y, "rtl": np.ravel(got[y, x]).tolist(),
                          "golden": np.ravel(golden[y, x]).tolist()})
    return sorted(found, key=lambda m: (m["tile"], m["y"], m["x"]))


def counter_errors(frame: Frame, result: FrameResult) -> list[str]:
    """Descriptions of the counters that differ from the golden frame's values and from the memory's counts."""
    if not frame.config.counters:
        return []
    packed = packed_counter_errors(frame, result) if isinstance(result.pixels, PackedPixels) else []
    visits = _wrong_visits(frame, result) if frame.config.supertiles else []
    return wrong_counters(expected_events(frame), result) + visits + packed


def _wrong_visits(frame: Frame, result: FrameResult) -> list[str]:
    """Describes a number of visits that no frame can have. Every tile has a last one; the others, and ops, depend on when the
    tiles' pixels stop."""
    batches = FrameBatches(frame)
    visits = [batches.stream_visits(stream) for stream in range(frame.config.streams)]
    limits = {"visits": (sum(int(v.final.sum()) for v in visits), sum(len(v.final) for v in visits)),
              "ops": (0, array_ops(frame)), "skipped": (0, sum(len(v.order) for v in visits))}
    return [f"counter {name} must be in {low}..{high}, not {result.registers[name]!r}"
            for name, (low, high) in limits.items() if not low <= result.registers[name] <= high]


def wrong_counters(events: dict[str, int], result: FrameResult) -> list[str]:
    """Descriptions of the counters that differ from `events` and from the memory's counts."""
    memory = {"read_beats": result.reads, "write_beats": result.writes}
    return [f"counter {name} must be {wanted}, not {result.registers[name]!r}"
            for name, wanted in {**events, **memory}.items() if result.registers[name] != wanted]
