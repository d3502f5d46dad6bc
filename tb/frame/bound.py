"""A lower bound on a frame's cycles: the work of every rendering stage at one item per cycle."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES

RENDER_READS, RENDER_WRITES = ("entries", "spill", "views"), ("spill", "frame")
"""Clients of the memory that work in the rendering phase."""


def array_ops(frame: Frame) -> int:
    """Upper bound on the operations of the array: one for each level that uses an intersection, and one per level for the
    background of a rendered tile; each of them for every block of a tile."""
    blend = frame.headers["blend"].astype(int)
    return frame.config.blocks * int(len(frame.entries.splat) + (frame.entries.use == 3).sum() + (1 + blend).sum())


def bound_cycles(
    frame: Frame, ops: int, read_beats: int, write_beats: int, bytes_per_cycle: float | None, *, second: Frame | None = None,
) -> dict[str, int]:
    """Least cycles of the rendering phase, by the stage or resource that limits them.

    The array takes one intersection per cycle and level, even if it then skips it, and issues one operation per cycle.

    Args:
        frame: the golden frame.
        ops: the operations that the array issued; fewer than `array_ops` where intersections were skipped or dropped.
        read_beats, write_beats: beats of the rendering phase.
        bytes_per_cycle: the memory's bandwidth; None for one beat read and one beat written in every cycle.
        second: the target eye's frame, for frames of two eyes; `ops` and beats are then those of both eyes.
    """
    eyes = [frame, *([second] if second else [])]
    rows = sum(len(eye.headers) for eye in eyes) * TILE * (TILE // frame.config.cores_x)
    memory = max(read_beats, write_beats) if bytes_per_cycle is None else (
        (read_beats + write_beats) * BEAT_BYTES / bytes_per_cycle)
    array = max(sum(map(array_ops, eyes)) // frame.config.blocks, ops)
    entries = sum(len(eye.entries.splat) for eye in eyes)
    return {"sort": entries, "array": array, "pixel_rows": rows, "memory": int(np.ceil(memory))}
