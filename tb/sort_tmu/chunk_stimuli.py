"""Stimuli of the sorters: chunks of intersections by hand, at random and from scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.config import AcceleratorConfig
from spec.records import INDEX_BITS, Field, chunk_item, frame_lists, intersection

ORDERS = ("random", "ties", "sorted", "reversed", "equal", "zigzag")
"""The orders in which the intersections of a chunk may arrive."""


def items_of(config: AcceleratorConfig, chunks: Iterable[np.ndarray]) -> np.ndarray:
    """ChunkItem items of chunks, each an (N, 3) array of tile, depth key and index. N may be 0."""
    parts = []
    for chunk in chunks:
        part = np.zeros(max(len(chunk), 1), chunk_item(config).dtype)
        if len(chunk):
            part["tile"], part["depth_key"], part["index"] = chunk.T
        part["empty"], part["last"][-1] = not len(chunk), 1
        parts.append(part)
    return np.concatenate(parts)


def random_chunk(config: AcceleratorConfig, rng: np.random.Generator, count: int, order: str, tiles: int = 5) -> np.ndarray:
    """(count, 3) intersections of up to `tiles` neighbouring tiles, in one of ORDERS. No two have the same tile and index,
    except in the order "equal"."""
    keys = 2 if order == "ties" else config.formats.depth_key.raw_max + 1
    tile = rng.integers(frame_lists(config)) + rng.integers(0, tiles, count)
    index = rng.choice(1 << INDEX_BITS - 6, count, replace=False) * 64 + rng.integers(0, 64, count)
    chunk = np.stack([np.minimum(tile, frame_lists(config) - 1), rng.integers(0, keys, count), index], 1)
    if order == "equal":
        chunk[:] = chunk[:1]
    if order in ("sorted", "reversed", "zigzag"):
        chunk = chunk[np.lexsort(chunk.T[::-1])]
    if order == "zigzag":  # the smallest, the largest, the next smallest
        place = np.arange(count)
        chunk = chunk[np.where(place % 2, count - 1 - place // 2, place // 2)]
    return chunk[::-1] if order == "reversed" else chunk


def random_chunks(config: AcceleratorConfig, rng: np.random.Generator, lengths: Iterable[int]) -> list[np.ndarray]:
    """Chunks of these lengths in random orders."""
    return [random_chunk(config, rng, length, str(rng.choice(ORDERS))) for length in lengths]


def bit_chunks(config: AcceleratorConfig, run: int) -> list[np.ndarray]:
    """Chunks for the stage that merges runs of so many intersections. Its heads differ first at each bit of the record in turn,
    and at all bits below it the other way round, so that every bit decides once; each of the two comes first."""
    fields = intersection(config).fields
    width = sum(field.width for field in fields)
    above, below = [1 << bit for bit in range(width)], [(1 << bit) - 1 for bit in range(width)]
    chunks, rows = [], 2 * max(config.sort_chunk // (2 * run), 1)
    for inverse in (0, (1 << width) - 1):
        for pair in ((above, below), (below, above)):
            parts = []
            for start in range(0, width, run):
                for side in pair:
                    part = sorted(value ^ inverse for value in side[start : start + run])
                    parts.append(part + part[-1:] * (run - len(part)))
            chunks += [_split(fields, [word for part in parts[start : start + rows] for word in part])
                       for start in range(0, len(parts), rows)]
    return chunks


def _split(fields: Sequence[Field], words: list[int]) -> np.ndarray:
    """(N, 3) tile, depth key and index of records as numbers."""
    values, offset = {}, 0
    for field in fields:
        values[field.name] = [word >> offset & (1 << field.width) - 1 for word in words]
        offset += field.width
    return np.array([values[name] for name in ("tile", "depth_key", "index")], np.int64).T


def group_chunks(frame: Frame, capacity: int) -> list[np.ndarray]:
    """A traced frame's groups in order, with intersections in the order in which the tile test finds them. A group beyond the
    capacity is cut into chunks as it arrives."""
    entries = frame.entries
    tile = np.repeat(np.arange(len(entries.start) - 1), np.diff(entries.start))
    arrival = np.lexsort((tile, entries.splat, frame.groups[tile]))
    rows = np.stack([tile, frame.projected.depth_key[entries.splat], entries.splat], 1)[arrival]
    bounds = np.searchsorted(frame.groups[tile[arrival]], np.arange(frame.groups[-1] + 2))
    return [
        rows[start : min(start + capacity, end)]
        for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)
        for start in range(begin, max(end, begin + 1), capacity)]


def whole_groups(frame: Frame) -> list[np.ndarray]:
    """A traced frame's groups in order, with intersections in the order in which the tile test finds them. A group without
    intersections is an empty array."""
    return group_chunks(frame, max(len(frame.entries.splat), 1))
