"""Scale decay: a loss that shrinks the Gaussians that many tiles use (paper section 3.3)."""

from __future__ import annotations

import math

import torch

TILE_THRESHOLD = 4
"""The paper's T: a Gaussian that at most this many tiles use adds nothing to the loss."""

GAMMA_SHARE = 0.15
"""Share of the photometric loss that gamma WS has at the first passed gate. WS is in world units, so one value of gamma for all
scenes does nothing in one scene and too much in another."""

GAMMA_LIMIT = 0.45
"""Largest such share: after passes in a row the photographs still determine the model."""

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


def balance(loss: float, decay: float) -> float:
    """The gamma with which gamma WS would be as large as the photometric loss; 0 where no Gaussian decays.

    Args:
        loss: the photometric loss, a mean over views.
        decay: WS, a mean over the same views.
    """
    return loss / decay if decay > 0 else 0.0


def next_gamma(gamma: float, passed: bool, first: float, limit: float = math.inf, rise: float = GAMMA_FACTOR) -> float:
    """The weight of WS after a gate: `rise` times as much after a pass, up to `limit`, and a third after a failure. From the
    first pass on it is never below `first`: a model that stopped decaying would grow back while it is trained."""
    if passed:
        return max(min(rise * gamma, limit), first)
    return max(gamma / GAMMA_FACTOR, first) if gamma else 0.0
