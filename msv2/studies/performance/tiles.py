"""An upper bound on the cost of imbalance between tiles: how long a machine waits if each half of a double buffer holds one
tile."""

from __future__ import annotations

import numpy as np

from perf.trace import EyeTrace
from spec.constants import TILE

BOTH_LEVELS = 3
"""The value of `use` for an intersection that both levels of a blending tile use."""


def tile_granular(eye: EyeTrace) -> dict[str, int]:
    """Cycles of the rendering phase from sorting and array alone, in the order of tiles, without latencies. Each stage handles
    one intersection or operation per cycle.

    Returns:
        "waiting": with one tile in each half of the double buffer between the two stages, so that sorting may be one tile
        ahead; "never_waiting": the cycles of the busier of the two stages alone.
    """
    counts = eye.counts.astype(np.int64)
    end = np.cumsum(counts)
    both = np.concatenate(([0], np.cumsum(eye.use == BOTH_LEVELS)))
    ops = counts + both[end] - both[end - counts] + 1 + eye.blend
    sort, array = counts[eye.rendered], np.maximum(ops, TILE)[eye.rendered]  # a row of pixels takes a cycle to leave
    sorted_at = before = done = 0
    for s, a in zip(sort.tolist(), array.tolist(), strict=True):
        sorted_at = max(sorted_at, before) + s  # `before` is when the second last tile has left its half
        before, done = done, max(done, sorted_at) + a
    return {"waiting": done, "never_waiting": int(max(sort.sum(), array.sum()))}
