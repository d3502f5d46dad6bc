"""Unpacks packed frames (`spec.packed` has the format), and says which block is damaged, and how.

A frame of 1920x1080 takes a fraction of a second. examples/driver/msv2_packed.c does the same in C.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from spec.constants import TILE
from spec.errors import InputError
from spec.memory import BEAT_BYTES
from spec.packed import (
    ALL_PLANES,
    BLOCK_GROUPS,
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    BLOCKS,
    CHANNELS,
    CHECK_BITS,
    CHECK_POLYNOMIAL,
    CHECK_START,
    CODE_BITS,
    ENTRY_BITS,
    GROUP,
    HEADER_BYTES,
    PLANES,
    SLOT_BEATS,
    PackedError,
    packed_beats,
    table_beat,
)

MEANINGS = {
    PackedError.MISSING: "it was not written",
    PackedError.SIZE: "its size is impossible",
    PackedError.LENGTH: "the codes of its groups do not add up to its size",
    PackedError.CHECK: "its beats are not those that were packed",
}
"""What the errors say, in words."""

_SLOT_BYTES = SLOT_BEATS * BEAT_BYTES
_STATES = (1 << CHECK_BITS) - 1


@cache
def _check_table() -> np.ndarray:
    """(256,) uint16: the check's state after 8 bits that are 0, by the state's highest 8 bits, where the others are 0."""
    table = np.zeros(256, np.uint16)
    for value in range(256):
        state = value << CHECK_BITS - 8
        for _ in range(8):
            state = (state << 1 & _STATES) ^ (CHECK_POLYNOMIAL if state >> CHECK_BITS - 1 else 0)
        table[value] = state
    return table


def block_checks(slots: np.ndarray, sizes: np.ndarray, numbers: np.ndarray | None = None) -> np.ndarray:
    """(N,) int64: the check of each block; 0 where its size is 0.

    Args:
        slots: (N, bytes) uint8, the blocks' beats; those beyond a block's size do not matter.
        sizes: (N,) beats of each block, at most SLOT_BEATS.
        numbers: (N,) the blocks' numbers; 0, 1, ... by default.
    """
    table = _check_table()
    backward = np.array([int(f"{value:08b}"[::-1], 2) for value in range(256)], np.uint16)  # a byte's lowest bit comes first
    state = ((np.arange(len(slots)) if numbers is None else numbers) & _STATES).astype(np.uint16) ^ np.uint16(CHECK_START)
    for beat in range(int(sizes.max(initial=0))):
        rows = np.flatnonzero(sizes > beat)
        part = state[rows]
        for byte in backward[slots[rows, beat * BEAT_BYTES : (beat + 1) * BEAT_BYTES].T]:
            part = (part << 8 & _STATES) ^ table[part >> CHECK_BITS - 8 ^ byte]
        state[rows] = part
    return np.where(sizes > 0, state, 0).astype(np.int64)


def in_frame(width: int, height: int) -> np.ndarray:
    """(blocks, BLOCK_HEIGHT, BLOCK_WIDTH) bool: which pixels of each block lie in the frame."""
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    inside = np.zeros((tiles_y * TILE, tiles_x * TILE), bool)
    inside[:height, :width] = True
    return by_block(inside)


def by_block(pixels: np.ndarray) -> np.ndarray:
    """(blocks, BLOCK_HEIGHT, BLOCK_WIDTH, ...) of (rows, columns, ...), both multiples of TILE, by the blocks' numbers."""
    rows, columns = pixels.shape[0] // TILE, pixels.shape[1] // TILE
    grid = pixels.reshape(rows, BLOCKS, BLOCK_HEIGHT, columns, BLOCK_WIDTH, *pixels.shape[2:])
    return grid.transpose(0, 3, 1, 2, 4, *range(5, grid.ndim)).reshape(-1, BLOCK_HEIGHT, BLOCK_WIDTH, *pixels.shape[2:])


def _from_blocks(blocks: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width, ...) of what `by_block` gives, cut to the frame."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    grid = blocks.reshape(rows, columns, BLOCKS, BLOCK_HEIGHT, BLOCK_WIDTH, *blocks.shape[3:])
    pixels = grid.transpose(0, 2, 3, 1, 4, *range(5, grid.ndim)).reshape(rows * TILE, columns * TILE, *blocks.shape[3:])
    return pixels[:height, :width]


