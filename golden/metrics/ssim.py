"""Differentiable SSIM for training; its value equals the reported one (`golden.metrics.image.ssim`)."""

from __future__ import annotations

import numpy as np
import torch

from golden.metrics.banded import Banded, separable

RADIUS = 5
"""Number of pixels to each side of the window's centre: windows are 11x11, as in Wang et al. 2004."""

SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2
"""Stabilisers of luminance and contrast for images of range 1 (Wang et al. 2004)."""


class Ssim:
    """Structural similarity (Wang et al. 2004) against one reference, differentiable in the image.

    It equals scikit-image's as `golden.metrics.image.ssim` calls it: Gaussian 11x11 window of sigma 1.5, population
    covariances, range 1, mean over the pixels whose window lies inside the image. The reference's statistics are computed once.
    An object holds the reference's pixels, means and variances, which take 36 bytes a pixel in float32.
    """

    def __init__(self, reference: torch.Tensor) -> None:
        """Prepares the statistics of the reference.

        Args:
            reference: (H, W, 3) floats of range 1, at least 11x11; its device and dtype are those of all results.

        Raises:
            ValueError: the reference has the wrong shape or dtype.
        """
        if reference.ndim != 3 or reference.shape[2] != 3 or min(reference.shape[:2]) <= 2 * RADIUS:
            raise ValueError(f"a reference must be (H, W, 3) with H and W at least 11, not {tuple(reference.shape)}")
        if not reference.is_floating_point():
            raise ValueError(f"a reference must hold floats of range 1, not {reference.dtype}")
        self.shape = reference.shape
        self._pixels = _planes(reference.detach())
        self._window = tuple(Banded(_window_matrix(n), self._pixels) for n in self._pixels.shape[1:])
        self._mean = separable(self._pixels, *self._window)
        self._variance = separable(self._pixels**2, *self._window) - self._mean**2

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Mean SSIM, a scalar tensor; 1 for equal images.

        Args:
            image: (H, W, 3), of the reference's size.

        Raises:
            ValueError: the image has another size.
        """
        return self.map(image).mean()

    def map(self, image: torch.Tensor) -> torch.Tensor:
        """(H - 10, W - 10, 3) SSIM of each channel around each pixel whose window lies inside the image."""
        if image.shape != self.shape:
            raise ValueError(f"image must have the reference's shape {tuple(self.shape)}, not {tuple(image.shape)}")
        return _SsimMap.apply(_planes(image), self._pixels, self._mean, self._variance, self._window).permute(1, 2, 0)


class _SsimMap(torch.autograd.Function):
    """(3, H - 10, W - 10) SSIM of planes, with its derivative in closed form: three blurs in each direction, no autograd in
    between."""

    @staticmethod
    def forward(
        ctx: object, image: torch.Tensor, pixels: torch.Tensor, mean_r: torch.Tensor, var_r: torch.Tensor,
        window: tuple[Banded, Banded],
    ) -> torch.Tensor:
        mean, square, product = separable(torch.cat([image, image**2, image * pixels]), *window).view(3, *mean_r.shape)
        cross, own = mean * mean_r, mean.square()
        contrast = product.sub_(cross).mul_(2).add_(C2)
        power = torch.addcmul(own, mean_r, mean_r).add_(C1)
        spread = square.sub_(own).add_(var_r).add_(C2)
        ratio = cross.mul_(2).add_(C1).div_(power).div_(spread)
        ssim = ratio * contrast
        ctx.save_for_backward(image, pixels, mean, mean_r, contrast, ratio, power, spread, ssim)
        ctx.window = window
        return ssim

    @staticmethod
    def backward(ctx: object, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        image, pixels, mean, mean_r, contrast, ratio, power, spread, ssim = ctx.saved_tensors
        by_covariance = ratio * (2 * grad)
        by_variance = (ssim / spread).mul_(-grad)
        by_mean = (mean_r * contrast).div_(spread).addcmul_(mean, ssim, value=-1).div_(power).mul_(2 * grad)
        by_mean.addcmul_(mean, by_variance, value=-2).addcmul_(mean_r, by_covariance, value=-1)
        blurred = torch.cat([by_mean, by_variance, by_covariance])
        mean_back, square_back, product_back = separable(blurred, *ctx.window, adjoint=True).view(3, *image.shape)
        gradient = mean_back.addcmul_(image, square_back, value=2).addcmul_(pixels, product_back)
        return gradient, None, None, None, None


def _planes(image: torch.Tensor) -> torch.Tensor:
    """(3, H, W) contiguous channels of (H, W, 3)."""
    return image.permute(2, 0, 1).contiguous()


def _window_matrix(n: int) -> np.ndarray:
    """(n - 10, n) float64: row i holds the normalised Gaussian weights of the inputs i..i+10."""
    offset = np.arange(n)[None, :] - np.arange(n - 2 * RADIUS)[:, None] - RADIUS
    weight = np.where(abs(offset) <= RADIUS, np.exp(-(offset**2) / (2 * SIGMA**2)), 0.0)
    return weight / weight.sum(axis=1, keepdims=True)
