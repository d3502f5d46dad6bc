"""Packs frames in the format for displays as the machine does (`spec.packed`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.host.packed_frame import block_checks, by_block, in_frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES
from spec.packed import (
    ALL_PLANES,
    BLOCK_GROUPS,
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    BLOCKS,
    CHANNELS,
    CHECK_BITS,
    CODE_BITS,
    ENTRIES,
    ENTRY_BITS,
    GROUP,
    HEADER_BYTES,
    PLANES,
    PLANES_MOST,
    SLOT_BEATS,
    packed_beats,
)

_NEEDED = np.array([ALL_PLANES if value > 31 else value and value.bit_length() + 1 for value in range(128)], np.uint8)
"""The code of a group whose differences, of which negative ones are inverted, combine to a value by or; 0 also stands for a
group of -1 and 0, which needs a plane."""


@dataclass(frozen=True)
class PackedFrame:
    """A packed frame.

    Attributes:
        width, height: its size in pixels.
        sizes: (blocks,) int64 beats of each block; 0 outside the frame.
        checks: (blocks,) int64 check of each block.
        slots: (blocks, SLOT_BEATS, BEAT_BYTES) uint8; 0 in the beats that are not written.
    """

    width: int
    height: int
    sizes: np.ndarray
    checks: np.ndarray
    slots: np.ndarray

    def entries(self) -> np.ndarray:
        """(blocks,) int64 PackedEntry patterns."""
        return self.sizes | self.checks << ENTRY_BITS - CHECK_BITS

    def table(self) -> np.ndarray:
        """(beats, BEAT_BYTES) uint8: the table, 0 behind its last entry."""
        entries = np.zeros(-(-len(self.sizes) // ENTRIES) * ENTRIES, "<u2")
        entries[: len(self.sizes)] = self.entries()
        return entries.view(np.uint8).reshape(-1, BEAT_BYTES)

    def region(self) -> np.ndarray:
        """(beats, BEAT_BYTES) uint8: the frame's region in a memory that was 0 before."""
        return np.concatenate([self.slots.reshape(-1, BEAT_BYTES), self.table()])

    @property
    def moved_beats(self) -> int:
        """Beats that are written, and read by a display: those of the blocks, and the table once."""
        return int(self.sizes.sum()) + packed_beats(self.width, self.height) - SLOT_BEATS * len(self.sizes)


def display_bytes(pixels: np.ndarray) -> np.ndarray:
    """(..., CHANNELS) uint8, r, g, b, coverage, of DisplayPixel records."""
    return np.concatenate([pixels["colour"], pixels["coverage"][..., None]], axis=-1).astype(np.uint8)


def differences(pixels: np.ndarray) -> np.ndarray:
    """(blocks, BLOCK_HEIGHT, BLOCK_WIDTH, CHANNELS) uint8: the differences of a (height, width, CHANNELS) uint8 frame."""
    height, width = pixels.shape[:2]
    whole = np.zeros((-(-height // TILE) * TILE, -(-width // TILE) * TILE, CHANNELS), np.uint8)
    whole[:height, :width] = pixels
    blocks = by_block(whole)
    blocks[..., 0] -= blocks[..., 1]
    blocks[..., 2] -= blocks[..., 1]
    for axis in (1, 2):
        blocks = np.diff(blocks, axis=axis, prepend=np.uint8(0))
    blocks[~in_frame(width, height)] = 0
    return blocks


def pack_frame(pixels: np.ndarray) -> PackedFrame:
    """Packs a frame.

    Args:
        pixels: (height, width, CHANNELS) uint8: r, g, b, coverage.
    """
    height, width = pixels.shape[:2]
    found = differences(pixels)
    count = len(found)
    first = found[:, 0, 0].copy()
    rest = found.copy()
    rest[:, 0, 0] = 0
    codes = _codes(_groups(rest))
    planes = np.where(codes == ALL_PLANES, PLANES, codes).astype(np.int64)
    total = planes.sum(axis=1)
    plain = total > PLANES_MOST
    rest[plain, 0, 0] = first[plain]
    planes[plain] = PLANES
    content = np.zeros((count, HEADER_BYTES + BLOCK_GROUPS * PLANES), np.uint8)
    content[:, :CHANNELS] = first
    bits = (codes[..., None] >> np.arange(CODE_BITS, dtype=np.uint8) & 1).reshape(count, -1)
    content[:, CHANNELS:HEADER_BYTES] = np.packbits(bits, axis=1, bitorder="little")
    content[:, HEADER_BYTES:] = _planes(_groups(rest)).reshape(count, -1)
    kept = np.ones(content.shape, bool)
    kept[plain, :HEADER_BYTES] = False
    kept[:, HEADER_BYTES:] = (np.arange(PLANES) < planes[..., None]).reshape(count, -1)
    slots = np.zeros((count, SLOT_BEATS * BEAT_BYTES), np.uint8)
    slots[np.arange(slots.shape[1]) < kept.sum(axis=1)[:, None]] = content[kept]  # both go block by block, byte by byte
    inside = in_frame(width, height).any(axis=(1, 2))
    slots[~inside] = 0
    sizes = np.where(plain, SLOT_BEATS, -(-(HEADER_BYTES + total) // BEAT_BYTES)) * inside
    return PackedFrame(width, height, sizes, block_checks(slots, sizes), slots.reshape(count, SLOT_BEATS, BEAT_BYTES))


def table_writes(tiles: np.ndarray, eyes: np.ndarray | int = 0) -> int:
    """Beats of the tables that the machine writes if the tiles of a frame, (tiles,) numbers, are packed in this order. Tiles
    that follow each other share a write where their entries lie in the same beat of the same table; `eyes`, (tiles,), are those
    of the tiles in joint frames."""
    beats = np.asarray(tiles) // (ENTRIES // BLOCKS)
    of = np.broadcast_to(eyes, beats.shape)
    return int(np.count_nonzero((np.diff(beats) != 0) | (np.diff(of) != 0))) + 1


def _groups(blocks: np.ndarray) -> np.ndarray:
    """(blocks, BLOCK_GROUPS, GROUP) uint8: differences by group."""
    halves = blocks.reshape(-1, BLOCK_HEIGHT, BLOCK_WIDTH // GROUP, GROUP, CHANNELS)
    return np.ascontiguousarray(halves.swapaxes(3, 4)).reshape(-1, BLOCK_GROUPS, GROUP)


def _codes(groups: np.ndarray) -> np.ndarray:
    """(blocks, BLOCK_GROUPS) uint8: the code of each group."""
    magnitude = np.where(groups > 127, ~groups, groups)  # a difference and its inverse need as many bits
    codes = _NEEDED[np.bitwise_or.reduce(magnitude, axis=2)]
    return np.where((codes == 0) & groups.any(axis=2), np.uint8(1), codes)


def _planes(groups: np.ndarray) -> np.ndarray:
    """(blocks, BLOCK_GROUPS, PLANES) uint8: the planes of each group, all of them."""
    bits = np.unpackbits(groups[..., None], axis=-1, bitorder="little")
    return np.packbits(bits.swapaxes(2, 3), axis=-1, bitorder="little")[..., 0]
