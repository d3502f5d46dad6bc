"""Frames whose blocks have every size, in the array's form, and the memory writes that pack them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from golden.msv2_ref.frame_memory import displayed
from golden.msv2_ref.frame_packing import PackedFrame, display_bytes, pack_frame
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, WORDS, frame_pixel, write_request
from spec.packed import BLOCK_HEIGHT, BLOCKS, ENTRIES, SLOT_BEATS
from tb.vrc_array.pixel_writer_stimuli import random_pixels

_EVERY_WORD = (1 << WORDS) - 1


def graded_pixels(
    config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int, most: float = 8.0,
) -> np.ndarray:
    """(height, width) FramePixel records on a slope, with noise that grows from left to right: of up to 2^most of the 256
    values of the format for displays. So the blocks on the left are small, and those on the right plain."""
    n, out = config.formats, random_pixels(config, rng, width, height)
    y, x = np.indices((height, width))
    amplitude = np.ceil(2 ** (most * (x + 1) / width)).astype(np.int64)
    for name, number, count in (("colour", n.accumulator, 3), ("transmittance", n.transmittance, 1)):
        slope = rng.integers(-3, 4, (2, count))
        noise = rng.integers(0, 1 << 16, (height, width, count)) % amplitude[..., None]
        values = (x[..., None] * slope[0] + y[..., None] * slope[1] + noise) % 256
        raw = np.minimum((values << number.frac_bits) // 255, number.raw_max)
        out[name] = raw if count > 1 else raw[..., 0]
    return out


def uneven_pixels(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width) FramePixel records. Each row differs from the row above in its block, the first one from a single colour,
    by nothing, a little or much, so that the rows of a block have very different sizes."""
    n, out, blocks = config.formats, random_pixels(config, rng, width, height), -(-height // BLOCK_HEIGHT)
    amplitude = rng.choice([1, 1, 2, 3, 8, 30, 60], (blocks, BLOCK_HEIGHT, 1, 1))
    for name, number, count in (("colour", n.accumulator, 3), ("transmittance", n.transmittance, 1)):
        noise = rng.integers(0, 1 << 16, (blocks, BLOCK_HEIGHT, width, count)) % amplitude
        values = (noise.cumsum(1) % 256).reshape(-1, width, count)[:height]
        raw = np.minimum((values << number.frac_bits) // 255, number.raw_max)
        out[name] = raw if count > 1 else raw[..., 0]
    return out


def half_pixels(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width) FramePixel records of half of the light and half of the coverage: ties in the format for displays."""
    n, out = config.formats, random_pixels(config, rng, width, height)
    out["colour"], out["transmittance"] = 1 << n.accumulator.frac_bits - 1, 1 << n.transmittance.frac_bits - 1
    return out


def uniform_pixels(config: AcceleratorConfig, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width) FramePixel records of one colour, whose blocks take a beat each."""
    out = np.zeros((height, width), frame_pixel(config).dtype)
    for name in ("colour", "transmittance"):
        out[name] = random_pixels(config, rng, 1, 1)[name][0, 0]
    return out


def packed_pixels(config: AcceleratorConfig, frame: np.ndarray) -> PackedFrame:
    """A frame of FramePixel records, packed."""
    return pack_frame(display_bytes(displayed(config, frame)))


def tile_order(rows: np.ndarray, columns: int) -> list[int]:
    """The numbers of the tiles of PixelRow items, in the order in which they come."""
    return list(dict.fromkeys((rows["tile_y"].astype(np.int64) * columns + rows["tile_x"]).tolist()))


def shuffled_tiles(rng: np.random.Generator, rows: np.ndarray, columns: int) -> np.ndarray:
    """The same PixelRow items with their tiles in any order."""
    number = rows["tile_y"].astype(np.int64) * columns + rows["tile_x"]
    return np.concatenate([rows[number == tile] for tile in rng.permutation(number.max() + 1)])


def packed_writes(config: AcceleratorConfig, frame: PackedFrame, tiles: list[int], base: int) -> np.ndarray:
    """(N,) WriteRequest items of a packed frame whose tiles come in this order."""
    return joint_packed_writes(config, [frame], [(0, tile) for tile in tiles], [base])


def joint_packed_writes(
    config: AcceleratorConfig, frames: Sequence[PackedFrame], tiles: list[tuple[int, int]], bases: Sequence[int],
) -> np.ndarray:
    """(N,) WriteRequest items of the packed frames of several eyes, whose tiles, given by eye and number, come in this order.

    A beat of a table follows the last of its entries, or stands before the last beat of the first block whose entry lies in
    another one, or at the end.
    """
    out: list[tuple[int, list[int], int]] = []
    arrived: set[tuple[int, int]] = set()

    def flush() -> None:
        if arrived:
            ((eye, place),) = {(eye, block // ENTRIES) for eye, block in arrived}
            entries, blocks = frames[eye].entries(), {block for _, block in arrived}
            words = [sum(int(entries[n]) << 16 * (n % 2) for n in range(2 * w, 2 * w + 2) if n in blocks)
                     for w in range(place * WORDS, (place + 1) * WORDS)]
            strobe = sum({1 << n // 2 % WORDS for n in blocks})
            out.append((bases[eye] + SLOT_BEATS * len(entries) + place, words, strobe))
            arrived.clear()

    def elsewhere(eye: int, block: int) -> bool:
        return bool(arrived) and (eye, block // ENTRIES) not in {(eye, block // ENTRIES) for eye, block in arrived}

    for eye, block in ((eye, BLOCKS * tile + part) for eye, tile in tiles for part in range(BLOCKS)):
        size = int(frames[eye].sizes[block])
        for beat in range(size):
            if beat == size - 1 and elsewhere(eye, block):
                flush()
            words = frames[eye].slots[block, beat].view("<u4").tolist()
            out.append((bases[eye] + SLOT_BEATS * block + beat, words, _EVERY_WORD))
        if not size and elsewhere(eye, block):
            flush()
        arrived.add((eye, block))
        if len(arrived) == ENTRIES:
            flush()
    assert len({*tiles}) == len(tiles)
    flush()
    rows = np.zeros(len(out), write_request(config).dtype)
    for name, column in zip(("beat", "word", "strobe"), zip(*out, strict=True), strict=True):
        rows[name] = column
    rows["beat"] %= 1 << BEAT_BITS
    return rows
