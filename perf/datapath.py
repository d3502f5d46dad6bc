"""The datapaths of the geometry phase, stepped cycle by cycle: a slot enters once in an interval, is finished after a fixed
number of cycles, and then waits for the output register (rtl/culling/datapath.py)."""

from __future__ import annotations

import numpy as np

from perf import memory
from perf.constants import HELD, Culling
from perf.kernel import step
from perf.layout import Layout

NEAR, PROJECTION, ELLIPSE, HARMONICS, CHUNK_TEST = range(5)
"""The datapaths, by the numbers under which their state is kept."""

RING = 128  # slots, more than any datapath holds
MASK = RING - 1


def add_paths(to: Layout) -> None:
    """Adds to a layout, of each datapath, the length and the interval, slots entered and fetched, free rows, whether the output
    register is full, whether another phase has the path's input in this cycle (`perf.overlap`), and the cycles in which the
    slots inside are finished; and `path_shift`, the cycles from the reset to the state's first one: slots enter in cycles after
    the reset that are multiples of the interval."""
    to.words("path_shift")
    for name in ("length", "interval", "in", "out", "free", "full", "held"):
        to.ring(f"path_{name}", 8)
    to.ring("path_times", 8, RING)


layout = Layout(memory.layout)
add_paths(layout)


def set_path(s, p, length, interval, rows):
    """Initialises datapath number `p`, which is empty."""
    s.path_length[p], s.path_interval[p], s.path_free[p] = length, interval, rows


def set_culling(s: np.record, paths: Culling) -> None:
    """Initialises the datapaths of a machine, which are empty. A splat that is held behind projection needs no row of its
    output queue."""
    for place, path, held in ((NEAR, paths.near, 0), (PROJECTION, paths.projection, HELD), (ELLIPSE, paths.ellipse, 0),
                              (HARMONICS, paths.colour, 0)):
        set_path(s, place, path.length, path.interval, path.rows + held)


@step
def fetch(s, p, t):
    """Moves a finished slot into the output register if that is free."""
    if s.path_full[p] == 0:
        at = s.path_out[p]
        if at != s.path_in[p] and s.path_times[p, at & MASK] <= t:
            s.path_out[p], s.path_full[p] = at + 1, 1
            s.path_free[p] += 1


@step
def accepts(s, p, t):
    """Whether a slot can enter."""
    free = s.path_free[p] != 0 and s.path_held[p] == 0
    return free and (s.path_interval[p] == 1 or (t + s.path_shift) % s.path_interval[p] == 0)


@step
def enter(s, p, t):
    """Enters a slot."""
    at = s.path_in[p]
    s.path_times[p, at & MASK] = t + s.path_length[p] + 1
    s.path_in[p] = at + 1
    s.path_free[p] -= 1
