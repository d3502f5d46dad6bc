"""Tests of the units in `rtl.culling`: the projection unit, the tile test and the colour unit. The near test is part of
projection.

    *_stimuli       inputs made by hand, at random and from rendered frames, with the golden renderer's results
    *_suite         the test plans, and the required speeds
    colour_device   the colour unit with a memory that delays its answers
"""

from spec.config import TINY, V3

TINY_V3 = TINY.with_(name="tiny_v3", order=V3.order, chunks=V3.chunks, records=V3.records)
"""The smallest machine with compact records."""
