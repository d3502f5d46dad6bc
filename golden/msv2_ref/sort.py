"""Sorting: intersections in the order in which they are blended."""

from __future__ import annotations

import numpy as np


def depth_order(depth_key: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """int32 rows of the visible splats by (depth key, Gaussian index).

    Tile lists filled in this order are sorted by (native tile, depth key, index): the hierarchical sorter's total order.
    """
    rows = np.flatnonzero(visible).astype(np.int32)
    return rows[np.argsort(depth_key[rows], kind="stable")]


def sort_chunks(items: np.ndarray) -> np.ndarray:
    """Each chunk by (native tile, depth key, index); chunks and what is equal stay in order.

    Args:
        items: (N,) ChunkEntry records; chunks end with `last`, and an empty one is a single item with `last` and `empty`.
    """
    chunk = np.cumsum(items["last"]) - items["last"]
    ordered = items[np.lexsort((items["index"], items["depth_key"], items["tile"], chunk))]
    ordered["last"] = items["last"]
    return ordered
