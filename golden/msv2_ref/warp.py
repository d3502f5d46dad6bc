"""The warp unit: the source eye's pixels to strips of the target eye's frame, as docs/stereo.md defines it.

Everything is an integer. The steps are `warp_pixels` (disparity and target column), `scatter` (the nearest pixel wins) and
`fill` (holes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.kernels import compiled
from golden.msv2_ref.frame_memory import displayed
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import display_pixel
from spec.stereo import (
    DISPARITY_FRAC,
    FILL_NEIGHBOURS,
    background_transmittance,
    disparity,
    disparity_drop,
    reach,
    warped_transmittance,
)

HOLE, WARPED, BACKGROUND, FILLED = range(4)
"""Where a pixel of the warped frame comes from."""

_STRIP = [("colour", np.int16, 3), ("key", np.int32)]
MOVED_PIXEL = np.dtype([("x", np.int16), ("row", np.int16), *_STRIP, ("keep", np.int16)])
"""A pixel of the source eye's frame on its way into the target's. `x` is its column in the target, 0 where nothing is kept;
`row` its row inside the strip; `colour` is r, g, b as in DisplayPixel; `key` is 0 for background and otherwise the raw
disparity + 1, so that a larger key is nearer; `keep` says that the pixel moves by `reach` at most and stays in the frame."""

STRIP_PIXEL = np.dtype([*_STRIP, ("valid", np.int16)])
"""A pixel of a strip, which is 16 rows of the target eye's frame: colour and key as in MOVED_PIXEL, and whether a pixel was
warped here; where none was, the rest means nothing."""


@dataclass(frozen=True)
class WarpedFrame:
    """The result of the warp unit for a whole frame.

    Attributes:
        moved: (H, W) MOVED_PIXEL records of the source's pixels.
        strips: (H, W) STRIP_PIXEL records of the target before its holes are filled.
        pixels: (H, W) DisplayPixel records of the target: the strips with holes filled; all 0 where a hole is left.
        origin: (H, W) uint8 of the target: HOLE, WARPED, BACKGROUND or FILLED.
        invalid: (tiles,) bool: whether a hole is left in the tile.
    """

    moved: np.ndarray
    strips: np.ndarray
    pixels: np.ndarray
    origin: np.ndarray
    invalid: np.ndarray

    @property
    def events(self) -> dict[str, int]:
        """The unit's counts for the frame, by the names of `spec.registers.STEREO_EVENTS`."""
        return {"warped": int((self.strips["valid"] == 1).sum()), "filled": int((self.origin == FILLED).sum()),
                "invalid_tiles": int(self.invalid.sum())}


