"""How fast a frame could be rendered: what every rendering stage must do, at one item a cycle."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES


def array_ops(frame: Frame) -> int:
    """Ops of the array: an entry is one a level that uses it, the background one a level; each for every block of a tile."""
    blend = frame.registers.header[:, 1]
    return frame.config.blocks * int(len(frame.entries.splat) + (frame.entries.use == 3).sum() + (1 + blend).sum())


def bound_cycles(frame: Frame, read_beats: int, write_beats: int, bytes_per_cycle: float | None) -> dict[str, int]:
    """Least cycles of the rendering phase, by what sets them.

    Args:
        frame: the golden frame.
        read_beats, write_beats: of the rendering phase.
        bytes_per_cycle: memory's; None: a beat read and a beat written in every cycle.
    """
    rows = len(frame.registers.header) * TILE * (TILE // frame.config.cores_x)
    memory = max(read_beats, write_beats) if bytes_per_cycle is None else (
        (read_beats + write_beats) * BEAT_BYTES / bytes_per_cycle)
    return {"sort": len(frame.entries.splat), "array": array_ops(frame), "pixel_rows": rows, "memory": int(np.ceil(memory))}
