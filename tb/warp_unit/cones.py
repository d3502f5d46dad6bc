"""The pair "cones" from Middlebury (Scharstein and Szeliski 2003). The left photograph is the source eye's frame, with its true
disparities; the right photograph, taken from the other eye, shows how accurate the warped one is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from golden.metrics.image import psnr_vs
from golden.scenes.captured import captured_path
from spec.config import AcceleratorConfig
from spec.memory import display_pixel, frame_pixel
from spec.packing import unpack
from spec.stereo import DISPARITY_FRAC, background_transmittance, disparity_drop
from tb.vrc_array.pixel_writer_stimuli import memory_of
from tb.warp_unit.stimuli import Source

_QUARTERS = 4
"""The disparity maps are in quarters of a pixel; 0 stands for an unknown disparity."""

_SCALE = 80_000
"""The setting `disparity_scale`. With it, depths represent all known disparities to within 1/128 pixel."""


def cones_folder() -> Path | None:
    """The folder of the image pair; None where it is missing."""
    return captured_path("cones")


def photographs(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """The photographs of the left and of the right eye, each (375, 450, 3) uint8."""
    left, right = (np.asarray(Image.open(folder / name))[..., :3] for name in ("im2.png", "im6.png"))
    return left, right


def cones(config: AcceleratorConfig, folder: Path) -> Source:
    """The left photograph as opaque pixels. Pixels of unknown disparity have so little coverage that they are not warped."""
    n, (left, _) = config.formats, photographs(folder)
    known = np.asarray(Image.open(folder / "disp2.pgm")).astype(np.int64)
    pixels = np.zeros(known.shape, frame_pixel(config).dtype)
    pixels["colour"] = np.round(left / 255.0 * (1 << n.accumulator.frac_bits))
    pixels["transmittance"] = np.where(known > 0, 0, background_transmittance(n) - 1)
    disparity = np.maximum(known, 1) * ((1 << DISPARITY_FRAC) // _QUARTERS)
    pixels["depth"] = np.where(known > 0, np.round((_SCALE * n.transmittance.raw_max >> disparity_drop(n)) / disparity), 0)
    return Source(pixels, _SCALE)


def psnr_of_cones(config: AcceleratorConfig, folder: Path, writes: np.ndarray, base: int) -> dict[str, float]:
    """How close the frame that the unit wrote comes to the right photograph, and how close the left photograph itself comes.

    Args:
        config, folder: the arguments of `cones`.
        writes: the WriteRequest items of the whole frame.
        base: the setting `target_frame_base`.

    Returns:
        "warped_db" and "unwarped_db", the PSNR over the pixels that were warped or filled, and "share", the share of these
        pixels.
    """
    left, right = photographs(folder)
    words, _ = memory_of(writes, base, left.shape[0] * left.shape[1])
    shown = unpack(display_pixel(config), words.astype("<u4").view(np.uint8).reshape(len(words), -1))
    shown = shown.reshape(left.shape[:2])
    seen = shown["coverage"] > 0
    return {"warped_db": psnr_vs(shown["colour"][seen] / 255.0, right[seen] / 255.0),
            "unwarped_db": psnr_vs(left[seen] / 255.0, right[seen] / 255.0), "share": float(seen.mean())}
