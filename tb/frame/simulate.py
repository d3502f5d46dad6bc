"""Runs a golden frame's intersections through the RTL array and compares its pixels."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from golden.msv2_ref.pipeline import Frame
from spec.config import AcceleratorConfig
from spec.constants import TILE
from tb.common.player import Recording, play
from tb.common.runner import SimulationError, Waves, build
from tb.vrc_array.array_check import Mismatch, mismatches, run_of
from tb.vrc_array.array_device import tiles_from_rows, vrc_playback
from tb.vrc_array.array_stimuli import Case

_SHOWN = 10


def simulate_frame(
    config: AcceleratorConfig, frame: Frame, folder: Path, waves: Waves | None = None,
) -> tuple[dict[str, object], Frame]:
    """The numbers of frame.json, and the frame with the RTL's pixels in place of the golden ones.

    Raises:
        SimulationError: the build fails, or the array does not give every pixel exactly once.
    """
    case = Case("frame", frame.headers, frame.array_entries, frame.registers.background)
    playback = vrc_playback(config)
    begin = time.perf_counter()
    build(playback.design(), waves)
    build_s = time.perf_counter() - begin
    recording, = play(playback, [run_of(config, case)], folder, waves=waves, progress=True)
    try:
        pixels = tiles_from_rows(config, case.headers, recording.outputs["pixels"])
    except ValueError as error:
        raise SimulationError(", ".join([str(error), *recording.errors])) from error
    wrong = mismatches(pixels, frame.pixels)
    numbers = {
        "bit_exact": not wrong and not recording.errors,
        "pixels_checked": frame.registers.width * frame.registers.height,
        "tiles": len(case.headers),
        "entries": len(case.entries),
        "ops": recording.observed["ops"],
        "skipped": recording.observed["skipped"],
        "mismatches": len(wrong),
        "first_mismatches": [_in_frame(case, m) for m in wrong[:_SHOWN]],
        "stream_errors": recording.errors,
        **_speed(recording),
        "build_s": round(build_s, 3),
    }
    return numbers, replace(frame, pixels=pixels)


def _in_frame(case: Case, m: Mismatch) -> dict[str, object]:
    header = case.headers[m.tile]
    x, y = int(header["tile_x"]) * TILE + m.x, int(header["tile_y"]) * TILE + m.y
    return {"field": m.field, "x": x, "y": y, "rtl": m.rtl, "golden": m.golden}


def _speed(recording: Recording) -> dict[str, object]:
    return {
        "cycles": recording.cycles, "stalls": recording.stalls, "wall_s": round(recording.seconds, 3),
        "cycles_per_s": round(recording.cycles / recording.seconds)}
