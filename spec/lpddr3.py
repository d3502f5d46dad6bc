"""The machine's DRAM: four channels of LPDDR3-1600 with 32 data pins each, and the timing of their devices.

The cycle model (`perf.dram`) and the bench's memory (`tb/top/lpddr3.sv`) follow the same values. All of them are times, so that
a machine with another clock sees the same device.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

CHANNELS, BANKS, ROW_BEATS = 4, 8, 128
"""Number of channels, of banks in a device, and of beats in a row: 1,024 columns of 32 bits."""

CLOCKS_NS = (0.01, 1000.0)
"""Shortest and longest accepted clock period of a machine with such a memory, in nanoseconds."""


@dataclass(frozen=True)
class Lpddr3:
    """Timing of an 8 Gb x32 device at 800 MHz, in nanoseconds.

    The values are those of JEDEC JESD209-3 for LPDDR3-1600 (latency set A), rounded up to clock periods. DRAMsim3's
    configs/LPDDR3_8Gb_x32_1600.ini agrees except in tRCD and tRP (18.75 ns) and in the write latency (set B, 9 clocks).

    Attributes:
        clock: tCK. burst: BL / 2 clock periods. read_latency, write_latency: RL, WL. dqsck: the largest tDQSCK.
        rcd, rp, rp_all, ras, rrd, faw, wr, wtr, rtp, refi, rfc: the device's parameters of these names; rp is per bank.
        controller: the delay of a request through controller and PHY together with that of its answer; an assumption.
        window: the number of reads, and of writes, among which a channel chooses.
        high, low: the numbers of waiting writes at which a channel begins and stops to serve writes.
    """

    clock: float = 1.25
    burst: float = 5.0
    read_latency: float = 15.0
    write_latency: float = 7.5
    dqsck: float = 5.0
    rcd: float = 18.75
    rp: float = 18.75
    rp_all: float = 21.25
    ras: float = 42.5
    rrd: float = 10.0
    faw: float = 50.0
    wr: float = 15.0
    wtr: float = 7.5
    rtp: float = 7.5
    refi: float = 3900.0
    rfc: float = 210.0
    controller: float = 20.0
    window: int = 16
    high: int = 16
    low: int = 4

    def looks(self, clock_ns: float) -> int:
        """How often a channel decides in one cycle of the machine, so that at most a clock period of the device lies between.

        Args:
            clock_ns: the period of the machine's clock in nanoseconds.
        """
        return -(-picoseconds(clock_ns) // picoseconds(self.clock))


COUNTS = ("window", "high", "low")
"""Fields of `Lpddr3` that are numbers of requests."""

PARAMETERS = tuple(field.name for field in fields(Lpddr3) if field.name not in COUNTS)
"""Fields of `Lpddr3` that are times."""


def picoseconds(nanoseconds: float) -> int:
    """A time in whole picoseconds, the unit in which models and benches count."""
    return round(1000 * nanoseconds)


def check_clock(clock_ns: float) -> None:
    """Raises ValueError where `clock_ns` is no accepted clock period in nanoseconds."""
    low, high = CLOCKS_NS
    if isinstance(clock_ns, bool) or not isinstance(clock_ns, int | float) or not low <= clock_ns <= high:
        raise ValueError(f"clock_ns must be a number in {low:g}..{high:g}, not {clock_ns!r}")
