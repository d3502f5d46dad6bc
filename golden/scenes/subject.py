"""Where the middle of a model is and how far its subject reaches, in spite of floaters and of a far background.

A capture has a subject, its surroundings, and often a background many times as far away. Training puts the most splats where
the photographs show the most detail, so every splat counts by its opacity here and not by its area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CORE_PERCENT = 40
"""Share of the weight whose distance from the middle is the width of the window that looks for the middle."""
STEPS = 30
"""Largest number of moves of that window."""
PERCENTS = tuple(range(30, 99, 4))
"""Shares of the weight, in percent, whose radii are compared."""
JUMP = 1.6
"""A subject ends where the radius grows by this factor while the share of the weight grows by 12 %."""
REACH = 2.2
"""A subject reaches at most this many times the radius that holds half of the weight."""
MARGIN = 1.1


@dataclass(frozen=True)
class Subject:
    """What a camera should show.

    Attributes:
        middle: (3,) float64, world units; it lies in the densest part.
        radius: world units.
        share: the share of the model's weight inside that radius, 0..1.
        extent: the radius that holds 98 % of the weight, world units.
        scales: (4,) radii that hold 30, 50, 70 and 90 % of the weight, world units.
    """

    middle: np.ndarray
    radius: float
    share: float
    extent: float
    scales: np.ndarray


def find_subject(means: np.ndarray, weight: np.ndarray, extent: np.ndarray | float = 0.0) -> Subject:
    """The subject of a model.

    Args:
        means: (N, 3) float64, world units.
        weight: (N,) float64 >= 0.
        extent: (N,) float64, how far each splat reaches beyond its mean, world units.
    """
    if not weight.sum() > 0:
        weight = np.ones(len(means))
    middle = np.array([weighted_percentiles(x, weight, (50,))[0] for x in means.T])
    for _ in range(STEPS):
        distance = np.linalg.norm(means - middle, axis=1)
        width = weighted_percentiles(distance, weight, (CORE_PERCENT,))[0]
        least = max(1e-12 * float(distance.max()), 1e-300)
        near = weight * np.exp(-0.5 * np.minimum(distance / max(width, least), 30.0) ** 2)
        if not near.sum() > 0:
            break
        step = near @ means / near.sum() - middle
        middle = middle + step
        if np.linalg.norm(step) < 1e-3 * width:
            break
    distance = np.linalg.norm(means - middle, axis=1)
    distance = distance + extent
    radii = weighted_percentiles(distance, weight, PERCENTS)
    last = 0
    while last + 3 < len(radii) and radii[last + 3] < JUMP * radii[last]:
        last += 1
    end = MARGIN * radii[min(last + 1, len(radii) - 1)] if last + 3 < len(radii) else radii[-1]
    scales = weighted_percentiles(distance, weight, (30, 50, 70, 90))
    radius = float(min(end, REACH * scales[1])) or float(distance.max())
    return Subject(middle, radius, float(weight[distance <= radius].sum() / weight.sum()), float(radii[-1]), scales)


def weighted_percentiles(x: np.ndarray, weight: np.ndarray, percents: tuple[float, ...]) -> np.ndarray:
    """float64 values of `x` (N,) below which these shares, in percent, of the weight (N,) lie."""
    order = np.argsort(x, kind="stable")
    total = np.cumsum(weight[order])
    index = np.searchsorted(total, np.array(percents) / 100 * total[-1])
    return x[order][np.minimum(index, len(x) - 1)]
