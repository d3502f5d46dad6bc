"""Depth buckets: which list of a super-tile a pair goes to, and the bounds that a frame leaves for the next one
(`spec.supertiles`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spec.config import AcceleratorConfig
from spec.records import frame_lists
from spec.supertiles import BUCKET_PAIRS, BUCKETS


class Bounds(NamedTuple):
    """The bounds of all super-tiles of a frame.

    Attributes:
        supertiles: number of super-tiles.
        supertile: (B,) int64, super-tile of each bound, not decreasing.
        key: (B,) int64, depth keys, not decreasing within a super-tile.
    """

    supertiles: int
    supertile: np.ndarray
    key: np.ndarray

    @property
    def lists(self) -> int:
        """Number of the frame's lists."""
        return self.supertiles + len(self.key)

    @property
    def first(self) -> np.ndarray:
        """(super-tiles + 1,) int64: the first list of each super-tile, and the number of lists."""
        return np.arange(self.supertiles + 1) + np.searchsorted(self.supertile, np.arange(self.supertiles + 1))


def no_bounds(supertiles: int) -> Bounds:
    """One list for each super-tile."""
    return Bounds(supertiles, np.zeros(0, np.int64), np.zeros(0, np.int64))


def check_bounds(config: AcceleratorConfig, bounds: Bounds, supertiles: int) -> None:
    """Raises ValueError where the machine could not have these bounds for a frame of so many super-tiles."""
    if bounds.supertiles != supertiles:
        raise ValueError(f"bounds must be those of {supertiles} super-tiles, not of {bounds.supertiles!r}")
    most = frame_lists(config)
    if bounds.lists > most:
        raise ValueError(f"bounds must leave at most {most} lists, not {bounds.lists!r}")
    if len(bounds.key) and not config.buckets:
        raise ValueError(f"bounds must be none in a machine without buckets, not {len(bounds.key)!r}")
    counts = np.bincount(bounds.supertile, minlength=bounds.supertiles)
    if len(counts) > bounds.supertiles or counts.max(initial=0) > BUCKETS - 1:
        raise ValueError(f"bounds must be at most {BUCKETS - 1} for each of {bounds.supertiles} super-tiles, not "
                         f"{counts.tolist()!r}")
    later, higher = np.diff(bounds.supertile), np.diff(bounds.key)
    if not ((later > 0) | (later == 0) & (higher >= 0)).all():
        raise ValueError("bounds must not decrease, by super-tile and key")


def list_numbers(bounds: Bounds, supertile: np.ndarray, depth_key: np.ndarray) -> np.ndarray:
    """(P,) int64: the lists of pairs.

    Args:
        bounds: the frame's bounds.
        supertile: (P,) super-tiles of the pairs.
        depth_key: (P,) their sort keys.
    """
    bits = max(int(bounds.key.max(initial=0)), int(np.max(depth_key, initial=0))).bit_length()
    below = np.searchsorted(bounds.supertile << bits | bounds.key, np.asarray(supertile, np.int64) << bits | depth_key, "right")
    return supertile + below


def next_bounds(config: AcceleratorConfig, start: np.ndarray, depth_key: np.ndarray, every: int = BUCKET_PAIRS) -> Bounds:
    """The bounds that a frame leaves for the next one with as many super-tiles.

    Args:
        config: the machine.
        start: (super-tiles + 1,) first pair of each super-tile.
        depth_key: (P,) sort keys of the pairs in rendering order.
        every: pairs between two bounds; small frames have bounds with a smaller number only.
    """
    supertiles = len(start) - 1
    if not config.buckets:
        return no_bounds(supertiles)
    counts = np.diff(start)
    made = np.clip((counts - 1) // every, 0, BUCKETS - 1)
    supertile = np.repeat(np.arange(supertiles), made)
    number = np.arange(len(supertile)) - np.repeat(np.cumsum(made) - made, made) + 1
    most = frame_lists(config) - supertiles
    key = depth_key[start[supertile] + number * every].astype(np.int64)
    return Bounds(supertiles, supertile[:most], key[:most])
