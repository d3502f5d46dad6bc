"""The runs of tiles into which the tile test cuts the boxes of splats (rtl/culling/tile_runs.py)."""

from __future__ import annotations

import numpy as np

from perf.geometry import CLOSES, ENDS, NOT_LAST
from perf.kernel import kernel
from spec.queues import LEVEL_GROUP


def tile_runs(
    box: np.ndarray, index: np.ndarray, entry_splat: np.ndarray, entry_tile: np.ndarray, kind: np.ndarray, tiles_x: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The runs of the projected splats, followed by the end of the frame.

    Args:
        box: (splats, 4) int64 first and last tile column, first and last tile row.
        index: (splats,) int32 the indices of the splats' Gaussians, ascending.
        entry_splat, entry_tile: (intersections,) int32 by splat, then by tile.
        kind: (tiles,) int64: all tiles of a run have the same kind.
        tiles_x: the number of tiles in a row.

    Returns:
        splat_steps, step_runs, run_entries, run_closes: see `perf.trace.EyeTrace`.
    """
    first, last = box[:, 0] // LEVEL_GROUP, box[:, 1] // LEVEL_GROUP
    steps = (last - first + 1) * (box[:, 3] - box[:, 2] + 1)
    tiles = (box[:, 1] - box[:, 0] + 1) * (box[:, 3] - box[:, 2] + 1)
    step_runs = np.empty(int(steps.sum()) + 1, np.uint8)
    run_entries, run_closes = np.empty(int(tiles.sum()) + 1, np.uint8), np.empty(int(tiles.sum()) + 1, np.uint8)
    runs = _cut(box, index, entry_splat, entry_tile, kind, tiles_x, step_runs, run_entries, run_closes)
    return np.append(steps, 1).astype(np.int32), step_runs, run_entries[:runs].copy(), run_closes[:runs].copy()


@kernel
def _cut(box, index, entry_splat, entry_tile, kind, tiles_x, step_runs, run_entries, run_closes):
    step, run, at = 0, 0, 0
    for i in range(len(box)):
        for row in range(box[i, 2], box[i, 3] + 1):
            for group in range(box[i, 0] // LEVEL_GROUP, box[i, 1] // LEVEL_GROUP + 1):
                begin, stop = max(box[i, 0], group * LEVEL_GROUP), min(box[i, 1], group * LEVEL_GROUP + LEVEL_GROUP - 1)
                count, column = 0, begin
                while column <= stop:
                    end = column
                    while end < stop and kind[row * tiles_x + end + 1] == kind[row * tiles_x + column]:
                        end += 1
                    entries = 0
                    while at < len(entry_splat) and entry_splat[at] == index[i] and entry_tile[at] <= row * tiles_x + end:
                        entries += 1
                        at += 1
                    run_entries[run], run_closes[run] = entries, NOT_LAST
                    run += 1
                    count += 1
                    column = end + 1
                step_runs[step] = count
                step += 1
        run_closes[run - 1] = CLOSES
    step_runs[step], run_entries[run], run_closes[run] = 1, 0, ENDS
    return run + 1
