"""What all phases of all machines share: the memory, how it is prepared, and how results are read from a state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from golden.host.run_options import IDEAL, LPDDR3, MEMORIES
from perf import bus, dram, geometry
from perf.layout import Layout
from spec.lpddr3 import Lpddr3, check_clock
from spec.memory import BUS_BYTES_PER_CYCLE, DRAM_BYTES_PER_CYCLE
from spec.queues import READ_DEPTHS

LIMIT = 1 << 31
"""Number of cycles after which a phase is given up."""


@dataclass(frozen=True)
class MemoryModel:
    """The memory that answers the machine's reads and writes.

    Attributes:
        kind: one of `golden.host.run_options.MEMORIES`: "ideal" for a memory that answers in order with a latency and a
            bandwidth; "lpddr3" for four channels of DRAM (`perf.dram`). The RTL's bench has both.
        latency: the latency of "ideal" in cycles.
        bytes_per_cycle: the bandwidth of "ideal", for reads and writes together; None for a beat read and a beat written in
            every cycle.
        device: the timing of "lpddr3".
        clock_ns: the period of the machine's clock in nanoseconds, 0.01..1000, rounded to picoseconds. It matters to "lpddr3"
            alone, whose timing is in nanoseconds.
    """

    kind: str = IDEAL
    latency: int = 100
    bytes_per_cycle: float | None = DRAM_BYTES_PER_CYCLE
    device: Lpddr3 = field(default_factory=Lpddr3)
    clock_ns: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in MEMORIES:
            raise ValueError(f"kind must be one of {', '.join(MEMORIES)}, not {self.kind!r}")
        check_clock(self.clock_ns)
        if not isinstance(self.latency, int) or isinstance(self.latency, bool) or not 1 <= self.latency <= 1 << 20:
            raise ValueError(f"latency must be an integer in 1..{1 << 20}, not {self.latency!r}")
        if self.bytes_per_cycle is not None and not 0.01 <= self.bytes_per_cycle <= BUS_BYTES_PER_CYCLE:
            raise ValueError(f"bytes_per_cycle must be None or in 0.01..{BUS_BYTES_PER_CYCLE}, which the bus moves at most, "
                             f"not {self.bytes_per_cycle!r}")

    @property
    def peak(self) -> float:
        """The most bytes that DRAM moves in a cycle of the machine; for "ideal" those of the paper's memory and clock."""
        return DRAM_BYTES_PER_CYCLE * (self.clock_ns if self.kind == LPDDR3 else 1)


def finished(phase: str, cycles: int) -> int:
    """The cycles of a phase.

    Raises:
        RuntimeError: the phase has not ended within LIMIT cycles.
    """
    if cycles < 0:
        raise RuntimeError(f"{phase} must end within {LIMIT} cycles")
    return int(cycles)


def prepare_memory(s: np.record, memory: MemoryModel, depths: Mapping[str, int] = READ_DEPTHS) -> None:
    """Initialises the bus and the memory in a new state; `depths` as in `bus.prepare`."""
    gain, cost = bus.rate(memory.bytes_per_cycle)
    bus.prepare(s, latency=memory.latency, gain=gain, cost=cost, dram=memory.kind == LPDDR3, depths=depths)
    dram.prepare(s, memory.device, memory.clock_ns)


class LastingMemory:
    """A memory through the phases of a frame, or of frames in a row: each goes on with the open rows, the times of refresh and
    the turns of the clients that the one before left.

    Parameters:
        model: the memory.
        idle_cycles: cycles from the memory's reset until the first phase.

    Attributes:
        age: cycles from the reset to the end of the last phase.
    """

    def __init__(self, model: MemoryModel, idle_cycles: int = 0) -> None:
        self.model, self._before, self._cycles, self.age = model, None, 0, 0
        self.wait(idle_cycles)

    def begin(self, layout: Layout, depths: Mapping[str, int] = READ_DEPTHS) -> np.record:
        """The state in which the next phase begins, which `end` completes. `depths` are as in `bus.prepare`."""
        s = layout.new()
        prepare_memory(s, self.model, depths)
        if self._before is not None:
            dram.go_on(s, self._before, self._cycles)
        self._before = s
        return s

    def end(self, cycles: int) -> int:
        """Says that the phase took so many cycles, after which everything has been answered. Returns `cycles`."""
        self._cycles = cycles
        self.age += cycles
        return cycles

    def wait(self, cycles: int) -> None:
        """Lets cycles pass in which nothing is asked for."""
        s = self.begin(geometry.layout)
        if self.model.kind == LPDDR3:
            geometry.idle_phase(s, cycles)
        self.end(cycles)


def table_cycles(memory: LastingMemory, tiles: int, base: int, depths: Mapping[str, int] = READ_DEPTHS) -> int:
    """The cycles of the phase TABLE for a table of so many tiles from the beat `base` on."""
    s = memory.begin(geometry.layout, depths)
    return memory.end(finished("TABLE", geometry.table_phase(s, tiles, base, LIMIT)))


def dram_commands(s: np.record) -> dict[str, int]:
    """The DRAM commands of a phase, counted."""
    return {"activates": int(s.dram_activates_given), "refreshes": int(s.dram_refreshes)}


def counts_of(s: np.record, stages: tuple[str, ...]) -> dict[str, np.ndarray]:
    """For the input of each stage, the cycles in which an item moved and those in which one was offered and not taken."""
    return {stage: np.array([s[f"busy_{stage}"], s[f"blocked_{stage}"]]) for stage in stages}
