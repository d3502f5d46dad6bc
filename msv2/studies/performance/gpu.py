"""A model of a mobile GPU: the roofline of Xavier's Volta for the operations of the 3DGS rasteriser. Nothing was measured here.

A kernel takes as long as its operations at peak rate or its bytes at full bandwidth, whichever is longer. The model has no
launch overhead, no divergence, no cache misses and no threads that wait for their block, so that a real GPU is slower. The
report gives published rates beside the model's. The tiles' lists are ours, from the exact test, and are shorter than those of
3DGS.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from perf.trace import FrameTrace
from spec.constants import TILE

CORES, CLOCK_HZ, BYTES_PER_S = 512, 1.377e9, 137e9
"""Jetson AGX Xavier: 512 CUDA cores of Volta at 1,377 MHz, with 256 bits of LPDDR4x."""

FLOPS_PER_S = 2 * CORES * CLOCK_HZ
"""One fused multiply-add per core and cycle."""

PAIR_FLOPS = 30
"""Operations for a pixel and a splat: offsets 2, exponent 9, exponential 4 (a unit at a quarter of the rate), alpha 3,
transmittance 2, weight 1, three colours 6, tests 3."""

POINT_FLOPS = 400
"""Operations for a splat: transform, covariance, conic, spherical harmonics. The bytes limit this kernel."""

FLOAT_BYTES, KEY_BYTES, RADIX_BITS, DEPTH_BITS = 4, 12, 8, 32
"""For sorting the pairs: a key of tile and depth has 8 bytes, an index 4, and each pass sorts by 8 bits."""

VIEW_FLOATS, PLACE_FLOATS = 12, 11
"""Floats of a projected splat: mean 2, conic and opacity 4, colour 3, depth, radius, tiles. Floats of a point without its
colour: mean 3, scale 3, rotation 4, opacity 1."""

PUBLISHED = (
    {"what": "dense models, FPS at most", "fps": 10.0, "source": "the paper, section 1: typically under 10 FPS on it"},
    {"what": "the paper's foveated model, mean FPS", "fps": 102.2, "source": "the paper, comparison of FR methods (\"Ours\")"},
    {"what": "a foveated model by sub-sampling (SMFR), mean FPS", "fps": 125.9, "source": "the paper, the same table"},
)
"""Frame rates that others measured on Xavier, with other frames."""


class GpuFrame(NamedTuple):
    """The seconds of a frame by kernel, and its bytes."""

    preprocess: float
    sort: float
    blend: float
    dram_bytes: int
    clock_hz: float = CLOCK_HZ

    @property
    def seconds(self) -> float:
        """The seconds of the whole frame."""
        return self.preprocess + self.sort + self.blend

    @property
    def bytes_per_cycle(self) -> float:
        """The bytes that its memory moves per cycle of its clock."""
        return BYTES_PER_S / self.clock_hz


def gpu_frame(trace: FrameTrace, ops: int) -> GpuFrame:
    """The roofline of a frame of one eye.

    Args:
        trace: the frame.
        ops: the number of (tile, splat) pairs that are blended before the tile's last pixel stops, as our array counts them.
    """
    survivors = len(trace.eyes[0].survivor)
    colour = 3 * (trace.sh_degree + 1) ** 2
    passes = math.ceil((DEPTH_BITS + math.log2(max(2, trace.tiles_x * trace.tiles_y))) / RADIX_BITS)
    shape = FLOAT_BYTES * (trace.points * PLACE_FLOATS + survivors * (colour + VIEW_FLOATS)) + trace.entries * KEY_BYTES
    sort = 2 * passes * KEY_BYTES * trace.entries
    blend = trace.entries * FLOAT_BYTES * (1 + VIEW_FLOATS - 3) + 3 * FLOAT_BYTES * trace.width * trace.height
    return GpuFrame(
        max(trace.points * POINT_FLOPS / FLOPS_PER_S, shape / BYTES_PER_S), sort / BYTES_PER_S,
        max(ops * TILE**2 * PAIR_FLOPS / FLOPS_PER_S, blend / BYTES_PER_S), shape + sort + blend)
