"""The simulator's state: one record of integers with named fields.

Kernels get the record. So a step of a unit can be a function of its own that costs no more than its loads and stores. A field
is a word or a ring buffer. A ring buffer is addressed modulo its length, which is a power of two. Times are numbers of cycles.
Of two fields `x_in` and `x_out`, the first counts the items that have entered the queue `x`, and the second those that have
left.
"""

from __future__ import annotations

import numpy as np


class Layout:
    """The fields of a record, all int64, in the order in which they are added.

    Parameters:
        before: a layout with whose fields this one begins.
    """

    def __init__(self, before: Layout | None = None) -> None:
        self._fields: dict[str, tuple[int, ...]] = dict(before._fields) if before else {}

    def words(self, names: str) -> None:
        """Adds a word for each of the names, which are separated by white space."""
        for name in names.split():
            self._add(name, ())

    def ring(self, name: str, *sizes: int) -> None:
        """Adds a ring buffer. With several sizes it adds an array of them, for example one for each client or channel."""
        if any(size < 1 or size & (size - 1) for size in sizes):
            raise ValueError(f"sizes of {name} must be powers of two, not {sizes!r}")
        self._add(name, sizes)

    def counters(self, *stages: str) -> None:
        """Adds words `busy_` and `blocked_` for the input of each stage, named by the prefixes of the counters in
        `spec.stages`."""
        self.words(" ".join(f"busy_{stage} blocked_{stage}" for stage in stages))

    def _add(self, name: str, shape: tuple[int, ...]) -> None:
        if name in self._fields:
            raise ValueError(f"field {name!r} must be new")
        self._fields[name] = shape

    @property
    def dtype(self) -> np.dtype:
        """The record's data type."""
        return np.dtype([(name, np.int64, shape) if shape else (name, np.int64) for name, shape in self._fields.items()])

    def new(self) -> np.record:
        """A record of zeros."""
        return np.zeros(1, self.dtype).view(np.recarray)[0]
