"""The simulator's state: one array of integers whose words have names.

Kernels get this array and constant indices. So a step of a unit can be a function of its own that costs no more than its loads
and stores. A ring buffer is a stretch of words whose length is a power of two.
"""

from __future__ import annotations


class Layout:
    """Assigns indices to words, from `first` on."""

    def __init__(self, first: int = 0) -> None:
        self.size = first

    def words(self, names: str) -> tuple[int, ...]:
        """Assigns a word to each of the names; returns their indices."""
        count = len(names.split())
        first, self.size = self.size, self.size + count
        return tuple(range(first, first + count))

    def ring(self, size: int) -> int:
        """Assigns `size` words, a power of two, to a ring buffer; returns the index of the first."""
        if size < 1 or size & (size - 1):
            raise ValueError(f"size must be a power of two, not {size!r}")
        first, self.size = self.size, self.size + size
        return first
