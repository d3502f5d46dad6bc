"""Differentiable SSIM for training, equal to the one reported (`golden.metrics.image.ssim`)."""

from __future__ import annotations

import torch

RADIUS = 5
"""Pixels each side of the window's centre: 11x11, as in Wang et al. 2004."""

SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2
"""Stabilisers of luminance and contrast for images of range 1 (Wang et al. 2004)."""

BLOCK = 64
"""Outputs of one banded product. Blocks skip the band matrix's zeros; from 32 to 96 all are about as fast."""


class Ssim:
    """Structural similarity (Wang et al. 2004) to one reference, differentiable in the image.

    Equal to scikit-image's as `golden.metrics.image.ssim` calls it: Gaussian 11x11 window of sigma 1.5, population
    covariances, range 1, mean over the pixels whose window lies inside the image. The reference's statistics are
    computed once; an object holds three copies of it (its pixels, means and variances): 36 bytes a pixel in float32.
    """

    def __init__(self, reference: torch.Tensor) -> None:
        """Prepare the statistics.

        Args:
            reference: (H, W, 3) floats of range 1, at least 11x11; its device and dtype are those of all results.

        Raises:
            ValueError: not such an image.
        """
        if reference.ndim != 3 or reference.shape[2] != 3 or min(reference.shape[:2]) <= 2 * RADIUS:
            raise ValueError(f"a reference must be (H, W, 3) with H and W at least 11, not {tuple(reference.shape)}")
        if not reference.is_floating_point():
            raise ValueError(f"a reference must hold floats of range 1, not {reference.dtype}")
        self.shape = reference.shape
        self._pixels = _planes(reference.detach())
        self._band = _band(self._pixels)
        self._mean = _blurred(self._pixels, self._band)
        self._variance = _blurred(self._pixels**2, self._band) - self._mean**2

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Mean SSIM, a scalar, 1 for equal images.

        Args:
            image: (H, W, 3), the reference's size.

        Raises:
            ValueError: another size.
        """
        return self.map(image).mean()

    def map(self, image: torch.Tensor) -> torch.Tensor:
        """(H - 10, W - 10, 3) SSIM around each pixel whose window lies inside the image, by channel."""
        if image.shape != self.shape:
            raise ValueError(f"image must have the reference's shape {tuple(self.shape)}, not {tuple(image.shape)}")
        return _SsimMap.apply(_planes(image), self._pixels, self._mean, self._variance, self._band).permute(1, 2, 0)


class _SsimMap(torch.autograd.Function):
    """(3, H - 10, W - 10) SSIM of planes, with its derivative in closed form: three blurs each way, no tape between."""

    @staticmethod
    def forward(
        ctx: object, image: torch.Tensor, pixels: torch.Tensor, mean_r: torch.Tensor, var_r: torch.Tensor, band: torch.Tensor
    ) -> torch.Tensor:
        mean, square, product = _blurred(torch.cat([image, image**2, image * pixels]), band).view(3, *mean_r.shape)
        luminance = 2 * mean * mean_r + C1
        contrast = 2 * (product - mean * mean_r) + C2
        power = mean**2 + mean_r**2 + C1
        spread = square - mean**2 + var_r + C2
        ssim = luminance * contrast / (power * spread)
        ctx.save_for_backward(image, pixels, mean, mean_r, contrast, luminance, power, spread, ssim, band)
        return ssim

    @staticmethod
    def backward(ctx: object, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        image, pixels, mean, mean_r, contrast, luminance, power, spread, ssim, band = ctx.saved_tensors
        by_covariance = 2 * grad * luminance / (power * spread)
        by_variance = -grad * ssim / spread
        by_mean = 2 * grad * (mean_r * contrast / spread - mean * ssim) / power
        by_mean = by_mean - 2 * mean * by_variance - mean_r * by_covariance
        # The window is symmetric: the blur's adjoint is the blur of the zero-padded gradient.
        padded = torch.nn.functional.pad(torch.cat([by_mean, by_variance, by_covariance]), (2 * RADIUS,) * 4)
        mean_back, square_back, product_back = _blurred(padded, band).view(3, *image.shape)
        return mean_back + 2 * image * square_back + pixels * product_back, None, None, None, None


def _planes(image: torch.Tensor) -> torch.Tensor:
    """(3, H, W) contiguous channels of (H, W, 3)."""
    return image.permute(2, 0, 1).contiguous()


def _band(like: torch.Tensor) -> torch.Tensor:
    """(BLOCK, BLOCK + 10): row i weights the inputs i..i+10 by the normalised Gaussian."""
    x = torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float64)
    window = torch.exp(-(x**2) / (2 * SIGMA**2))
    band = torch.zeros(BLOCK, BLOCK + 2 * RADIUS, dtype=torch.float64)
    for row in range(BLOCK):
        band[row, row : row + len(x)] = window / window.sum()
    return band.to(like)


def _blurred(planes: torch.Tensor, band: torch.Tensor) -> torch.Tensor:
    """(P, H - 10, W - 10) Gaussian means of (P, H, W): down the columns, then along the rows."""
    count, height, width = planes.shape
    rows = planes.new_empty(count, height - 2 * RADIUS, width)
    for start in range(0, rows.shape[1], BLOCK):
        n = min(BLOCK, rows.shape[1] - start)
        rows[:, start : start + n] = band[:n, : n + 2 * RADIUS] @ planes[:, start : start + n + 2 * RADIUS]
    rows = rows.view(-1, width)  # one product over all planes
    result = planes.new_empty(len(rows), width - 2 * RADIUS)
    for start in range(0, result.shape[1], BLOCK):
        n = min(BLOCK, result.shape[1] - start)
        result[:, start : start + n] = rows[:, start : start + n + 2 * RADIUS] @ band[:n, : n + 2 * RADIUS].T
    return result.view(count, -1, width - 2 * RADIUS)
