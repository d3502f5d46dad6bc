"""Energies of memory accesses from published numbers: SRAM by its size, DRAM by the currents in its data sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass

SRAM_POINTS = ((8 << 13, 10.0), (32 << 13, 20.0), (1 << 23, 100.0))
"""(bits, pJ) of a 64-bit access to caches of 8 KB, 32 KB and 1 MB."""

SRAM_NODE = "45 nm"
SRAM_SOURCE = "Horowitz, Computing's energy problem, ISSCC 2014, fig. 1.1.9: 64-bit access, 45 nm 0.9 V"
SRAM_SCALING = "linear in the word's bits; between the sizes, and below them down to 1 KB, a power law; / 7.16 to 16 nm"
SRAM_TO_16NM = 1 / 7.16
"""Factor of energy from 45 nm to 16 nm at 0.8 V (Stillmaker & Baas 2017)."""

SRAM_LEAST_BITS = 1 << 13
"""An access to a smaller memory costs as much per bit as one to a memory of this size, because decoder and sense amplifiers
remain."""

SRAM_LEAKAGE_SHARE = 0.25
"""Leakage of a bit relative to that of a flip-flop of the library: 6 of 24 transistors."""


def sram_access_pj(words: int, width: int) -> float:
    """The energy of reading or writing a word, in pJ at 16 nm."""
    bits = max(words * width, SRAM_LEAST_BITS)
    points = [(math.log(b), math.log(e)) for b, e in SRAM_POINTS]
    pair = points[:2] if math.log(bits) < points[1][0] else points[1:]
    (x0, y0), (x1, y1) = pair
    energy = math.exp(y0 + (math.log(bits) - x0) * (y1 - y0) / (x1 - x0))
    return energy * width / 64 * SRAM_TO_16NM


@dataclass(frozen=True)
class Dram:
    """A memory of several channels, described by the currents in its data sheet.

    Attributes:
        name, source: the memory's name, and the source of the numbers.
        channels: the number of channels.
        volts: the core supply voltage for which the currents hold.
        bytes_per_s: the bandwidth of a channel.
        read_a, write_a, standby_a: IDD4R, IDD4W and IDD3N of a channel.
    """

    name: str
    source: str
    channels: int
    volts: float
    bytes_per_s: float
    read_a: float
    write_a: float
    standby_a: float

    @property
    def read_pj_per_bit(self) -> float:
        """Energy of reading a bit, in addition to standby."""
        return (self.read_a - self.standby_a) * self.volts / (8 * self.bytes_per_s) * 1e12

    @property
    def write_pj_per_bit(self) -> float:
        """Energy of writing a bit, in addition to standby."""
        return (self.write_a - self.standby_a) * self.volts / (8 * self.bytes_per_s) * 1e12

    @property
    def standby_mw(self) -> float:
        """Standby power of all channels with open rows."""
        return self.channels * self.standby_a * self.volts * 1e3


LPDDR3 = Dram(
    name="4 x LPDDR3-1600 x32",
    source="LPDDR3-1600 data sheet currents: IDD4R 230 mA, IDD4W 190 mA, IDD3N 34 mA at 1.2 V, 6.4 GB/s a channel; activates, "
           "refresh and I/O beside them are not in these",
    channels=4, volts=1.2, bytes_per_s=6.4e9, read_a=0.230, write_a=0.190, standby_a=0.034)
