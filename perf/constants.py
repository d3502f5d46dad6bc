"""What the model knows of the RTL's internals: schedules, latencies and steps. tests/perf/test_constants.py compares them with
the RTL.

perf does not import rtl. Depths of queues, capacities and intervals come from spec. The numbers here are those that the RTL
derives itself, and the numbers of registers on a path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spec.chunks import TEST_INTERVAL
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import BEAT_BYTES, colour_beats
from spec.queues import COLOUR_LOOKAHEAD

DATAPATHS = {1: (32, 110, 63), 2: (27, 100, 66), 4: (27, 92, 61), 8: (25, 90, 58)}
"""The lengths of `rtl.culling.schedule.Schedule` for the near test, projection and the ellipse test, by the number of culling
units: the last output of a slot is ready so many cycles after the slot entered. Word lengths change no schedule as long as the
formats `view`, `work` and `conic` differ, which they do in every configuration, because operators are shared by format."""

HARMONICS = {
    0: dict.fromkeys((32, 16, 8, 4, 2), 0),
    1: {32: 32, 16: 34, 8: 30, 4: 31, 2: 29},
    2: {32: 39, 16: 36, 8: 35, 4: 35, 2: 35},
    3: {32: 56, 16: 50, 8: 42, 4: 39, 2: 39},
}
"""Lengths of the harmonics' schedules, by the machine's SH degree and the cycles of a splat. Length 0 means that there is no
such datapath: what waits for its colour record goes straight to the sums."""

LEAST_COLOUR_INTERVAL = {"wide": 4, "compact": 2}
"""The value of `rtl.culling.colour.LEAST_INTERVAL`."""

ROW_PIPELINE, SUMS_LATER = 3, 2
"""PIPELINE and SUMS_LATER of `rtl.vrc_array.row`: cycles from an operation at a row's input to its transmittance, and from
there to its sums."""

BLEND_LATENCY = 3
"""The latency of `rtl.vrc_array.blend`."""

DISPARITY_STAGES, RING_STAGES, FILL_LATENCY = 4, 3, 5
"""Latencies in `rtl.warp_unit`: the stages around the divider; from a tile that opens to its first place read ahead; the
median."""

SETUP_LATENCY = 15
"""LATENCY of `rtl.vrc_array.setup`: the registers of the setup unit's pipeline and its output buffer."""


HELD = 1
"""Items that a register at the end of a path keeps while the unit behind it waits (`rtl.stream.Skid`): splats of the projection
unit, and places of the colour unit."""

CHUNK_TEST = 78
"""The length of the schedule of the chunk test (`rtl.chunks.chunk_test`)."""

DECODE_STAGES = 6
"""The latency of `rtl.chunks.geometry_decode`."""


@dataclass(frozen=True)
class Timing:
    """A datapath. A slot can enter once in `interval` cycles and reaches the output register after `length` + 1 cycles.
    Length 0 means that there is no such datapath."""

    length: int
    interval: int

    @property
    def rows(self) -> int:
        return -(-(self.length + 2) // self.interval) if self.length else 0


@dataclass(frozen=True)
class Culling:
    """The datapaths of a configuration. `colour_waiting` is the depth of the queue before the colour unit's datapath."""

    near: Timing
    projection: Timing
    ellipse: Timing
    colour: Timing
    chunk_test: Timing

    @property
    def colour_waiting(self) -> int:
        return max(2, -(-COLOUR_LOOKAHEAD // self.colour.interval) - self.colour.rows)


def splat_interval(config: AcceleratorConfig) -> int:
    """Cycles of a splat in the colour unit."""
    return max(LEAST_COLOUR_INTERVAL[config.records], config.colour_interval)


def culling(config: AcceleratorConfig) -> Culling:
    """The datapaths of a configuration."""
    near, projection, ellipse = DATAPATHS[config.culling_units]
    point, splat = config.point_interval, splat_interval(config)
    colour = HARMONICS[config.sh_degree][splat]
    return Culling(
        Timing(near, point), Timing(projection, point), Timing(ellipse, point), Timing(colour, splat),
        Timing(CHUNK_TEST, TEST_INTERVAL))


def terms(sh_degree: int) -> int:
    """Number of basis functions beyond the first."""
    return (sh_degree + 1) ** 2 - 1


def colour_steps(config: AcceleratorConfig, sh_degree: int) -> np.ndarray:
    """(steps, 2) int64: for each step, the number of beats of the record before it, and the beat after the last that it reads.

    This follows `rtl.culling.colour_sum.record_steps`. A step multiplies as many basis functions as let the largest record fit
    the interval, and finds their coefficients in two beats. With compact records (`rtl.culling.compact_sum`), every splat has
    the steps of the largest degree, and both beats of a record are there in all of them.
    """
    n, beat = config.formats, 8 * BEAT_BYTES
    interval = splat_interval(config)
    lanes, count = max(1, -(-terms(config.sh_degree) // interval)), terms(sh_degree)
    if config.compact:
        return np.array([(0, colour_beats(config, sh_degree))] * max(1, -(-terms(config.sh_degree) // lanes)), np.int64)

    def place(term: int) -> int:
        return 3 * (MAX_LEVELS * n.sh_dc.width + term * n.sh_rest.width)

    steps = []
    for first in range(0, max(count, 1), lanes):
        end = min(place(min(first + lanes, terms(config.sh_degree))), place(count))
        steps.append((place(first) // beat if first else 0, (end - 1) // beat + 1))
    if max(end for _, end in steps) > colour_beats(config, sh_degree):
        raise ValueError(f"a record of degree {sh_degree} has {colour_beats(config, sh_degree)} beats: steps are {steps!r}")
    return np.array(steps, np.int64)
