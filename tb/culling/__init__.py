"""Tests of the units in `rtl.culling`: the projection unit, the tile test and the colour unit. The near test is part of
projection.

    *_stimuli       inputs made by hand, at random and from rendered frames, with the golden renderer's results
    *_suite         the test plans, and the required speeds
    joint_*         the projection unit in joint frames of two eyes
    colour_device   the colour unit with a memory that delays its answers
"""

from spec.config import TINY, V3

TINY_RECORDS = TINY.with_(name="tiny_records", order=V3.order, chunks=V3.chunks, records=V3.records)
"""The smallest machine with compact records and lists by tile."""
