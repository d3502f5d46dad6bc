"""Frames in the array's form, row by row, and in the memory's form, beat by beat."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.frame_memory import displayed
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, WORDS, display_pixel, frame_pixel, write_request
from spec.packing import pack
from spec.records import pixel_row


def random_pixels(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width) FramePixel records of random values that the array can give."""
    n, out = config.formats, np.zeros((height, width), frame_pixel(config).dtype)
    out["colour"] = rng.integers(0, n.accumulator.raw_max + 1, (height, width, 3))
    out["transmittance"] = rng.integers(0, n.transmittance.raw_max + 1, (height, width))
    if config.depth:
        out["depth"] = rng.integers(0, n.depth_accumulator.raw_max + 1, (height, width))
    return out


def every_value(config: AcceleratorConfig, rng: np.random.Generator) -> np.ndarray:
    """FramePixel records in which every colour channel and the transmittance take every value."""
    n = config.formats
    values = max(n.accumulator.raw_max, n.transmittance.raw_max) + 1
    out = random_pixels(config, rng, 256, -(-values // 256))
    value = np.arange(out.size).reshape(out.shape)
    for c, at in enumerate((value, value[::-1, ::-1], value[::-1])):
        out["colour"][..., c] = at % (n.accumulator.raw_max + 1)
    out["transmittance"] = value % (n.transmittance.raw_max + 1)
    return out


def rows_of(config: AcceleratorConfig, frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """PixelRow items of a frame's (height, width) FramePixel records, in the array's order. Pixels outside the frame are
    random."""
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


def words_of(config: AcceleratorConfig, pixels: np.ndarray, display: bool) -> np.ndarray:
    """(N, words of a pixel) int64 words of (N,) FramePixel records, as display pixels or as whole pixels."""
    record, rows = (display_pixel(config), displayed(config, pixels)) if display else (frame_pixel(config), pixels)
    return pack(record, rows).view("<u4").astype(np.int64)


def writes_of(config: AcceleratorConfig, frame: np.ndarray, rows: np.ndarray, base: int, display: bool = False) -> np.ndarray:
    """(N,) WriteRequest items of a frame's FramePixel records, in the order of its rows."""
    height, width = frame.shape
    words = words_of(config, frame.reshape(-1), display)
    size, lanes = words.shape[1], np.arange(words.shape[1])
    y = (rows["tile_y"].astype(np.int64) * TILE + rows["row"])[:, None]
    x = (rows["tile_x"].astype(np.int64) * TILE + rows["column"])[:, None] + np.arange(config.cores_x)
    row, lane = np.nonzero((x < width) & (y < height))
    pixel = y[row, 0] * width + x[row, lane]
    beats, which = np.unique(np.stack([row, pixel * size // WORDS]), axis=1, return_inverse=True)
    out = np.zeros(beats.shape[1], write_request(config).dtype)
    place = pixel * size % WORDS
    word = np.zeros((len(out), WORDS), np.int64)
    word[which[:, None], place[:, None] + lanes] = words[pixel]
    np.bitwise_or.at(out["strobe"], which, ((1 << size) - 1 << place).astype(out["strobe"].dtype))
    out["beat"], out["word"] = (base + beats[1]) % (1 << BEAT_BITS), word
    return out


def memory_of(writes: np.ndarray, base: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The (size,) words that `writes` leave from beat `base` on, and (size,) how often each was written.

    Raises:
        ValueError: a word is written at another place.
    """
    words, times = np.zeros(size, np.int64), np.zeros(size, np.int64)
    place = (writes["beat"].astype(np.int64) - base)[:, None] % (1 << BEAT_BITS) * WORDS + np.arange(WORDS)
    written = (writes["strobe"][:, None] >> np.arange(WORDS) & 1).astype(bool)
    if written.any() and place[written].max() >= size:
        raise ValueError(f"words must be written in the frame's {size}, not at {int(place[written].max())!r}")
    words[place[written]] = writes["word"][written]
    np.add.at(times, place[written], 1)
    return words, times
