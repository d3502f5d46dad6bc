"""How fast a frame could be rendered: what every rendering stage must do, at one item a cycle."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES

RENDER_READS, RENDER_WRITES = ("entries", "spill", "views"), ("spill", "frame")
"""Clients of the memory that work in the rendering phase."""


def array_ops(frame: Frame) -> int:
    """Most ops of the array: one a level that uses an entry, one a level for a rendered tile's background; each for every block
    of a tile."""
    blend = frame.headers["blend"].astype(int)
    return frame.config.blocks * int(len(frame.entries.splat) + (frame.entries.use == 3).sum() + (1 + blend).sum())


def bound_cycles(
    frame: Frame, ops: int, read_beats: int, write_beats: int, bytes_per_cycle: float | None, *, second: Frame | None = None,
) -> dict[str, int]:
    """Least cycles of the rendering phase, by what sets them.

    The array takes an entry a cycle and level, even if it then skips it, and issues an op a cycle.

    Args:
        frame: the golden frame.
        ops: what the array issued; less than `array_ops` where entries were skipped or dropped.
        read_beats, write_beats: of the rendering phase.
        bytes_per_cycle: memory's; None: a beat read and a beat written in every cycle.
        second: the target eye's frame, of frames of two; ops and beats are those of both.
    """
    eyes = [frame, *([second] if second else [])]
    rows = sum(len(eye.headers) for eye in eyes) * TILE * (TILE // frame.config.cores_x)
    memory = max(read_beats, write_beats) if bytes_per_cycle is None else (
        (read_beats + write_beats) * BEAT_BYTES / bytes_per_cycle)
    array = max(sum(map(array_ops, eyes)) // frame.config.blocks, ops)
    entries = sum(len(eye.entries.splat) for eye in eyes)
    return {"sort": entries, "array": array, "pixel_rows": rows, "memory": int(np.ceil(memory))}