def _codes(slots: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """(N, BLOCK_GROUPS) int64: planes of each group by header; of a plain block PLANES of each."""
    bits = np.unpackbits(slots[:, CHANNELS:HEADER_BYTES], axis=1, bitorder="little")
    codes = bits.reshape(-1, BLOCK_GROUPS, CODE_BITS).astype(np.int64) @ (1 << np.arange(CODE_BITS))
    return np.where((codes == ALL_PLANES) | (sizes == SLOT_BEATS)[:, None], PLANES, codes)


def _differences(slots: np.ndarray, sizes: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(N, BLOCK_HEIGHT, BLOCK_WIDTH, CHANNELS) uint8: the differences of blocks of sizes 1 to SLOT_BEATS."""
    plain, count = sizes == SLOT_BEATS, len(slots)
    begin = np.where(plain, 0, HEADER_BYTES)[:, None] + np.cumsum(planes, axis=1) - planes
    kept = np.minimum(np.arange(PLANES), planes[..., None] - 1)  # planes above the highest repeat it: they have the sign
    place = begin[..., None] + np.maximum(kept, 0)
    found = slots[np.arange(count)[:, None, None], np.minimum(place, _SLOT_BYTES - 1)]
    found[planes == 0] = 0
    # eight bytes of planes become eight differences: a matrix of 8 x 8 bits is turned on its diagonal
    bits = np.unpackbits(found, axis=-1, bitorder="little").reshape(count, BLOCK_GROUPS, PLANES, GROUP)
    values = np.packbits(bits.swapaxes(2, 3), axis=-1, bitorder="little")[..., 0]
    values = values.reshape(count, BLOCK_HEIGHT, BLOCK_WIDTH // GROUP, CHANNELS, GROUP)
    out = np.ascontiguousarray(values.swapaxes(3, 4)).reshape(count, BLOCK_HEIGHT, BLOCK_WIDTH, CHANNELS)
    out[~plain, 0, 0] = slots[~plain, :CHANNELS]
    return out


def unpack_blocks(data: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixels of a frame, whatever state it is in, and what is wrong with each of its blocks.

    Args:
        data: uint8, at least the bytes of the frame's region, `spec.packed.packed_beats` beats.
        width, height: size of the frame in pixels.

    Returns:
        (height, width, CHANNELS) uint8, r, g, b, coverage, and (blocks,) int64 PackedError codes. The pixels of a block whose
        error is CHECK are what its beats say; those of blocks with other errors are 0.

    Raises:
        InputError: there are fewer bytes than the region has.
    """
    needed = BEAT_BYTES * packed_beats(width, height)
    if len(data) < needed:
        raise InputError(f"packed frame of {width}x{height} pixels is not accepted: it is cut off after {len(data):,} bytes, "
                         f"and has {needed:,}")
    table = BEAT_BYTES * table_beat(width, height)
    slots = data[:table].reshape(-1, _SLOT_BYTES)
    entries = data[table : table + len(slots) * ENTRY_BITS // 8].view("<u2").astype(np.int64)
    sizes, checks = entries & (1 << ENTRY_BITS - CHECK_BITS) - 1, entries >> ENTRY_BITS - CHECK_BITS
    inside = in_frame(width, height).any(axis=(1, 2))
    errors = np.zeros(len(slots), np.int64)
    errors[inside & (sizes == 0)] = PackedError.MISSING
    errors[(inside & (sizes > SLOT_BEATS)) | (~inside & (entries > 0))] = PackedError.SIZE
    rows = np.flatnonzero((errors == 0) & inside)
    used, size = slots[rows], sizes[rows]
    planes = _codes(used, size)
    length = np.where(size == SLOT_BEATS, SLOT_BEATS, -(-(HEADER_BYTES + planes.sum(axis=1)) // BEAT_BYTES))
    right = block_checks(used, size, rows) == checks[rows]
    errors[rows[~right]] = PackedError.CHECK
    errors[rows[length != size]] = PackedError.LENGTH
    pixels = np.zeros((len(slots), BLOCK_HEIGHT, BLOCK_WIDTH, CHANNELS), np.uint8)
    fits = length == size
    pixels[rows[fits]] = _pixels(_differences(used[fits], size[fits], planes[fits]))
    return _from_blocks(pixels, width, height), errors


def _pixels(differences: np.ndarray) -> np.ndarray:
    """(N, BLOCK_HEIGHT, BLOCK_WIDTH, CHANNELS) uint8: pixels from their differences, modulo 256."""
    pixels = np.cumsum(np.cumsum(differences, axis=1, dtype=np.uint8), axis=2, dtype=np.uint8)
    pixels[..., 0] += pixels[..., 1]
    pixels[..., 2] += pixels[..., 1]
    return pixels


def unpack_frame(data: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width, CHANNELS) uint8, r, g, b, coverage: the pixels of a packed frame; arguments as `unpack_blocks`.

    Raises:
        InputError: the frame is cut off or damaged; the message names the first damaged block, and what is wrong with it.
    """
    pixels, errors = unpack_blocks(data, width, height)
    wrong = np.flatnonzero(errors)
    if len(wrong):
        error = PackedError(int(errors[wrong[0]]))
        raise InputError(f"packed frame of {width}x{height} pixels is not accepted: {_place(int(wrong[0]), width)}: "
                         f"{error.name}, {MEANINGS[error]}; {len(wrong)} of {len(errors)} blocks are damaged")
    return pixels


def _place(block: int, width: int) -> str:
    """Where a block is, in words."""
    tile, part = divmod(block, BLOCKS)
    y, x = divmod(tile, -(-width // TILE))
    x, y = x * TILE, y * TILE + part * BLOCK_HEIGHT
    return f"block {block} (columns {x} to {x + BLOCK_WIDTH - 1}, rows {y} to {y + BLOCK_HEIGHT - 1})"
