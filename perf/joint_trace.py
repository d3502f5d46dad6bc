"""The trace of a joint frame of two eyes (`spec.joint`) for `perf.supertiles`.

The machine projects and tests every Gaussian for one eye after the other (rtl.culling.eyes): a Gaussian has a class for each
eye, and a splat for each eye whose frame it touches, with steps of its own. What is culled in an eye passes projection all the
same, so its class is OUTSIDE, also before the near plane. The pairs of both eyes leave the tile test, and those of the target
that the source has, too, are dropped behind it.
"""

from __future__ import annotations

import numpy as np

from golden.kernels import work_clock
from golden.msv2_ref import projection
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.ranges import range_of
from perf import geometry
from perf.stops import stop_entries
from perf.supertiles_trace import SuperTrace, block_sizes, chunk_turns, step_arrays, touched_intersections
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
    order, arrival = np.argsort(turn), np.lexsort((pairs.supertile, pairs.mask[:, 0] == 0, turn[pairs.splat]))
    *steps, drops = _steps(frame, turn)
    places = (pairs.levels[:, :, None] >> np.arange(MAX_LEVELS) & 1).sum(axis=2).astype(np.uint8)
    return SuperTrace(
        source.registers.width, source.registers.height, len(source.words.geometry), source.words.sh_degree,
        _classes(frame, order), count, read, *steps, arrival.astype(np.int32), pairs.start,
        pairs.depth_key.astype(np.int64), pairs.splat.astype(np.int32), (pairs.index >> PLACE_BITS).astype(np.int32),
        places.sum(axis=1, dtype=np.uint8), np.concatenate([np.diff(eye.entries.start) for eye in eyes]).astype(np.int32),
        np.concatenate([eye.registers.header[:, 1] != 0 for eye in eyes]), np.concatenate(pairs.intersection).astype(np.int32),
        np.concatenate([eye.entries.use for eye in eyes]),
        np.concatenate([np.ones(len(eye.entries.use), np.uint8) if eye.regions is None else eye.regions for eye in eyes]),
        np.stack([np.concatenate([stop_entries(eye, stream) for eye in eyes]) for stream in range(frame.config.streams)]),
        np.concatenate([block_sizes(eye) for eye in eyes]), len(np.unique(pairs.splat)),
        sum(int(eye.entries.filtered) for eye in eyes), dict(record or {}), seconds + work_clock() - begin, eyes=EYES,
        shift=frame.registers.shift, places_by_eye=places, pair_drops=drops)


def _visible(frame: JointFrame) -> np.ndarray:
    """(N, EYES) bool: whether a Gaussian touches the frame of each eye."""
    return np.stack([eye.projected.reason == projection.VISIBLE for eye in frame.eyes], 1)


def _classes(frame: JointFrame, order: np.ndarray) -> np.ndarray:
    """`point_class`: the Gaussians that are read, in order, for source and target in turn, and the frame's end."""
    classes = np.where(_visible(frame), geometry.VISIBLE, geometry.OUTSIDE).astype(np.uint8)
    read = order[frame.source.projected.reason[order] != projection.UNREAD]
    return np.append(classes[read].reshape(-1), geometry.VISIBLE).astype(np.uint8)


def _steps(frame: JointFrame, turn: np.ndarray) -> tuple[np.ndarray, ...]:
    """`splat_steps`, `step_groups`, `step_pairs` and `step_closes`, followed by the end of the frame, and `pair_drops`. Splats
    are those of each Gaussian for each eye that it touches, in turn."""
    pairs, columns, order = frame.pairs, frame.grids[0].columns, np.argsort(turn)
    eye, splats = np.nonzero(_visible(frame)[order].T)  # by eye; then by Gaussian
    splats = order[splats]
    by_turn = np.lexsort((eye, turn[splats]))
    box = np.stack([drawn.projected.box[:, 2:].astype(np.int64) for drawn in frame.eyes])
    first, last = box[eye, splats].T
    steps = ((last - first) // SUPER_Y + 1)[by_turn]
    begin, total = np.full(_visible(frame).T.shape, -1, np.int64), int(steps.sum())
    begin[eye[by_turn], splats[by_turn]] = np.cumsum(steps) - steps
    pair, of = np.nonzero(pairs.mask)
    splat, supertile = pairs.splat[pair], pairs.supertile[pair]
    row = np.minimum(supertile // columns * SUPER_Y + SUPER_Y - 1, box[of, splat, 1])
    at = begin[of, splat] + (row - box[of, splat, 0]) // SUPER_Y
    drops = (of > 0) & (pairs.mask[pair, 0] != 0)
    low, high = np.full(total, columns * SUPER_X), np.full(total, -1)
    for number, (drawn, origin) in enumerate(zip(frame.eyes, grid_origins(frame.registers.shift), strict=True)):
        touched = touched_intersections(drawn)
        y, x = np.divmod(range_of(touched.start), drawn.registers.tiles_x)
        step = begin[number, touched.splat] + (y - box[number, touched.splat, 0]) // SUPER_Y
        np.minimum.at(low, step, (x + origin) // LEVEL_GROUP)
        np.maximum.at(high, step, (x + origin) // LEVEL_GROUP)
    step_pairs = np.bincount(at, minlength=total).astype(np.uint8)
    given = drops[np.lexsort((supertile, at))].astype(np.uint8)
    return *step_arrays(steps, high - low + 1, step_pairs), np.append(given, 0).astype(np.uint8)
