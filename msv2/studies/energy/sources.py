"""Energies of SRAM accesses by the memory's size, from published numbers. The memory beside the chip is in `dram`."""

from __future__ import annotations

import math

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
