"""The energy of a frame on any machine, by the cycle model's counts."""

from __future__ import annotations

from msv2.studies.energy.frame import EnergyReport, frame_energy, model_counts
from msv2.studies.energy.supertiles import super_counts, super_table
from msv2.studies.energy.table import Table
from perf.frames import Trace
from perf.model import FrameCycles
from perf.supertiles import SuperCycles
from perf.supertiles_trace import SuperTrace
from spec.config import AcceleratorConfig


def modelled_energy(
    trace: Trace, cycles: FrameCycles, config: AcceleratorConfig, table: Table, *, clock_hz: float = 1e9,
) -> EnergyReport:
    """The energy of a frame at 16 nm, and that of its memory.

    Args:
        trace, cycles: the frame's trace, and what `perf.frames.simulate` found with it.
        config: the machine.
        table: the energies of operations, of PAPER.
        clock_hz: the clock.

    Raises:
        ValueError: see `frame_energy`.
    """
    if isinstance(trace, SuperTrace) and isinstance(cycles, SuperCycles):
        counts, table = super_counts(trace, cycles, config), super_table(table, config)
    else:
        counts = model_counts(trace, cycles)
    return frame_energy(counts, cycles.total, config, table, clock_hz=clock_hz)
