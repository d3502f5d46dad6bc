"""Splat fetch: which intersections find their splat record in the cache, and which read it from memory."""

from __future__ import annotations

import numpy as np

from golden.kernels import compiled
from spec.constants import MAX_LEVELS


@compiled
def find_misses(index: np.ndarray, level: np.ndarray, lines: int, ways: int, keep_used: bool, fold: bool) -> np.ndarray:
    """Which of the accesses, in order, miss in a splat cache that is empty at the start.

    Args:
        index, level: (N,) int64, Gaussian and level of the splat record that each access reads.
        lines, ways: number of lines and ways of the cache, powers of two.
        keep_used: replace the least recently used line instead of the one that was loaded first.
        fold: choose the set by the whole index, its parts combined by XOR, instead of its low bits.

    Returns:
        (N,) bool, True for a miss.
    """
    sets = lines // ways
    tags, misses = np.full((sets, ways), -1, np.int64), np.empty(len(index), np.bool_)
    bits = 0
    while 1 << bits < sets:
        bits += 1
    for i in range(len(index)):
        place = index[i]
        if fold and bits:
            place = place ^ place >> bits ^ place >> 2 * bits
        line, key, way = tags[place & sets - 1], index[i] * MAX_LEVELS + level[i], 0
        while way < ways and line[way] != key:
            way += 1
        missed = way == ways
        misses[i] = missed
        if missed or keep_used:  # the newest line moves to the front
            for j in range(min(way, ways - 1), 0, -1):
                line[j] = line[j - 1]
            line[0] = key
    return misses
