"""The guard band: its range, and that clamping never hides on which side of its ends a mean lies."""

import numpy as np

from spec.config import CONFIGS, PAPER, NumberFormats
from spec.formats import SQ
from spec.guard_band import MEAN_RANGE, mean_range
from spec.saturations import limits


def test_the_range_is_that_of_the_format():
    assert MEAN_RANGE == (-16384.0, 16384.0 - 2.0**-10)
    assert mean_range(NumberFormats(mean2d=SQ(12, 6))) == (-4096.0, 4096.0 - 2.0**-6)
    assert {mean_range(config.formats) for config in CONFIGS.values()} == {MEAN_RANGE}, "the oracle has that of all presets"
    low, high = (PAPER.formats.mean2d.to_float(raw) for raw in limits(PAPER.formats.mean2d))
    assert (float(low), float(high)) == MEAN_RANGE


def test_the_first_clamp_changes_no_decision():
    """For every slope and every principal point of a small format."""
    to = SQ(3, 2)
    slope, centre = np.arange(-200, 201)[:, None], np.arange(to.raw_min, to.raw_max + 1)
    clamped = np.clip(np.clip(slope, 2 * to.raw_min, 2 * to.raw_max + 1) + centre, to.raw_min, to.raw_max)
    beyond = (slope + centre <= to.raw_min) | (slope + centre >= to.raw_max)
    assert np.array_equal(np.isin(clamped, limits(to)), beyond)
