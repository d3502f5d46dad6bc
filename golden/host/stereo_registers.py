"""The host's side of a frame of two eyes: what it writes in addition to the source eye's registers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters
from golden.scenes.gaze import FoveationMap
from golden.scenes.stereo import StereoPair
from spec.config import AcceleratorConfig
from spec.errors import InputError
from spec.formats import Rounding
from spec.stereo import DISPARITY_SCALE_BITS, DISPARITY_SCALE_FRAC, reach


@dataclass(frozen=True)
class StereoRegisters:
    """What the host writes in addition to the source eye's registers.

    Attributes:
        target: the target eye's registers: those of the source with another position and another table of tiles.
        warp: (tiles,) int64, bit `warp` of each tile in the target's table.
        disparity_scale: raw disparity in pixels at the depth where depth saturates.
        source_right: whether the source is the right eye.
    """

    target: FrameRegisters
    warp: np.ndarray
    disparity_scale: int
    source_right: bool


def disparity_scale(config: AcceleratorConfig, pair: StereoPair, depth_far: float) -> int:
    """The setting `disparity_scale`: the disparity at full depth, rounded HALF_UP.

    Args:
        config: the machine.
        pair: the eyes.
        depth_far: z depth at which the source's depth saturates.

    Raises:
        InputError: the disparity exceeds what the setting holds, where that would change a pixel.
    """
    most = (1 << DISPARITY_SCALE_BITS) - 1
    pixels = float(pair.disparity(depth_far))
    scale = int(np.floor(min(np.ldexp(pixels, DISPARITY_SCALE_FRAC) + 0.5, 2.0 * most)))
    wide = min(pair.source.width, reach(config) + 1)
    if scale > most and wide > most >> DISPARITY_SCALE_FRAC:  # in narrower frames all these pixels are dropped either way
        raise InputError(f"disparities of {pixels:.4g} pixels and more in frames {pair.source.width} wide are not accepted: "
                         f"check the IPD of {pair.baseline:g} world units")
    return min(scale, most)


def target_registers(
    config: AcceleratorConfig, source: FrameRegisters, words: GaussianWords, pair: StereoPair, foveation: FoveationMap,
) -> FrameRegisters:
    """The target eye's registers: those of the source with another position and another table of tiles; the arguments are those
    of `stereo_registers`."""
    n = config.formats
    level, blend = foveation.tile_level.reshape(-1).astype(np.int64), foveation.blend.reshape(-1).astype(np.int64)
    return replace(
        source, position=n.view.round(pair.target.position - words.origin),
        header=np.stack([level, blend, (level > 0).astype(np.int64)], 1),
        plane=n.plane.quantise(foveation.plane.reshape(-1, 3), Rounding.HALF_UP))


def stereo_registers(
    config: AcceleratorConfig, source: FrameRegisters, words: GaussianWords, pair: StereoPair, foveation: FoveationMap,
    warp: np.ndarray,
) -> StereoRegisters:
    """What the host writes for the second eye; depth scale, limits and all other registers are the source's.

    Args:
        config: the machine.
        source: the source eye's registers.
        words: the DRAM image.
        pair: the eyes.
        foveation: the target eye's tile levels and planes.
        warp: (tiles_y, tiles_x) bool: whether the tile may be warped.
    """
    target = target_registers(config, source, words, pair, foveation)
    return StereoRegisters(target, warp.reshape(-1).astype(np.int64), disparity_scale(config, pair, source.depth_far),
                           pair.source_eye == "right")
