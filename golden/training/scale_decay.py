"""Scale decay: a loss that shrinks the Gaussians that many tiles use (paper section 3.3)."""

from __future__ import annotations

import torch

TILE_THRESHOLD = 4
"""The paper's T: a Gaussian that at most this many tiles use adds nothing to the loss."""

GAMMA_FIRST = 1e-4
"""Gamma at the first passed gate, and the smallest value that is not 0."""

GAMMA_FACTOR = 3.0
"""Factor by which gamma changes at every gate."""


def weighted_scale(
    log_scales: torch.Tensor, index: torch.Tensor, tiles: torch.Tensor, threshold: int = TILE_THRESHOLD
) -> torch.Tensor:
    """WS = mean over Gaussians of max_axis(scale) * max(U - T, 0), in world units.

    No gradient goes through U, because whether a tile uses a Gaussian is not a smooth function of the parameters.

    Args:
        log_scales: (N, 3), natural log of world units.
        index: (M,) int64, the Gaussians that the view projected.
        tiles: (M,) integers, U: number of this view's tiles that used each of them; for Gaussians not in `index` it is 0.
        threshold: T.

    Returns:
        A scalar; its gradient with respect to a Gaussian's largest log scale is scale * max(U - T, 0) / N.
    """
    excess = (tiles.detach().to(log_scales.dtype) - threshold).clamp(min=0)
    largest = torch.exp(log_scales[index].amax(dim=1))
    return (largest * excess).sum() / max(len(log_scales), 1)


def next_gamma(gamma: float, passed: bool, first: float = GAMMA_FIRST) -> float:
    """The weight of WS after a gate: three times as much after a pass, a third after a failure; 0 instead of values below
    `first`."""
    if passed:
        return max(GAMMA_FACTOR * gamma, first)
    lower = gamma / GAMMA_FACTOR
    return lower if lower >= first else 0.0
