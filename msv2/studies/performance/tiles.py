"""How much a machine would wait whose double buffers hold one tile: what imbalance between tiles costs at most."""

from __future__ import annotations

import numpy as np

from perf.trace import EyeTrace
from spec.constants import TILE

BOTH_LEVELS = 3
"""Of an entry that both levels of a blending tile use."""


def tile_granular(eye: EyeTrace) -> dict[str, int]:
    """Cycles of the rendering phase by sorting and array alone, in tiles' order, an entry or an op a cycle, without latencies.

    Returns:
        "waiting": with one tile in each half of a double buffer between the two, so that sorting may be one tile ahead;
        "never_waiting": of the busier of them alone.
    """
    counts = eye.counts.astype(np.int64)
    end = np.cumsum(counts)
    both = np.concatenate(([0], np.cumsum(eye.use == BOTH_LEVELS)))
    ops = counts + both[end] - both[end - counts] + 1 + eye.blend
    sort, array = counts[eye.rendered], np.maximum(ops, TILE)[eye.rendered]  # a row of pixels leaves in a cycle
    sorted_at = before = done = 0
    for s, a in zip(sort.tolist(), array.tolist(), strict=True):
        sorted_at = max(sorted_at, before) + s  # `before`: the tile before the last has left its half
        before, done = done, max(done, sorted_at) + a
    return {"waiting": done, "never_waiting": int(max(sort.sum(), array.sum()))}
