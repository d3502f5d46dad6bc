"""Errors by eccentricity: how large an image's error is in each ring around the gaze."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from golden.metrics.image import max_abs_error, psnr_vs
from spec.constants import REGION_START_DEG


@dataclass(frozen=True)
class RingError:
    """The error over the pixels with start_deg <= eccentricity < end_deg.

    Attributes:
        start_deg, end_deg: degrees; the last ring ends at inf.
        pixels: number of these pixels.
        psnr_db: PSNR of the images clamped to [0, 1], peak 1; inf where they are equal, nan where the ring has no pixel.
        max_abs_error: largest difference in any channel; nan where the ring has no pixel.
    """

    start_deg: float
    end_deg: float
    pixels: int
    psnr_db: float
    max_abs_error: float


def ring_errors(
    image: np.ndarray, reference: np.ndarray, eccentricity: np.ndarray, starts_deg: Sequence[float] = REGION_START_DEG
) -> list[RingError]:
    """The error in each ring of eccentricity.

    Args:
        image, reference: (H, W, 3) floats.
        eccentricity: (H, W) degrees from the gaze, see `golden.scenes.gaze.Display.eccentricity`.
        starts_deg: ascending ring starts; each ring ends where the next starts, the last at inf.
    """
    rings = []
    for start, end in zip(starts_deg, [*starts_deg[1:], np.inf], strict=True):
        inside = (eccentricity >= start) & (eccentricity < end)
        errors = (np.nan, np.nan)
        if inside.any():
            errors = (psnr_vs(image[inside], reference[inside]), max_abs_error(image[inside], reference[inside]))
        rings.append(RingError(float(start), float(end), int(inside.sum()), *errors))
    return rings
