"""Sorting: brings intersections into the order in which they are blended."""

from __future__ import annotations

import numpy as np


def depth_order(depth_key: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """int32 rows of the visible splats, sorted by (depth key, Gaussian index).

    Tile lists that are filled in this order are sorted by (native tile, depth key, index), which is the total order of the
    hierarchical sorter.
    """
    rows = np.flatnonzero(visible).astype(np.int32)
    return rows[np.argsort(depth_key[rows], kind="stable")]


def sort_chunks(items: np.ndarray) -> np.ndarray:
    """Sorts each chunk by (native tile, depth key, index); the chunks keep their order, and so do equal items.

    Args:
        items: (N,) ChunkItem records. A chunk ends with `last`; an empty chunk is one item with `last` and `empty`.
    """
    chunk = np.cumsum(items["last"]) - items["last"]
    ordered = items[np.lexsort((items["index"], items["depth_key"], items["tile"], chunk))]
    ordered["last"] = items["last"]
    return ordered
