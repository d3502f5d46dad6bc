"""Bounds on the cost of imbalance between tiles: how long a machine waits if each half of a double buffer holds one tile.

They count the cycles of sorting and of the array alone, in the order of tiles, without latencies and memory. The paper's text
has such buffers in its baseline, but neither the sorter's rate nor a rule for the swap of the halves; so there are several.
"""

from __future__ import annotations

import numpy as np

from perf.trace import EyeTrace
from spec.config import PAPER
from spec.constants import TILE

BOTH_LEVELS = 3
"""The value of `use` for an intersection that both levels of a blending tile use."""

READINGS = {
    "waiting": "sorter and array swap their buffers when both have taken their tile, which leaves them meanwhile",
    "rows": f"the same, but a tile's {TILE} rows of pixels leave the array before the swap",
    "drained": "the same, and a tile leaves our sorter before a further swap, one tile behind the one that enters it"}
"""What the swaps wait for, by the keys of `tile_granular`. `paper_base` is the last reading."""

NEVER = "never_waiting"
"""The key of the cycles of the busier one of sorting and array, which never waits."""


def tile_granular(eye: EyeTrace) -> dict[str, int]:
    """Cycles of the rendering phase from sorting and array alone, by READINGS and for NEVER.

    Each stage handles one intersection or operation in a cycle. Where rows of pixels need not leave first, a tile takes the
    array at least the TILE cycles of its rows. Our sorter can only begin to give a tile away after as many cycles as it has
    intersections, unless these are more than half of what it holds (rtl.sort_tmu.chunk_sorter).
    """
    counts = eye.counts.astype(np.int64)
    end = np.cumsum(counts)
    both = np.concatenate(([0], np.cumsum(eye.use == BOTH_LEVELS)))
    ops = (counts + both[end] - both[end - counts] + 1 + eye.blend)[eye.rendered]
    sort, array, rows = counts[eye.rendered], np.maximum(ops, TILE), ops + TILE
    drain = np.where(sort > PAPER.sort_chunk // 2, sort, 2 * sort)
    return {"waiting": _swapped(sort, array), "rows": _swapped(sort, rows), "drained": _swapped(sort, drain, rows),
            NEVER: int(max(sort.sum(), array.sum()))}


def _swapped(*stages: np.ndarray) -> int:
    """Each stage has the tile of the stage before it in the turn before; a turn takes as long as its longest stage.

    With two stages this is also what it takes if no swap waits and the first stage may be one tile ahead of the second.
    """
    turns = np.zeros((len(stages), len(stages[0]) + len(stages) - 1), np.int64)
    for place, cycles in enumerate(stages):
        turns[place, place : place + len(cycles)] = cycles
    return int(turns.max(axis=0).sum())
