"""Foveation levels for a model that was trained without them: the paper's SMFR baseline, and subsets with opacity
enhancement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from golden.scenes.model import GaussianModel
from spec.constants import AMP_MAX, MAX_LEVELS, SMFR_FRACTIONS


def smfr_levels(
    model: GaussianModel, levels: int = MAX_LEVELS, seed: int = 0, counts: Sequence[int] | None = None
) -> GaussianModel:
    """Nested random subsets of a model's points: the SMFR baseline (Single-Model FR, paper section 7, variants).

    One seeded permutation ranks the points. Level L uses the first SMFR_FRACTIONS[L] of them, so each level is a subset of the
    level before it, and a point's quality bound is the number of levels that it is in. Opacity and DC colour of level 1 are
    copied to every level.

    Args:
        model: its level 1 is used.
        levels: number of levels, 1..4.
        seed: seed of the permutation.
        counts: the number of points in each level, instead of the fractions; the first must be all points, and none may be
            larger than the one before.

    Raises:
        ValueError: `levels` is outside 1..4, or `counts` breaks the rule above.
    """
    if levels not in range(1, MAX_LEVELS + 1):
        raise ValueError(f"levels must be 1..{MAX_LEVELS}, not {levels!r}")
    n = len(model)
    rank = np.random.default_rng(seed).permutation(n)
    if counts is None:
        sizes = [round(fraction * n) for fraction in SMFR_FRACTIONS[:levels]]
        sizes[1:] = [max(size, 1) for size in sizes[1:]]  # a tiny model keeps a point in every level
    else:
        sizes = list(counts)
        if len(sizes) != levels or sizes[0] != n or sizes != sorted(sizes, reverse=True) or sizes[-1] < 1:
            raise ValueError(f"counts must be {levels} numbers from {n} down to at least 1, not {counts!r}")
    bound = sum((rank < size).astype(np.uint8) for size in sizes)
    return replace(
        model, quality_bound=bound, opacity=np.repeat(model.opacity[:, :1], levels, axis=1),
        sh_dc=np.repeat(model.sh_dc[:, :1], levels, axis=1),
    )


ENHANCEMENT = (1.0, 4.0, 16.0, 32.0)
"""Factor on the opacity at each level of `spread_levels`; it is large enough for the remaining points to close the holes."""


def spread_levels(model: GaussianModel, levels: int = MAX_LEVELS) -> GaussianModel:
    """Nested subsets that are spread evenly over the scene, with enhanced opacity (paper section 4.4): foveation without
    training.

    Points are ranked by the van der Corput sequence along a space-filling curve, and larger points come earlier. So every level
    covers the whole scene. The fractions are those of SMFR. The result is better than random subsets but does not replace
    trained levels.

    Args:
        model: its level 1 is used.
        levels: number of levels, 1..4.

    Raises:
        ValueError: `levels` is outside 1..4.
    """
    ranked = smfr_levels(model, levels)  # checks `levels` and makes arrays of the right shapes
    n = len(model)
    place = np.empty(n, np.int64)
    place[np.argsort(_morton(model.means), kind="stable")] = np.arange(n)
    bits = max(1, (n - 1).bit_length())
    reversed_place = sum((place >> b & 1) << (bits - 1 - b) for b in range(bits))
    _, middle, widest = np.sort(np.exp(model.log_scales), axis=1).T
    rank = np.empty(n, np.int64)
    rank[np.argsort((reversed_place + 0.5) / np.sqrt(np.maximum(middle * widest, 1e-30)), kind="stable")] = np.arange(n)
    sizes = [max(1, round(fraction * n)) for fraction in SMFR_FRACTIONS[:levels]]
    bound = np.maximum(1, sum((rank < size).astype(np.uint8) for size in sizes)).astype(np.uint8)
    return replace(ranked, quality_bound=bound, opacity=np.minimum(ranked.opacity * ENHANCEMENT[:levels], AMP_MAX))


def _morton(points: np.ndarray) -> np.ndarray:
    """(N,) int64 index of each of the points (N, 3) along a Z-order curve through the box that holds 98 % of them along each
    axis."""
    low, high = np.percentile(points, [1, 99], axis=0)
    cell = np.clip((points - low) / np.maximum(high - low, 1e-12) * 1023, 0, 1023).astype(np.int64)
    return sum((cell[:, axis] >> b & 1) << (3 * b + axis) for b in range(10) for axis in range(3))
