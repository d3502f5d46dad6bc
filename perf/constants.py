"""What the model knows of the RTL's inside: schedules, latencies, steps. tests/perf/test_constants.py compares them with it.

Perf does not import rtl. What spec says (depths of queues, capacities, intervals) is taken from there; the numbers here are
what the RTL works out for itself, or how many registers lie on a way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import BEAT_BYTES, colour_beats
from spec.queues import COLOUR_LOOKAHEAD

DATAPATHS = {  # by culling units: length of the schedules of near test, projection, ellipse test, harmonics
    1: (32, 110, 63, 56), 2: (27, 100, 66, 50), 3: (27, 92, 61, 47), 4: (27, 92, 61, 42),
    5: (25, 90, 58, 45), 6: (25, 90, 58, 42), 7: (25, 90, 58, 39), 8: (25, 90, 58, 39),
}
"""`rtl.culling.schedule.Schedule.length`: a slot's last output is born so many cycles after it entered. Word lengths change no
schedule while `view`, `work` and `conic` differ, as in every configuration: operators are shared by format. More units than 8
are as 8: a point enters every cycle already, a splat its colour every 4."""

HARMONICS = {0: (0,) * 8, 1: (32, 34, 31, 30, 37, 31, 31, 31), 2: (39, 36, 37, 35, 43, 37, 35, 35)}
"""By SH degree below 3, and by culling units from 1 on: the harmonics' schedules of machines of that degree; 0: they have none,
and what waits for its record goes straight to the sums."""

LEAST_COLOUR_INTERVAL = 4
"""`rtl.culling.colour.LEAST_INTERVAL`."""

ROW_PIPELINE, SUMS_LATER = 3, 2
"""`rtl.vrc_array.row` PIPELINE, SUMS_LATER: from an op on a row's input to its transmittance, and from there to its sums."""

BLEND_LATENCY = 3
"""`rtl.vrc_array.blend`."""

DISPARITY_STAGES, RING_STAGES, FILL_LATENCY = 4, 3, 5
"""`rtl.warp_unit`: stages around the divider, from a tile that opens to its first place read ahead, and of the median."""

SETUP_LATENCY = 15
"""`rtl.vrc_array.setup` LATENCY: registers of the setup unit's pipeline, and its output buffer."""


@dataclass(frozen=True)
class Timing:
    """A datapath: a slot enters in one cycle of `interval`, leaves to the output register after `length` + 1; `rows` fit.
    Length 0: there is none."""

    length: int
    interval: int

    @property
    def rows(self) -> int:
        return -(-(self.length + 2) // self.interval) if self.length else 0


@dataclass(frozen=True)
class Culling:
    """The four datapaths of a configuration, and the colour unit's queue before its own."""

    near: Timing
    projection: Timing
    ellipse: Timing
    colour: Timing

    @property
    def colour_waiting(self) -> int:
        return max(2, -(-COLOUR_LOOKAHEAD // self.colour.interval) - self.colour.rows)


def culling(config: AcceleratorConfig) -> Culling:
    """The datapaths of a configuration."""
    units = min(config.culling_units, max(DATAPATHS))
    near, projection, ellipse, colour = DATAPATHS[units]
    if config.sh_degree in HARMONICS:
        colour = HARMONICS[config.sh_degree][units - 1]
    point, splat = config.point_interval, max(LEAST_COLOUR_INTERVAL, config.colour_interval)
    return Culling(Timing(near, point), Timing(projection, point), Timing(ellipse, point), Timing(colour, splat))


def terms(sh_degree: int) -> int:
    """Basis functions beyond the first."""
    return (sh_degree + 1) ** 2 - 1


def colour_steps(config: AcceleratorConfig, sh_degree: int) -> np.ndarray:
    """(steps, 2) int64: beats of the record before each step's, and the beat after the last that it reads.

    As `rtl.culling.colour_sum.record_steps`: a step multiplies so many basis functions that the largest record takes the
    interval, and finds their coefficients in two beats.
    """
    n, beat = config.formats, 8 * BEAT_BYTES
    interval = max(LEAST_COLOUR_INTERVAL, config.colour_interval)
    lanes, count = max(1, -(-terms(config.sh_degree) // interval)), terms(sh_degree)

    def place(term: int) -> int:
        return 3 * (MAX_LEVELS * n.sh_dc.width + term * n.sh_rest.width)

    steps = []
    for first in range(0, max(count, 1), lanes):
        end = min(place(min(first + lanes, terms(config.sh_degree))), place(count))
        steps.append((place(first) // beat if first else 0, (end - 1) // beat + 1))
    if max(end for _, end in steps) > colour_beats(config, sh_degree):
        raise ValueError(f"a record of degree {sh_degree} has {colour_beats(config, sh_degree)} beats: steps are {steps!r}")
    return np.array(steps, np.int64)
