"""HVSQ of finished pictures by region around the gaze, with numpy arrays in and numbers out, for callers without tensors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch

from golden.metrics.hvsq import foveated


class RegionHvsq:
    """HVSQ against one reference, of the whole frame and of each ring of eccentricity; each pixel pools by its own
    eccentricity."""

    def __init__(self, reference: np.ndarray, eccentricity_deg: np.ndarray, starts_deg: Sequence[float]) -> None:
        """Prepares the reference.

        Args:
            reference: (H, W, 3) floats of range 1.
            eccentricity_deg: (H, W) degrees from the gaze.
            starts_deg: ascending starts of the rings in degrees; the last ring has no end.
        """
        ring = np.searchsorted(np.asarray(starts_deg), eccentricity_deg, side="right") - 1
        self._masks = {i: torch.from_numpy(ring == i) for i in range(len(starts_deg)) if (ring == i).any()}
        self._rings = len(starts_deg)
        self._hvsq = foveated(torch.from_numpy(np.ascontiguousarray(reference, np.float64)), eccentricity_deg)

    def __call__(self, image: np.ndarray) -> tuple[float, list[float | None]]:
        """HVSQ of the frame and of each ring; None for a ring in which the frame has no pixel.

        Args:
            image: (H, W, 3) floats, clamped to [0, 1] here.
        """
        shown = torch.from_numpy(np.clip(image, 0.0, 1.0))
        with torch.no_grad():
            values = self._hvsq.regions(shown, [torch.ones(shown.shape[:2]), *self._masks.values()]).tolist()
        rings = dict(zip(self._masks, values[1:], strict=True))
        return values[0], [rings.get(i) for i in range(self._rings)]


@cache
def _limit_threads() -> None:
    torch.set_num_threads(1)


def region_hvsq(
    image: np.ndarray, reference: np.ndarray, eccentricity_deg: np.ndarray, starts_deg: Sequence[float],
) -> tuple[float, list[float | None]]:
    """HVSQ of one picture, see `RegionHvsq`. It uses one thread, because callers run several processes side by side."""
    _limit_threads()
    return RegionHvsq(np.clip(reference, 0.0, 1.0), eccentricity_deg, starts_deg)(image)
