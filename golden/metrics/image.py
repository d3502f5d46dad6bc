"""Errors of whole images: the numbers that the field reports, and those that the golden renderer must keep."""

from __future__ import annotations

import math

import numpy as np
from skimage.metrics import structural_similarity


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB, as it is reported against photographs; inf for equal images.

    Args:
        image, reference: (H, W, 3), both uint8 (peak 255) or both float (peak 1). Values are not clamped.

    Raises:
        ValueError: shapes or dtypes differ.
    """
    peak = _peak(image, reference)
    error = np.mean((image.astype(np.float64) - reference) ** 2)
    return math.inf if error == 0 else 10 * math.log10(peak**2 / error)


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Structural similarity (Wang et al. 2004) as it is reported: scikit-image's, with that paper's 11x11 Gaussian window.

    Args:
        image, reference: (H, W, 3), at least 11x11 pixels, both uint8 (peak 255) or both float (peak 1).

    Raises:
        ValueError: shapes or dtypes differ, or the images are smaller than the window.
    """
    return float(
        structural_similarity(
            image,
            reference,
            data_range=_peak(image, reference),
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def psnr_vs(image: np.ndarray, reference: np.ndarray) -> float:
    """PSNR in dB of two float renderings as a display shows them: clamped to [0, 1], peak 1, before 8-bit rounding.

    Args:
        image, reference: (H, W, 3) floats of any range.
    """
    return psnr(np.clip(image, 0.0, 1.0), np.clip(reference, 0.0, 1.0))


def max_abs_error(image: np.ndarray, reference: np.ndarray) -> float:
    """Largest difference in any channel of any pixel after both images are clamped to [0, 1]."""
    return float(np.abs(np.clip(image, 0.0, 1.0) - np.clip(reference, 0.0, 1.0)).max())


def _peak(image: np.ndarray, reference: np.ndarray) -> float:
    """The largest value that the images' common dtype stands for."""
    if image.shape != reference.shape:
        raise ValueError(f"images must have one shape, not {image.shape!r} and {reference.shape!r}")
    floats = [np.issubdtype(a.dtype, np.floating) for a in (image, reference)]
    if all(floats):
        return 1.0
    if image.dtype == reference.dtype == np.uint8:
        return 255.0
    raise ValueError(f"images must both be uint8 or both float, not {image.dtype!r} and {reference.dtype!r}")
