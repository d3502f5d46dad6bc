"""Frames as the array gives them, row by row, and as memory gets them, beat by beat."""

from __future__ import annotations

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, PIXEL_BYTES, WORDS, frame_pixel, write_request
from spec.records import pixel_row
from tb.common import codec

_PIXEL_WORDS = PIXEL_BYTES // 4


def random_pixels(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width) FramePixel records of any values that the array can give."""
    n, out = config.formats, np.zeros((height, width), frame_pixel(config).dtype)
    out["colour"] = rng.integers(0, n.accumulator.raw_max + 1, (height, width, 3))
    out["transmittance"] = rng.integers(0, n.transmittance.raw_max + 1, (height, width))
    if config.depth:
        out["depth"] = rng.integers(0, n.depth_accumulator.raw_max + 1, (height, width))
    return out


def rows_of(config: AcceleratorConfig, frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """PixelRow items of a frame's (height, width) FramePixel records, in the array's order; anything outside the frame."""
    height, width = frame.shape
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    whole = random_pixels(config, rng, tiles_x * TILE, tiles_y * TILE)
    whole[:height, :width] = frame
    grid = np.indices((tiles_y, tiles_x, TILE // config.cores_y, TILE // config.cores_x, config.cores_y)).reshape(5, -1)
    tile_y, tile_x, block_y, block_x, row = grid
    row, column = block_y * config.cores_y + row, block_x * config.cores_x
    pixels = whole[(tile_y * TILE + row)[:, None], (tile_x * TILE + column)[:, None] + np.arange(config.cores_x)]
    out = np.zeros(len(row), pixel_row(config).dtype)
    out["tile_x"], out["tile_y"], out["row"], out["column"] = tile_x, tile_y, row, column
    out["colour"] = pixels["colour"].reshape(len(row), -1)
    out["depth"], out["transmittance"] = pixels["depth"], pixels["transmittance"]
    return out


def writes_of(config: AcceleratorConfig, frame: np.ndarray, rows: np.ndarray, base: int) -> np.ndarray:
    """(N,) WriteRequest items of a frame's FramePixel records, in the order of its rows."""
    height, width = frame.shape
    words = codec.encode(frame_pixel(config), frame.reshape(-1)).view("<u4").astype(np.int64)
    y = (rows["tile_y"].astype(np.int64) * TILE + rows["row"])[:, None]
    x = (rows["tile_x"].astype(np.int64) * TILE + rows["column"])[:, None] + np.arange(config.cores_x)
    row, lane = np.nonzero((x < width) & (y < height))
    pixel = y[row, 0] * width + x[row, lane]
    beats, which = np.unique(np.stack([row, pixel // 2]), axis=1, return_inverse=True)
    out = np.zeros(beats.shape[1], write_request(config).dtype)
    place = pixel % 2 * _PIXEL_WORDS
    word = np.zeros((len(out), WORDS), np.int64)
    word[which[:, None], place[:, None] + np.arange(_PIXEL_WORDS)] = words[pixel]
    np.bitwise_or.at(out["strobe"], which, ((1 << _PIXEL_WORDS) - 1 << place).astype(out["strobe"].dtype))
    out["beat"], out["word"] = (base + beats[1]) % (1 << BEAT_BITS), word
    return out


def memory_of(config: AcceleratorConfig, writes: np.ndarray, base: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(size, 4) words of the pixels that writes leave behind `base`, and (size,) how often each was written."""
    words, times = np.zeros((2 * size + 2, _PIXEL_WORDS), np.int64), np.zeros(2 * size + 2, np.int64)
    place = (writes["beat"].astype(np.int64) - base) % (1 << BEAT_BITS)
    for half in (0, 1):
        strobes = writes["strobe"] >> half * _PIXEL_WORDS & (1 << _PIXEL_WORDS) - 1
        if not np.isin(strobes, (0, (1 << _PIXEL_WORDS) - 1)).all():
            raise ValueError("a pixel must be written as a whole or not at all")
        which = strobes != 0
        words[2 * place[which] + half] = writes["word"][which, half * _PIXEL_WORDS : (half + 1) * _PIXEL_WORDS]
        np.add.at(times, 2 * place[which] + half, 1)
    return words[:size], times[:size]
