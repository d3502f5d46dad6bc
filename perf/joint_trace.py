"""The trace of a joint frame of two eyes (`spec.joint`) for `perf.supertiles`.

The machine that is modelled reads a Gaussian once, and takes it through the near test and projection for one eye after the
other. The tile test takes both eyes' projections together: SUPER_Y rows of both boxes, from the first row of either on, for the
source and then for the target, and the pairs of both leave with the later of the two steps. There is no RTL of it yet, so this
model, unlike that of frames of one eye, is compared with none.

How the classes of Gaussians say so: where a Gaussian touches both frames, the first of its two classes is OUTSIDE, and the
second is VISIBLE, with the steps of both eyes. Where it touches one frame, the class for this eye is VISIBLE.
"""

from __future__ import annotations

import numpy as np

from golden.kernels import work_clock
from golden.msv2_ref import projection
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.ranges import range_of
from perf import geometry
from perf.stops import stop_entries
from perf.supertiles_gather import EMPTY, MISSES, SURVIVES
from perf.supertiles_trace import SuperTrace, chunk_turns, step_arrays, touched_intersections
from spec.chunks import PLACE_BITS
from spec.constants import MAX_LEVELS, SUPER_X, SUPER_Y
from spec.joint import EYES, grid_origins
from spec.queues import LEVEL_GROUP


def joint_trace(frame: JointFrame, record: dict[str, object] | None = None, seconds: float = 0.0) -> SuperTrace:
    """The trace of a joint frame; `seconds` is the CPU time that rendering it took, to which this function adds its own."""
    begin, pairs, source = work_clock(), frame.pairs, frame.source
    chunks, eyes = source.words.chunks, frame.eyes
    count = chunks["count"].astype(np.uint8)
    read = count > 0
    read[read] = source.projected.reason[chunks["first"][read]] != projection.UNREAD
    turn = chunk_turns(count)
    order, arrival = np.argsort(turn), np.lexsort((pairs.supertile, turn[pairs.splat]))
    places = (pairs.levels[:, :, None] >> np.arange(MAX_LEVELS) & 1).sum(axis=2).astype(np.uint8)
    return SuperTrace(
        source.registers.width, source.registers.height, len(source.words.geometry), source.words.sh_degree,
        _classes(frame, order), count, read, *_steps(frame, order), arrival.astype(np.int32), pairs.start,
        pairs.depth_key.astype(np.int64), pairs.splat.astype(np.int32), (pairs.index >> PLACE_BITS).astype(np.int32),
        places.sum(axis=1, dtype=np.uint8), np.concatenate([np.diff(eye.entries.start) for eye in eyes]).astype(np.int32),
        np.concatenate([eye.registers.header[:, 1] != 0 for eye in eyes]), np.concatenate(pairs.intersection).astype(np.int32),
        np.concatenate([eye.entries.use for eye in eyes]),
        np.concatenate([np.ones(len(eye.entries.use), np.uint8) if eye.regions is None else eye.regions for eye in eyes]),
        np.stack([np.concatenate([stop_entries(eye, stream) for eye in eyes]) for stream in range(frame.config.streams)]),
        np.empty(0, np.uint8), len(np.unique(pairs.splat)), sum(int(eye.entries.filtered) for eye in eyes), dict(record or {}),
        seconds + work_clock() - begin, eyes=EYES, shift=frame.registers.shift, places_by_eye=places, kinds=_kinds(frame))


def _visible(frame: JointFrame) -> np.ndarray:
    """(N, EYES) bool: whether a Gaussian touches the frame of each eye."""
    return np.stack([eye.projected.reason == projection.VISIBLE for eye in frame.eyes], 1)


def _classes(frame: JointFrame, order: np.ndarray) -> np.ndarray:
    """`point_class`: the Gaussians that are read, in order, for source and target in turn, and the frame's end."""
    visible, source = _visible(frame), frame.source.projected.reason
    classes = np.where(visible, geometry.VISIBLE, geometry.OUTSIDE).astype(np.uint8)
    classes[visible.all(axis=1), 0] = geometry.OUTSIDE
    classes[(source == projection.NEAR) | (source == projection.FAINT)] = geometry.NEAR_CULLED
    classes[frame.target.projected.reason == projection.NEAR, 1] = geometry.NEAR_CULLED
    read = order[source[order] != projection.UNREAD]
    return np.append(classes[read].reshape(-1), [geometry.OUTSIDE, geometry.VISIBLE]).astype(np.uint8)


def _steps(frame: JointFrame, order: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`splat_steps`, `step_groups`, `step_pairs` and `step_closes`, followed by the end of the frame; the steps of a splat are
    those of its rows from the first on, of each eye that it touches in turn."""
    pairs, tiles_x, visible = frame.pairs, frame.source.registers.tiles_x, _visible(frame)
    box = np.stack([eye.projected.box[:, 2:].astype(np.int64) for eye in frame.eyes], 1)
    first = np.where(visible, box[..., 0], 1 << 20).min(axis=1)
    last = np.where(visible, box[..., 1], -1).max(axis=1)
    rank, each = np.cumsum(visible, axis=1) - 1, visible.sum(axis=1)
    splats = order[each[order] > 0]
    steps = ((last[splats] - first[splats]) // SUPER_Y + 1) * each[splats]
    begin, total = np.full(len(order), -1, np.int64), int(steps.sum())
    begin[splats] = np.cumsum(steps) - steps
    row = np.minimum(pairs.supertile // frame.grids[0].columns * SUPER_Y + SUPER_Y - 1, last[pairs.splat])
    at = begin[pairs.splat] + ((row - first[pairs.splat]) // SUPER_Y + 1) * each[pairs.splat] - 1
    step_pairs = np.bincount(at, minlength=total).astype(np.uint8)
    low, high = np.full(total, tiles_x), np.full(total, -1)
    for eye, drawn in enumerate(frame.eyes):
        touched = touched_intersections(drawn)
        row, column = np.divmod(range_of(touched.start), tiles_x)
        splat = touched.splat
        step = begin[splat] + (row - first[splat]) // SUPER_Y * each[splat] + rank[splat, eye]
        np.minimum.at(low, step, column // LEVEL_GROUP)
        np.maximum.at(high, step, column // LEVEL_GROUP)
    return step_arrays(steps, high - low + 1, step_pairs)


def _kinds(frame: JointFrame) -> np.ndarray:
    """(pairs, EYES) uint8: the kinds of `perf.supertiles_gather`."""
    pairs, columns, visible = frame.pairs, frame.grids[0].columns, _visible(frame)
    row, column = np.divmod(pairs.supertile, columns)
    kinds = np.full(pairs.mask.shape, MISSES, np.uint8)
    for eye, (drawn, origin) in enumerate(zip(frame.eyes, grid_origins(frame.registers.shift), strict=True)):
        box, left, top = drawn.projected.box[pairs.splat].astype(np.int64), SUPER_X * column - origin, SUPER_Y * row
        meets = (box[:, 0] < left + SUPER_X) & (box[:, 1] >= left) & (box[:, 2] < top + SUPER_Y) & (box[:, 3] >= top)
        kinds[visible[pairs.splat, eye] & meets, eye] = EMPTY
    kinds[pairs.mask != 0] = SURVIVES
    return kinds
