"""Losses on whole images."""

from __future__ import annotations

import torch

from golden.metrics.ssim import Ssim

SSIM_SHARE = 0.2
"""Weight of 1 - SSIM; the absolute difference has the rest (3DGS)."""


def photometric(image: torch.Tensor, ssim: Ssim, target: torch.Tensor) -> torch.Tensor:
    """3DGS's loss, 0.8 L1 + 0.2 (1 - SSIM), as a scalar tensor.

    Args:
        image: (H, W, 3), the rendered image, not clamped.
        ssim: the `Ssim` prepared for `target`.
        target: (H, W, 3), the photograph.
    """
    return (1 - SSIM_SHARE) * (image - target).abs().mean() + SSIM_SHARE * (1 - ssim(image))


def with_squared_error(loss: torch.Tensor, image: torch.Tensor, photograph: torch.Tensor) -> torch.Tensor:
    """The loss and, with the same weight, the mean squared error of the image, of which PSNR is the logarithm."""
    squared = (image - photograph).square().mean()
    return loss + (loss.detach() / squared.detach().clamp(min=1e-12)) * squared
