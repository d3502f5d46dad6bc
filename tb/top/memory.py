"""The Verilog memory's parameters, in the units of its users."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from spec.memory import BEAT_BYTES, DRAM_BYTES_PER_CYCLE

SOURCE = ("memory.sv", (Path(__file__).parent / "memory.sv").read_text())

ERRORS = {
    1: "an address or data changed, or was withdrawn, while valid and not ready",
    2: "a transaction is not one aligned beat",
    4: "an address lies outside memory",
    8: "a write lies in what the host filled",
}
"""Bits of the memory's `errors`."""

LEAST_BEATS = 1 << 18
"""Memories have at least so many beats (8 MiB)."""

_FINEST = 1000  # denominators of bandwidths


@dataclass(frozen=True)
class MemorySpeed:
    """How fast memory is, and how it fails.

    Attributes:
        latency: cycles from a request to its answer, where nothing is in the way; at least 1.
        bytes_per_cycle: reads and writes together; None: a beat read and a beat written in every cycle.
        pauses: of 256 cycles, how many every channel of the bus pauses, at random.
        failing: first byte and the one behind the last that answer with an error; none by default.
    """

    latency: int = 100
    bytes_per_cycle: float | None = DRAM_BYTES_PER_CYCLE
    pauses: int = 0
    failing: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        for name, low, high in (("latency", 1, 1 << 20), ("pauses", 0, 255)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{name} must be an integer, not {value!r}")
            if not low <= value <= high:
                raise ValueError(f"{name} must be in {low}..{high}, not {value!r}")
        if self.bytes_per_cycle is not None and not 0.01 <= self.bytes_per_cycle <= 1000:
            raise ValueError(f"bytes_per_cycle must be None or in 0.01..1000, not {self.bytes_per_cycle!r}")

    @property
    def signals(self) -> dict[str, int]:
        """Values of the memory's ports."""
        rate = Fraction(0) if self.bytes_per_cycle is None else Fraction(str(self.bytes_per_cycle)).limit_denominator(_FINEST)
        return {
            "latency": self.latency, "gain": rate.numerator, "cost": BEAT_BYTES * rate.denominator if rate else 0,
            "pauses": self.pauses, "error_first": self.failing[0], "error_end": self.failing[1]}


def memory_beats(beats: int) -> int:
    """Size of the smallest memory that holds so many beats: a power of two, and LEAST_BEATS or more."""
    return max(LEAST_BEATS, 1 << (beats - 1).bit_length())


def plusargs(folder: Path, beats: int) -> list[str]:
    """What a simulation of `memory.sv` is started with: the folder of its files, and its size in beats."""
    return [f"+folder={folder}", f"+beats={beats}"]


def broken_rules(errors: int) -> tuple[str, ...]:
    """The memory's `errors` in words."""
    return tuple(text for bit, text in ERRORS.items() if errors & bit)
