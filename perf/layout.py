"""The simulator's state: one array of integers, whose words have names.

Kernels get the array and constants, so that a step of a unit is a function of its own and costs no more than its loads and
stores. Rings are stretches of words, a power of two long.
"""

from __future__ import annotations


class Layout:
    """Numbers words from `first` on."""

    def __init__(self, first: int = 0) -> None:
        self.size = first

    def words(self, names: str) -> tuple[int, ...]:
        """A word for each of the names."""
        count = len(names.split())
        first, self.size = self.size, self.size + count
        return tuple(range(first, first + count))

    def ring(self, size: int) -> int:
        """The first of `size` words, a power of two."""
        if size < 1 or size & (size - 1):
            raise ValueError(f"size must be a power of two, not {size!r}")
        first, self.size = self.size, self.size + size
        return first
