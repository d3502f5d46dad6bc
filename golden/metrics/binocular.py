"""HVSQ of a pair of frames: the mean of both eyes' HVSQ, each judged at its own gaze (as in the paper's study of
thresholds)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from golden.metrics.hvsq import Hvsq, foveated
from golden.scenes.gaze import Display
from spec.constants import DISPLAY_FOV_DEG

EyePair = tuple[np.ndarray, np.ndarray]
"""Frames of two eyes, each (H, W, 3), uint8 or floats of range 1."""


@dataclass(frozen=True)
class BinocularHvsq:
    """HVSQ of each eye and their mean; lower is better."""

    eyes: tuple[float, float]

    @property
    def mean(self) -> float:
        """The mean of both eyes' HVSQ."""
        return sum(self.eyes) / len(self.eyes)


class BinocularReference:
    """Two reference frames with their gazes, to which any number of pairs can be compared."""

    def __init__(self, references: EyePair, gazes: tuple[tuple[float, float], tuple[float, float]],
                 fov_deg: float = DISPLAY_FOV_DEG) -> None:
        """Prepares the statistics of both eyes.

        Args:
            references: frames of the two eyes; the order is free but must be the same in every call.
            gazes: (x, y) in pixels where each eye looks.
            fov_deg: angle that the display's width spans, in degrees.

        Raises:
            ValueError: the frames have the wrong shape or dtype.
            InputError: a gaze is off its frame.
        """
        self._eyes: list[Hvsq] = []
        for reference, gaze in zip(references, gazes, strict=True):
            height, width = reference.shape[:2]
            eccentricity = Display(width, height, fov_deg).eccentricity(gaze)
            self._eyes.append(foveated(_tensor(reference), eccentricity, fov_deg))

    def __call__(self, images: EyePair) -> BinocularHvsq:
        """HVSQ of a pair of frames, given in the references' order."""
        with torch.no_grad():
            return BinocularHvsq(tuple(float(eye(_tensor(image))) for eye, image in zip(self._eyes, images, strict=True)))


def _tensor(image: np.ndarray) -> torch.Tensor:
    values = image / np.float32(255) if image.dtype == np.uint8 else image
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
