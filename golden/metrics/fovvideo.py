"""FovVideoVDP (Mantiuk et al. 2021): an independent judge of foveated pictures, in just-objectionable-differences.

It needs the package `pyfvvdp`, whose licence (CC BY-NC 4.0) forbids commercial use, so no set of packages brings it by default.
"""

from __future__ import annotations

import torch

from spec.constants import DISPLAY_FOV_DEG
from spec.errors import InputError
from spec.extras import how_to_get

PEAK_CD_M2 = 100.0
"""Peak luminance of the display, as of a headset's."""

BEST_JOD = 10.0
"""The score of a picture that nobody tells from its reference; one JOD less is told by 75 % of the observers."""


class FovVideoVdp:
    """The score of a still picture against its reference, higher is better, at most BEST_JOD. sRGB, without ambient light."""

    def __init__(self, size: tuple[int, int], fov_deg: float = DISPLAY_FOV_DEG) -> None:
        """Prepares the display.

        Args:
            size: (width, height) of the pictures in pixels.
            fov_deg: angle that their width spans at the eye, in degrees.

        Raises:
            InputError: the package is not installed.
        """
        try:
            from pyfvvdp import fvvdp
            from pyfvvdp.fvvdp_display_model import fvvdp_display_geometry, fvvdp_display_photo_eotf
        except ImportError as error:
            raise InputError(f"FovVideoVDP needs the package pyfvvdp ({error}), whose licence CC BY-NC 4.0 forbids commercial "
                             f"use; {how_to_get('pyfvvdp')}") from error
        self.size = tuple(size)
        self._metric = fvvdp(
            display_photometry=fvvdp_display_photo_eotf(PEAK_CD_M2), display_geometry=fvvdp_display_geometry(
                self.size, fov_horizontal=fov_deg), foveated=True, quiet=True, device=torch.device("cpu"))

    def __call__(self, image: torch.Tensor, reference: torch.Tensor, gaze: tuple[float, float]) -> float:
        """The score in JOD.

        Args:
            image, reference: (H, W, 3) floats in 0..1, display values.
            gaze: x and y in pixels of the picture; it may lie outside, for a picture that is seen from the corner of the eye.

        Raises:
            ValueError: a picture has another size.
        """
        width, height = self.size
        for picture in (image, reference):
            if tuple(picture.shape) != (height, width, 3):
                raise ValueError(f"pictures must be {(height, width, 3)}, not {tuple(picture.shape)}")
        pair = [picture.detach().float().cpu() for picture in (image, reference)]
        with torch.no_grad():
            score, _ = self._metric.predict(*pair, dim_order="HWC", fixation_point=torch.tensor(gaze))
        return float(score)
