"""Items that lie in ranges behind each other, as intersections lie in tiles and pairs in super-tiles."""

from __future__ import annotations

import numpy as np


def range_of(start: np.ndarray) -> np.ndarray:
    """The range that each item lies in.

    Args:
        start: (n + 1,) int64, the first item of each range, and the number of items.

    Returns:
        (start[-1],) int64 in 0..n-1.
    """
    return np.repeat(np.arange(len(start) - 1), np.diff(start))
