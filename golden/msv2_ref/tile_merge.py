"""Tile merging: forms groups of tiles from the tiles' counts of intersections (paper section 6.2, "Tile Merging")."""

from __future__ import annotations

import numpy as np

from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, tile_group


def auto_beta(counts: np.ndarray, config: AcceleratorConfig) -> int:
    """The automatic merge threshold: twice the mean count of the frame's non-empty tiles, at most half of the double buffer."""
    filled = counts[counts > 0]
    mean = float(filled.mean()) if len(filled) else 0.0
    return max(1, min(round(2 * mean), config.sort_chunk))


def merge_tiles(counts: np.ndarray, tiles_x: int, beta: int) -> np.ndarray:
    """Group id of every tile, (tiles,) int64, consecutive from 0.

    A non-empty tile closes a non-empty open group when total + count >= beta. After a tile is added, a group with total >= beta
    closes at once. An empty tile joins the open group, or opens one. A group ends with its tile row. A `beta` of 0 means 1.

    Args:
        counts: (tiles,) number of intersections of each tile, row-major.
        tiles_x: number of tiles in a row.
        beta: merge threshold in intersections.

    Raises:
        ValueError: beta is negative.
    """
    if beta < 0:
        raise ValueError(f"beta must be 0 or more, not {beta!r}")
    beta = max(beta, 1)
    groups = np.empty(len(counts), np.int64)
    group, total, open_ = 0, 0, False
    for tile, count in enumerate(counts.tolist()):
        if open_ and (tile % tiles_x == 0 or (count and total and total + count >= beta)):
            group, total, open_ = group + 1, 0, False
        groups[tile], total, open_ = group, total + count, True
        if total >= beta:
            group, total, open_ = group + 1, 0, False
    return groups


def count_tiles(hits: np.ndarray, tiles: int, count_bits: int = COUNT_BITS) -> tuple[np.ndarray, bool, bool]:
    """Number of intersections of each tile as the unit's counters hold them.

    Args:
        hits: (intersections,) tile of each intersection, in any order; those outside 0..tiles - 1 are not counted.
        tiles: number of tiles in the frame.
        count_bits: number of bits of a counter; a counter stays at its largest value.

    Returns:
        (tiles,) int64 counts, whether a counter overflowed, and whether an intersection lies outside the frame.
    """
    inside = (hits >= 0) & (hits < tiles)
    counts, full = np.bincount(hits[inside], minlength=tiles), (1 << count_bits) - 1
    return np.minimum(counts, full), bool((counts > full).any()), not inside.all()


def tile_groups(config: AcceleratorConfig, counts: np.ndarray, tiles_x: int, beta: int | None) -> np.ndarray:
    """(tiles,) TileGroup records as the merge unit emits them; if `beta` is None, `auto_beta` chooses it."""
    rows = np.zeros(len(counts), tile_group(config).dtype)
    groups = merge_tiles(counts, tiles_x, auto_beta(counts, config) if beta is None else beta)
    rows["tile"], rows["count"], rows["group"] = np.arange(len(counts)), counts, groups
    rows["last"] = np.append(np.diff(groups) > 0, True)
    return rows
