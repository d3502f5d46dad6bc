"""Foveation levels for a model that was trained without: the paper's SMFR baseline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.scenes.model import GaussianModel
from spec.constants import MAX_LEVELS, SMFR_FRACTIONS


def smfr_levels(model: GaussianModel, levels: int = MAX_LEVELS, seed: int = 0) -> GaussianModel:
    """Nested random subsets of a model's points (SMFR, Single-Model FR: paper section 7, variants).

    One seeded permutation ranks the points; level L uses the first SMFR_FRACTIONS[L] of them, so each level is a subset of the
    one before and the quality bound is the number of levels a point is in. Opacity and DC of level 1 are copied to each level.

    Args:
        levels: 1..4.
        seed: of the permutation.

    Raises:
        ValueError: levels outside 1..4.
    """
    if levels not in range(1, MAX_LEVELS + 1):
        raise ValueError(f"levels must be 1..{MAX_LEVELS}, not {levels!r}")
    n = len(model)
    rank = np.random.default_rng(seed).permutation(n)
    sizes = [round(fraction * n) for fraction in SMFR_FRACTIONS[:levels]]
    sizes[1:] = [max(size, 1) for size in sizes[1:]]  # a tiny model keeps a point in every level
    bound = sum((rank < size).astype(np.uint8) for size in sizes)
    return replace(
        model, quality_bound=bound, opacity=np.repeat(model.opacity[:, :1], levels, axis=1),
        sh_dc=np.repeat(model.sh_dc[:, :1], levels, axis=1),
    )
