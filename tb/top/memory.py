"""The parameters of the Verilog memory in memory.sv and lpddr3.sv, in units that suit its users."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from golden.host.run_options import IDEAL, LPDDR3, MEMORIES
from spec.lpddr3 import COUNTS, PARAMETERS, Lpddr3, check_clock, picoseconds
from spec.memory import BEAT_BYTES, BUS_BYTES_PER_CYCLE, DRAM_BYTES_PER_CYCLE

SOURCES = tuple((name, (Path(__file__).parent / name).read_text()) for name in ("lpddr3.sv", "memory.sv"))
"""The memory's files: their names and texts."""

ERRORS = {
    1: "an address or data changed, or was withdrawn, while valid and not ready",
    2: "a transaction is not one aligned beat",
    4: "an address lies outside memory",
    8: "a write lies in what the host filled",
}
"""Meanings of the bits of the memory's output `errors`."""

LEAST_BEATS = 1 << 18
"""The smallest size of a memory in beats (8 MiB)."""

_FINEST = 1000  # largest denominator of a bandwidth


@dataclass(frozen=True)
class MemorySpeed:
    """The speed of the memory, and the addresses at which it fails.

    Attributes:
        latency: cycles from a request to its answer when nothing else delays it, for the ideal memory; at least 1.
        bytes_per_cycle: the bandwidth of reads and writes together; None for one beat read and one written in every cycle.
            With LPDDR3 it is the channels' peak at a machine's clock of 1 GHz, and has no effect.
        pauses: in how many of 256 cycles each channel of the bus pauses; these cycles are random.
        failing: the first byte address that answers with an error, and the one after the last; by default there is none.
        kind: one of `golden.host.run_options.MEMORIES`.
        clock_ns: the period of the machine's clock in nanoseconds, which sets how many cycles the times of LPDDR3 are.
    """

    latency: int = 100
    bytes_per_cycle: float | None = DRAM_BYTES_PER_CYCLE
    pauses: int = 0
    failing: tuple[int, int] = (0, 0)
    kind: str = IDEAL
    clock_ns: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in MEMORIES:
            raise ValueError(f"kind must be one of {', '.join(MEMORIES)}, not {self.kind!r}")
        check_clock(self.clock_ns)
        for name, low, high in (("latency", 1, 1 << 20), ("pauses", 0, 255)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{name} must be an integer, not {value!r}")
            if not low <= value <= high:
                raise ValueError(f"{name} must be in {low}..{high}, not {value!r}")
        if self.bytes_per_cycle is not None and not 0.01 <= self.bytes_per_cycle <= BUS_BYTES_PER_CYCLE:
            raise ValueError(f"bytes_per_cycle must be None or in 0.01..{BUS_BYTES_PER_CYCLE}, which the bus moves at most, "
                             f"not {self.bytes_per_cycle!r}")

    @property
    def record(self) -> dict[str, object]:
        """The kind of the memory, and the latency and bandwidth of an ideal one, as values for JSON."""
        ideal = self.kind == IDEAL
        return {"memory": self.kind, "latency": self.latency if ideal else None,
                "bytes_per_cycle": self.bytes_per_cycle if ideal else None}

    @property
    def signals(self) -> dict[str, int]:
        """Values of the memory's input ports."""
        rate = Fraction(0) if self.bytes_per_cycle is None else Fraction(str(self.bytes_per_cycle)).limit_denominator(_FINEST)
        return {
            "lpddr3": int(self.kind == LPDDR3), "clock_ps": picoseconds(self.clock_ns), "latency": self.latency,
            "gain": rate.numerator, "cost": BEAT_BYTES * rate.denominator if rate else 0, "pauses": self.pauses,
            "error_first": self.failing[0], "error_end": self.failing[1]}


def memory_beats(beats: int) -> int:
    """The size of the smallest memory that holds `beats` beats: a power of two, and LEAST_BEATS or more."""
    return max(LEAST_BEATS, 1 << (beats - 1).bit_length())


def plusargs(folder: Path, beats: int, device: Lpddr3 | None = None) -> list[str]:
    """The arguments that start a simulation of `memory.sv`.

    Args:
        folder: the folder of the simulation's files.
        beats: the size of memory in beats.
        device: the timing of LPDDR3; None for that of `spec.lpddr3`.
    """
    device = device or Lpddr3()
    values = {name: picoseconds(getattr(device, name)) for name in PARAMETERS}
    values |= {name: getattr(device, name) for name in COUNTS}
    return [f"+folder={folder}", f"+beats={beats}", *(f"+lpddr3_{name}={value}" for name, value in values.items())]


def broken_rules(errors: int) -> tuple[str, ...]:
    """The violated rules that the memory's output `errors` stands for, in words."""
    return tuple(text for bit, text in ERRORS.items() if errors & bit)