def raw_disparity(config: AcceleratorConfig, transmittance: np.ndarray, depth: np.ndarray, scale: int) -> np.ndarray:
    """int64 raw `disparity` of raw transmittances and depth sums of the same shape: floor(S w / d).

    It saturates at the largest number of the format, also where d is 0.
    """
    weight = config.formats.transmittance.raw_max - transmittance.astype(np.int64)  # sum of the pixel's weights
    most = disparity(config).raw_max
    numerator = scale * weight >> disparity_drop(config.formats)
    return np.where(depth > 0, np.minimum(numerator // np.maximum(depth.astype(np.int64), 1), most), most)


def warp_pixels(config: AcceleratorConfig, pixels: np.ndarray, scale: int, source_right: bool) -> np.ndarray:
    """(H, W) MOVED_PIXEL records: where each pixel of the source goes.

    Args:
        config: the machine.
        pixels: (H, W) FramePixel records of the source eye.
        scale: the setting `disparity_scale`.
        source_right: whether the source is the right eye.
    """
    width, t = pixels.shape[1], pixels["transmittance"]
    background, solid = t >= background_transmittance(config.formats), t <= warped_transmittance(config)
    raw = raw_disparity(config, t, pixels["depth"], scale)
    shift = (raw if source_right else -raw) + (1 << DISPARITY_FRAC - 1) >> DISPARITY_FRAC
    shift = np.where(background, 0, shift)
    x = np.arange(width) + shift
    out = np.zeros(pixels.shape, MOVED_PIXEL)
    keep = (background | solid) & (np.abs(shift) <= reach(config)) & (x >= 0) & (x < width)
    out["keep"], out["x"] = keep, np.where(keep, x, 0)
    out["row"] = np.arange(pixels.shape[0])[:, None] % TILE
    out["colour"] = np.where(keep[..., None], displayed(config, pixels)["colour"], 0)
    out["key"] = np.where(keep & ~background, raw + 1, 0)
    return out


@compiled
def _scatter(x, key, keep, source):
    """Finds the column of the source pixel that each target pixel shows; -1 for none.

    Pixels with equal keys move by the same distance, so they never meet at one target pixel.
    """
    for row in range(x.shape[0]):
        for column in range(x.shape[1]):
            if keep[row, column]:
                to = x[row, column]
                old = source[row, to]
                if old < 0 or key[row, column] > key[row, old]:
                    source[row, to] = column


def scatter(moved: np.ndarray) -> np.ndarray:
    """(H, W) STRIP_PIXEL records of (H, W) MOVED_PIXEL records: each place keeps the pixel with the largest key."""
    source = np.full(moved.shape, -1, np.int64)
    columns = (np.ascontiguousarray(moved[name], np.int64) for name in ("x", "key", "keep"))
    _scatter(*columns, source)
    out = np.zeros(moved.shape, STRIP_PIXEL)
    valid = source >= 0
    rows = np.nonzero(valid)[0]
    out["colour"][valid], out["key"][valid] = moved["colour"][rows, source[valid]], moved["key"][rows, source[valid]]
    out["valid"] = valid
    return out


@compiled
def _fill(colour, valid, filled, majority):
    """Fills holes in `colour` from those of their neighbours that are `valid`, and marks them in `filled`."""
    height, width = valid.shape
    around = np.empty((3, 8), np.int64)
    for y in range(height):
        strip = y // TILE * TILE
        for x in range(width):
            if valid[y, x]:
                continue
            count, exist = 0, -1  # the hole itself is no neighbour
            for row in range(max(y - 1, strip), min(y + 2, strip + TILE, height)):
                for column in range(max(x - 1, 0), min(x + 2, width)):
                    exist += 1
                    if valid[row, column]:
                        for channel in range(3):
                            around[channel, count] = colour[row, column, channel]
                        count += 1
            if (2 * count > exist) if majority else (count >= FILL_NEIGHBOURS):
                for channel in range(3):
                    colour[y, x, channel] = np.sort(around[channel, :count])[(count - 1) // 2]
                filled[y, x] = True


def fill(config: AcceleratorConfig, strips: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fills each hole that has enough valid neighbours in its strip (`warp_fill` says how many) with their lower-middle median.

    Args:
        config: the machine.
        strips: (H, W) STRIP_PIXEL records.

    Returns:
        pixels, origin and invalid: see `WarpedFrame`.
    """
    valid, colour = strips["valid"] == 1, np.ascontiguousarray(strips["colour"], np.int64)
    colour[~valid] = 0
    filled = np.zeros(valid.shape, bool)
    _fill(colour, valid, filled, config.warp_fill == "majority")
    background = valid & (strips["key"] == 0)
    out = np.zeros(strips.shape, display_pixel(config).dtype)
    out["colour"] = colour
    out["coverage"] = np.where((valid & ~background) | filled, 255, 0)
    origin = np.select([filled, background, valid], [FILLED, BACKGROUND, WARPED], HOLE).astype(np.uint8)
    return out, origin, tiles_with(~valid & ~filled)


def tiles_with(mask: np.ndarray) -> np.ndarray:
    """(tiles,) bool, row-major: whether some pixel of the tile is marked."""
    for axis in (0, 1):
        mask = np.logical_or.reduceat(mask, np.arange(0, mask.shape[axis], TILE), axis=axis)
    return mask.reshape(-1)


def warp(config: AcceleratorConfig, pixels: np.ndarray, scale: int, source_right: bool) -> WarpedFrame:
    """Runs the unit on a whole frame; the arguments are those of `warp_pixels`."""
    moved = warp_pixels(config, pixels, scale, source_right)
    strips = scatter(moved)
    return WarpedFrame(moved, strips, *fill(config, strips))
