"""HVSQ of a pair of frames: the mean of both eyes', each judged at its own gaze (the source's section on thresholds)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from golden.metrics.hvsq import Hvsq, foveated
from golden.scenes.gaze import Display
from spec.constants import DISPLAY_FOV_DEG

EyePair = tuple[np.ndarray, np.ndarray]
"""Frames of two eyes: (H, W, 3) uint8, or floats of range 1."""


@dataclass(frozen=True)
class BinocularHvsq:
    """HVSQ of each eye and their mean; lower is better."""

    eyes: tuple[float, float]

    @property
    def mean(self) -> float:
        """Of both eyes."""
        return sum(self.eyes) / len(self.eyes)


class BinocularReference:
    """Two reference frames and gazes, to which any number of pairs is compared."""

    def __init__(self, references: EyePair, gazes: tuple[tuple[float, float], tuple[float, float]],
                 fov_deg: float = DISPLAY_FOV_DEG) -> None:
        """Prepare both eyes' statistics.

        Args:
            references: frames of the two eyes, in any order, the same everywhere.
            gazes: where each looks, pixels.
            fov_deg: of the display.

        Raises:
            ValueError: not such frames.
            InputError: a gaze off its frame.
        """
        self._eyes: list[Hvsq] = []
        for reference, gaze in zip(references, gazes, strict=True):
            height, width = reference.shape[:2]
            eccentricity = Display(width, height, fov_deg).eccentricity(gaze)
            self._eyes.append(foveated(_tensor(reference), eccentricity, fov_deg))

    def __call__(self, images: EyePair) -> BinocularHvsq:
        """HVSQ of a pair, in the references' order."""
        with torch.no_grad():
            return BinocularHvsq(tuple(float(eye(_tensor(image))) for eye, image in zip(self._eyes, images, strict=True)))


def _tensor(image: np.ndarray) -> torch.Tensor:
    values = image / np.float32(255) if image.dtype == np.uint8 else image
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
