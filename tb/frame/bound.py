"""A lower bound on a frame's cycles: the work of every rendering stage at one item per cycle."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BYTES
from spec.supertiles import frame_rows

RENDER_READS, RENDER_WRITES = ("entries", "spill", "views"), ("spill", "frame")
"""Clients of the memory that work in the rendering phase of machines with lists by tile."""

GATHER_READS = ("entries", "spill", "colour")
"""The same in machines with lists by super-tile, without the few beats of `tiles` and `chunks`, of which both phases read."""


def render_reads(config: AcceleratorConfig) -> tuple[str, ...]:
    """Read clients whose beats belong to the rendering phase."""
    return GATHER_READS if config.supertiles else RENDER_READS


def stream_ops(frame: Frame) -> list[int]:
    """Upper bounds on the operations of each array: one for each level that uses an intersection, and one per level for the
    background of a rendered tile; with super-tiles, a load for each visit, and a store for all but a tile's last. Each of them
    counts for every block of a tile, or of its region."""
    background = int((1 + frame.headers["blend"].astype(int)).sum())
    if not frame.config.supertiles:
        use = frame.entries.use
        return [frame.config.blocks * (len(use) + int((use == 3).sum()) + background)]
    batches, ops = FrameBatches(frame), []
    for stream in range(frame.config.streams):
        visits = batches.stream_visits(stream)
        use, final = frame.entries.use[visits.order], visits.final
        ops.append(frame.config.blocks * (
            len(use) + int((use == 3).sum()) + background + 2 * len(final) - int(final.sum())))
    return ops


def joint_ops(frame: JointFrame) -> int:
    """Upper bound on the operations of all arrays in a joint frame, of both eyes."""
    return sum(joint_stream_ops(frame))


def joint_stream_ops(frame: JointFrame) -> list[int]:
    """The same of each array."""
    ops, batches = [], JointBatches(frame)
    background = sum(int((1 + eye.headers["blend"].astype(int)).sum()) for eye in frame.eyes)
    for stream in range(frame.config.streams):
        visits = batches.stream_visits(stream)
        owner = np.repeat(visits.eye, np.diff(visits.start))
        use = np.concatenate([eye.entries.use[visits.order[owner == n]] for n, eye in enumerate(frame.eyes)])
        ops.append(frame.config.blocks * (
            len(use) + int((use == 3).sum()) + background + 2 * len(visits.final) - int(visits.final.sum())))
    return ops


def array_ops(frame: Frame) -> int:
    """Upper bound on the operations of all arrays."""
    return sum(stream_ops(frame))


def least_cycles(frame: Frame) -> int:
    """A number of cycles below those of any frame like this one: what the array takes or, with super-tiles, projection, which
    tiles that stop early do not spare."""
    if frame.pairs is None:
        return array_ops(frame)
    return frame.config.point_interval * (int(frame.read.sum()) + len(frame.pairs.splat))


def bound_cycles(
    frame: Frame, ops: int, read_beats: int, write_beats: int, bytes_per_cycle: float | None, *, second: Frame | None = None,
) -> dict[str, int]:
    """Least cycles of the rendering phase, by the stage or resource that limits them.

    An array takes one intersection per cycle and level, even if it then skips it, and issues one operation per cycle.

    Args:
        frame: the golden frame.
        ops: the operations that the arrays issued; fewer than `array_ops` where intersections were skipped or dropped.
        read_beats, write_beats: beats of the rendering phase.
        bytes_per_cycle: the memory's bandwidth; None for one beat read and one beat written in every cycle.
        second: the target eye's frame, for frames of two eyes; `ops` and beats are then those of both eyes.
    """
    eyes = [frame, *([second] if second else [])]
    most = max(sum(ops) for ops in zip(*map(stream_ops, eyes), strict=True))
    entries = sum(len((eye.entries if eye.pairs is None else eye.pairs).splat) for eye in eyes)
    return _bounds(frame.config, entries, sum(len(eye.headers) for eye in eyes), most, ops, read_beats + write_beats,
                   max(read_beats, write_beats), bytes_per_cycle)


def joint_bound_cycles(
    frame: JointFrame, ops: int, read_beats: int, write_beats: int, bytes_per_cycle: float | None,
) -> dict[str, int]:
    """The same of a joint frame; all numbers are those of both eyes."""
    return _bounds(frame.config, len(frame.pairs.splat), sum(len(eye.headers) for eye in frame.eyes),
                   max(joint_stream_ops(frame)), ops, read_beats + write_beats, max(read_beats, write_beats), bytes_per_cycle)


def _bounds(
    config: AcceleratorConfig, sorted_: int, tiles: int, most_ops: int, ops: int, beats: int, most_beats: int,
    bytes_per_cycle: float | None,
) -> dict[str, int]:
    """The bounds, from what is sorted, tiles, the largest possible ops of an array, those of all arrays, and beats."""
    rows = tiles * TILE * (TILE // frame_rows(config).cores_x)
    memory = most_beats if bytes_per_cycle is None else beats * BEAT_BYTES / bytes_per_cycle
    array = max(most_ops // config.blocks, -(-ops // config.streams))
    return {"sort": sorted_, "array": array, "pixel_rows": rows, "memory": int(np.ceil(memory))}
