"""A frame on the machine with lists by super-tile, as the other machines of this report run it."""

from __future__ import annotations

from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.memory import memory_arguments
from msv2.studies.performance.frames import Compared
from msv2.studies.performance.machines import CLOCK_HZ, PEAK, Run, energies
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from spec.config import V3

SUPER, SUPER_BASE = V3.name, f"{V3.name}, double buffers"
"""The machine as it is, and without merging and line buffers (`msv2 perf --pipeline 0 --merge 0`), both for one eye."""


def run_super(frame: Compared, memory: str, *, whole: bool = True) -> Run:
    """A frame of one eye on the machine with lists by super-tile.

    The bounds of its lists are those that the same frame leaves: the camera stands still. `whole` is whether lists are merged
    and stages hand over as work becomes final; otherwise neither is the case. A lower bound on its cycles is not known.
    """
    config, trace = V3.with_(incremental=whole), frame.gathered
    cycles = simulate_supertiles(trace, config, memory=MemoryModel(**memory_arguments(memory)), merge=whole, display=True)
    energy = modelled_energy(trace, cycles, config, energies(), clock_hz=CLOCK_HZ)
    render = cycles.phases["render"]
    return Run(
        SUPER if whole else SUPER_BASE, memory, PEAK[memory], 1, cycles.total, cycles.phases["geometry"], render,
        CLOCK_HZ / cycles.total, CLOCK_HZ, sum(cycles.reads.values()) + sum(cycles.writes.values()), chip_mj=energy.chip_mj,
        dram_mj=energy.sum_mj("dram"), array=max(cycles.entries, cycles.ops) / max(1, render))
