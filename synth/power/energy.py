"""Multiplies toggles by the library's energies; sums them by part of a netlist and by kind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from synth.power.electrical import Electrical
from synth.power.netlist import Flat
from synth.power.simulate import Counts

VOLTAGE = 0.70
"""Supply voltage of the liberty files in V."""


@dataclass(frozen=True)
class Energies:
    """Energies of a part over a simulation in fJ.

    Attributes:
        internal: in logic cells when their outputs toggle: short circuits and inner nodes.
        switching: in nets that toggle, half C V^2 each.
        registers: in flip-flops and clock gates, for toggles of their inputs and outputs.
        clock: in clock pins without clock gate, in every cycle: nets, cells, and the clock pins of clock gates.
        gated: behind clock gates, in the cycles in which they are open.
        leakage: leakage power in pW, not multiplied by time.
    """

    internal: float = 0.0
    switching: float = 0.0
    registers: float = 0.0
    clock: float = 0.0
    gated: float = 0.0
    leakage: float = 0.0

    @property
    def dynamic(self) -> float:
        """All energy that depends on the work, without what the clock costs in every cycle."""
        return self.internal + self.switching + self.registers + self.gated

    def __iter__(self) -> Iterator[tuple[str, float]]:
        return iter(vars(self).items())


def by_part(flat: Flat, electrical: Electrical, counts: Counts) -> dict[str, Energies]:
    """Energies of each module's own cells. Nets that are driven by inputs of the whole netlist are not counted anywhere."""
    e, toggles, square = electrical, counts.toggles, VOLTAGE ** 2
    parts = len(flat.parts)

    def sums(part: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.bincount(part, values, parts)

    gates, flops = toggles[flat.gate_output], toggles[flat.flop_output]
    net = 0.5 * e.net_load * square
    passive = e.net_passive  # toggles at inputs of registers; counted in the driver's part, like the load of the net
    open_ = np.where(flat.flop_clock < 0, 0, counts.gated[flat.flop_clock] if len(counts.gated) else 0)
    free = np.where(flat.flop_clock < 0, counts.cycles, 0)
    cycle = e.flop_clock + e.flop_clock_load * square
    rows = zip(
        sums(flat.gate_part, gates * e.gate_energy),
        sums(flat.gate_part, gates * net[flat.gate_output]) + sums(flat.flop_part, flops * net[flat.flop_output]),
        sums(flat.gate_part, gates * passive[flat.gate_output])
        + sums(flat.flop_part, flops * (e.flop_energy + passive[flat.flop_output])),
        sums(flat.flop_part, free * cycle)
        + sums(flat.icg_part, counts.cycles * (e.icg_clock + e.icg_clock_load * square)),
        sums(flat.flop_part, open_ * cycle) + sums(flat.icg_part, 2 * counts.gated * e.icg_energy),
        sums(flat.gate_part, e.gate_leakage) + sums(flat.flop_part, e.flop_leakage) + sums(flat.icg_part, e.icg_leakage),
        strict=True)
    return {name: Energies(*map(float, values)) for name, values in zip(flat.parts, rows, strict=True)}


def total(parts: dict[str, Energies]) -> Energies:
    """The sum of the energies of all parts."""
    return Energies(*(sum(values) for values in zip(*([value for _, value in part] for part in parts.values()), strict=True)))
