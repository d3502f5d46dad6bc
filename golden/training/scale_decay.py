"""Scale decay: a loss that shrinks the Gaussians that many tiles use (paper section 3.3)."""

from __future__ import annotations

import torch

TILE_THRESHOLD = 4
"""T of the paper: Gaussians used by no more tiles cost nothing."""

GAMMA_FIRST = 1e-4
"""What gamma starts with at the first passed gate; below it gamma is 0."""

GAMMA_FACTOR = 3.0
"""Gamma's change at every gate."""


def weighted_scale(
    log_scales: torch.Tensor, index: torch.Tensor, tiles: torch.Tensor, threshold: int = TILE_THRESHOLD
) -> torch.Tensor:
    """WS = mean over Gaussians of max_axis(scale) * max(U - T, 0), in world units.

    No gradient goes through U: whether a tile uses a Gaussian is no smooth function of anything.

    Args:
        log_scales: (N, 3), natural log of world units.
        index: (M,) int64, the Gaussians that the view projected.
        tiles: (M,) integers, U: tiles of this view that used each of them; Gaussians not in `index` count 0.
        threshold: T.

    Returns:
        A scalar; its gradient with respect to a Gaussian's largest log scale is scale * max(U - T, 0) / N.
    """
    excess = (tiles.detach().to(log_scales.dtype) - threshold).clamp(min=0)
    largest = torch.exp(log_scales[index].amax(dim=1))
    return (largest * excess).sum() / max(len(log_scales), 1)


def next_gamma(gamma: float, passed: bool, first: float = GAMMA_FIRST) -> float:
    """The weight of WS after a gate: three times as much after a pass, a third after a failure, nothing below `first`."""
    if passed:
        return max(GAMMA_FACTOR * gamma, first)
    lower = gamma / GAMMA_FACTOR
    return lower if lower >= first else 0.0
