"""Frames of the source eye that cover every case of the warp, and the target eye's frames as the unit writes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.warp import WarpedFrame, raw_disparity, warp
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, WORDS, display_pixel, write_request
from spec.packing import pack
from spec.stereo import (
    DISPARITY_FRAC,
    DISPARITY_SCALE_BITS,
    background_transmittance,
    solid_transmittance,
)
from tb.vrc_array.pixel_writer_stimuli import random_pixels
from tb.warp_unit.device import warped_tile

MOST_SCALE = (1 << DISPARITY_SCALE_BITS) - 1

SCALE = 8000
"""The scale of most frames here. With it, the disparities of solid pixels range from half a pixel to beyond the frame, in steps
finer than a pixel up to 180 pixels."""


@dataclass(frozen=True)
class Source:
    """A frame to warp.

    Attributes:
        pixels: (H, W) FramePixel records.
        scale, right: the settings `disparity_scale` and `source_right`.
    """

    pixels: np.ndarray
    scale: int = SCALE
    right: bool = False

    def warped(self, config: AcceleratorConfig) -> WarpedFrame:
        """The golden renderer's warped frame."""
        return warp(config, self.pixels, self.scale, self.right)


def anything(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int, right: bool = False) -> Source:
    """Random pixels, of which most have a transmittance next to the limits of its classes. Depths are small and large, and some
    are zero."""
    n, out = config.formats, random_pixels(config, rng, width, height)
    background, solid = background_transmittance(n), solid_transmittance(n)
    edges = [0, solid, solid, solid + 1, (solid + background) // 2, background - 1, background, n.transmittance.raw_max]
    chosen = rng.random((height, width)) < 0.8
    out["transmittance"][chosen] = rng.choice(edges, (height, width))[chosen]
    out["depth"] >>= rng.integers(0, n.depth_accumulator.width + 1, (height, width)).astype(out["depth"].dtype)
    return Source(out, int(rng.choice([0, 1, SCALE, 300_000, MOST_SCALE])), right)


def placed(
    config: AcceleratorConfig, rng: np.random.Generator, disparity: np.ndarray, right: bool = False,
) -> Source:
    """Opaque pixels of random colours with approximately these disparities in pixels."""
    n = config.formats
    out = random_pixels(config, rng, *disparity.shape[::-1])
    out["transmittance"] = 0
    depth = SCALE * n.weight.raw_max / np.maximum(disparity * (1 << DISPARITY_FRAC), 1e-6)
    out["depth"] = np.clip(np.round(depth), 0, n.depth_accumulator.raw_max)
    return Source(out, SCALE, right)


def close_by(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int, right: bool = False) -> Source:
    """Opaque pixels so near, at so small a scale, that their disparities are divided by the smallest depths. These disparities
    lie at halves of a pixel or next to them."""
    n, out, half = config.formats, random_pixels(config, rng, width, height), 1 << DISPARITY_FRAC - 1
    t = rng.integers(0, solid_transmittance(n) + 1, 100 * out.size)
    depth, scale = rng.integers(1, 64, len(t)), 17
    raw = raw_disparity(config, t, depth, scale)
    chosen = np.flatnonzero((abs(raw % (2 * half) - half) <= 1) & (raw < width * half))
    chosen = rng.choice(chosen, out.shape)
    out["transmittance"], out["depth"] = t[chosen], depth[chosen]
    return Source(out, scale, right)


def many_to_one(
    config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int, right: bool, every: int = 1,
) -> Source:
    """Rows in which runs of pixels are warped to the same place, ever nearer or ever farther. With `every` 2 the pixels of a
    run go to two neighbouring places in turn."""
    x, length = np.arange(width) + np.zeros((height, 1), int), rng.integers(2, 12, (height, 1))
    start = x // length * length
    ahead = x - start if not right else start + length - 1 - x
    return placed(config, rng, (ahead // every * every) + rng.integers(0, 3, (height, 1)), right)


def with_holes(config: AcceleratorConfig, rng: np.random.Generator, valid: np.ndarray, background: float = 0.3) -> Source:
    """Pixels that stay where they are, a share of which is background, with holes where `valid` is False.

    Pixels at the holes are half transparent and have depth 0: they are not warped, or, on machines that warp such pixels, they
    leave the frame.
    """
    n = config.formats
    source = placed(config, rng, np.zeros(valid.shape))
    t = source.pixels["transmittance"]
    t[rng.random(valid.shape) < background] = n.transmittance.raw_max
    t[~valid] = (solid_transmittance(n) + background_transmittance(n)) // 2
    source.pixels["depth"][~valid] = 0
    return Source(source.pixels, 100)


def every_neighbourhood(config: AcceleratorConfig, rng: np.random.Generator) -> Source:
    """Holes with each of the 256 sets of valid neighbours, in cells of 3 x 3 pixels. In every second strip the cells are one
    row further down. Half of the frame has few colours, so that neighbours are often equal."""
    height, columns = 64, -(-256 // 5)
    valid = np.ones((height, 3 * columns), bool)
    for strip in range(height // TILE):
        for pattern, cell in enumerate(rng.permutation(256)):
            y, x = strip * TILE + strip % 2 + 3 * (cell % 5), 3 * (cell // 5)
            around = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
            valid[y + 1, x + 1] = False
            for bit, (dy, dx) in enumerate(around):
                valid[y + dy, x + dx] = pattern >> bit & 1
    source = with_holes(config, rng, valid)
    few = rng.integers(0, config.formats.accumulator.raw_max + 1, (4, 3))
    half = np.arange(height) < height // 2
    source.pixels["colour"][half] = few[rng.integers(0, 4, (height // 2, 3 * columns))]
    return source


def every_border(config: AcceleratorConfig, rng: np.random.Generator) -> Source:
    """Holes in the first and last row of a strip with each of the 32 sets of valid neighbours, in cells of 3 x 2 pixels. The
    last strip has one row."""
    height, columns = 2 * TILE + 1, 3 * 32
    valid = np.ones((height, columns), bool)
    for row, inner in ((0, 1), (TILE - 1, TILE - 2), (TILE, TILE + 1), (2 * TILE - 1, 2 * TILE - 2), (2 * TILE, None)):
        for pattern, cell in enumerate(rng.permutation(32)):
            left, x, right = range(3 * cell, 3 * cell + 3)
            around = [(row, left), (row, right), *((inner, column) for column in (left, x, right) if inner is not None)]
            valid[row, x] = False
            for bit, at in enumerate(around):
                valid[at] = pattern >> bit & 1
    return with_holes(config, rng, valid)


def traced(config: AcceleratorConfig, pixels: np.ndarray, right: bool = False) -> Source:
    """A frame of a real scene, with a scale at which the median depth is warped by 1/24 of the width."""
    n = config.formats
    solid = pixels["transmittance"] <= solid_transmittance(n)
    depth = np.median(pixels["depth"][solid]) if solid.any() else n.depth_accumulator.raw_max
    scale = pixels.shape[1] / 24 * (1 << DISPARITY_FRAC) * depth / n.weight.raw_max
    return Source(pixels, int(np.clip(scale, 1, MOST_SCALE)), right)


def writes_of(config: AcceleratorConfig, pixels: np.ndarray, base: int) -> np.ndarray:
    """(N,) WriteRequest items of (H, W) DisplayPixel records, in the order in which the unit completes beats: strip by strip,
    and within a strip column by column from the top."""
    height, width = pixels.shape
    words = pack(display_pixel(config), pixels.reshape(-1)).view("<u4")[:, 0].astype(np.int64)
    y, x = np.divmod(np.arange(height * width), width)
    starts = np.flatnonzero((x == 0) | ((y * width + x) % WORDS == 0))
    ends = np.append(starts[1:], height * width) - 1
    which = np.repeat(np.arange(len(starts)), ends - starts + 1)
    place = np.arange(height * width) % WORDS
    out = np.zeros(len(starts), write_request(config).dtype)
    word = np.zeros((len(out), WORDS), np.int64)
    word[which, place] = words
    out["beat"], out["word"] = (base + starts // WORDS) % (1 << BEAT_BITS), word
    np.bitwise_or.at(out["strobe"], which, (1 << place).astype(out["strobe"].dtype))
    return out[np.lexsort((y[ends], x[ends], y[ends] // TILE))]


def tiles_of(config: AcceleratorConfig, invalid: np.ndarray) -> np.ndarray:
    """The (tiles,) WarpedTile items of a mask."""
    out = np.zeros(len(invalid), warped_tile(config).dtype)
    out["tile"], out["invalid"] = np.arange(len(invalid)), invalid
    return out
