"""The guard band: how far beside the frame a Gaussian's projected mean may lie.

A projected mean is a number of the format `mean2d` along each axis. It is rounded to that format and clamped to its range::

    raw = clamp(floor(slope * 2^frac_bits + 1/2), 2 * raw_min, 2 * raw_max + 1) + centre
    mean2d = clamp(raw, raw_min, raw_max)

where `slope` is the perspective slope in pixels, a small float, and `centre` the principal point. A Gaussian is culled as
outside the frame where `mean2d` is raw_min or raw_max along x or y: it lies at the end of the range or beyond it. The first
clamp changes no decision, because `centre` is a number of `mean2d`: a slope that it clamps to 2 * raw_max + 1 gives at least
raw_max, and one that it clamps to 2 * raw_min gives less than raw_min. In real numbers, which the float renderers have, a
Gaussian is kept where low < mean < high along both axes (`mean_range`).

Such means belong to Gaussians far to the side of the camera that have just passed its near plane. Nearly all of them do not
reach the frame, wherever they are placed. But a giant with a clamped mean would lie nearer to the frame than it does, and
cover the frame with a veil that is not there. Renderers for the web leave out Gaussians whose mean lies beyond some 1.2 times
the clip space, because the affine approximation says little about them. Here the band is as wide as the format can hold, 16,384
pixels to all sides of the frame's origin, so that of the Gaussians whose footprint reaches the frame only such giants are lost.
They disappear at once where a camera's turn takes their mean out of the range, so the trainer narrows them
(`golden.training.representable`).

The near test and the test for faint Gaussians come first, and a Gaussian counts for the first reason that holds, so those that
are culled here count as culled outside. Those whose box would have met the frame, with the clamped mean, count once more, as
saturated means (`spec.saturations`).
"""

from __future__ import annotations

import math

from spec.config import NumberFormats

Range = tuple[float, float]
"""Pixels between which a projected mean must lie, along both axes, the ends excluded."""


def mean_range(formats: NumberFormats) -> Range:
    """The range of projected means in a machine with these formats."""
    to = formats.mean2d
    return float(to.to_float(to.raw_min)), float(to.to_float(to.raw_max))


MEAN_RANGE: Range = mean_range(NumberFormats())
"""The range of the standard formats: that of renderers in floating point."""

UNBOUNDED: Range = (-math.inf, math.inf)
"""No guard band, as in 3DGS's equations."""
