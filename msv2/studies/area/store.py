"""A memory of a machine: its shape, and the unit that has it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Store:
    """A memory, or several equal ones.

    Attributes:
        unit: the unit that it belongs to, by the names of reports/energy_per_operation.json.
        name: its name in that unit.
        group: the unit's group in the area report (`synth.machine.GROUPS`).
        words, width: rows, and bits of a row.
        count: number of equal memories.
    """

    unit: str
    name: str
    group: str
    words: int
    width: int
    count: int = 1

    @property
    def bits(self) -> int:
        """Bits of all `count` memories."""
        return self.count * self.words * self.width
