"""The simulator's state: one record of integers, whose fields have names.

Kernels get the record, so that a step of a unit is a function of its own and costs no more than its loads and stores. A field
is a word, or a ring: a stretch of words that is addressed modulo its length, a power of two. Where a field is a time, it is a
cycle; where it comes in pairs `x_in` and `x_out`, these count what has entered and left a queue `x`.
"""

from __future__ import annotations

import numpy as np


class Layout:
    """Fields of a record, all int64, in the order in which they are added.

    Parameters:
        before: layout whose fields this one begins with.
    """

    def __init__(self, before: Layout | None = None) -> None:
        self._fields: dict[str, tuple[int, ...]] = dict(before._fields) if before else {}

    def words(self, names: str) -> None:
        """A word for each of the names."""
        for name in names.split():
            self._add(name, ())

    def ring(self, name: str, *sizes: int) -> None:
        """A ring, or with several sizes one for every client, channel or whatever the first counts."""
        if any(size < 1 or size & (size - 1) for size in sizes):
            raise ValueError(f"sizes of {name} must be powers of two, not {sizes!r}")
        self._add(name, sizes)

    def counters(self, *stages: str) -> None:
        """Words `busy_` and `blocked_` of each stage's input stream, by the prefixes of `spec.stages`' counters."""
        self.words(" ".join(f"busy_{stage} blocked_{stage}" for stage in stages))

    def _add(self, name: str, shape: tuple[int, ...]) -> None:
        if name in self._fields:
            raise ValueError(f"field {name!r} must be new")
        self._fields[name] = shape

    @property
    def dtype(self) -> np.dtype:
        """The record's."""
        return np.dtype([(name, np.int64, shape) if shape else (name, np.int64) for name, shape in self._fields.items()])

    def new(self) -> np.record:
        """A record of zeros."""
        return np.zeros(1, self.dtype).view(np.recarray)[0]
