"""Chooses the view on which an iteration trains, and keeps objects made from views between iterations."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


def generator(seed: int, purpose: str, counter: int) -> np.random.Generator:
    """A random generator that depends on these arguments only, so its numbers are the same however often a run was
    interrupted."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode()), counter])


def view_at(views: Sequence[int], seed: int, purpose: str, iteration: int) -> int:
    """The view of an iteration. Each epoch goes through all of `views` in its own order."""
    epoch, place = divmod(iteration, len(views))
    return views[int(generator(seed, purpose, epoch).permutation(len(views))[place])]


class PerView(Generic[T]):
    """Objects that are made from a view once and used often: the first `limit` are kept, others are made again at each use.

    With views in random order, no replacement policy would hit more often.

    Args:
        make: makes the object from a view's index.
        limit: number of objects kept.
    """

    def __init__(self, make: Callable[[int], T], limit: int) -> None:
        self._make, self._limit = make, limit
        self._kept: dict[int, T] = {}

    def __call__(self, view: int) -> T:
        if view in self._kept:
            return self._kept[view]
        made = self._make(view)
        if len(self._kept) < self._limit:
            self._kept[view] = made
        return made


def views_within(pixels: int, bytes_per_pixel: int, budget: int) -> int:
    """The number of views whose objects fit into `budget` bytes, at least 1."""
    return max(1, budget // max(1, pixels * bytes_per_pixel))
