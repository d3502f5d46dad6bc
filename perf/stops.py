"""Finds after how many intersections all pixels of a tile have stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.msv2_ref import array
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.regions import region_of, stream_entries
from spec import tables
from spec.config import AcceleratorConfig


def stop_entries(frame: Frame, stream: int = 0) -> np.ndarray:
    """(tiles, 2) int32: the number of intersections of a stream after which every pixel of a level bank, in the stream's part
    of the tile, has stopped; -1 where some never stop.

    Only tiles in which all pixels have stopped at the end are candidates. For these, the array is rendered again with fewer
    intersections, by bisection.
    """
    config, header = frame.config, frame.registers.header
    stop, part = np.full((len(header), 2), -1, np.int32), region_of(config, stream)
    if frame.regions is not None:
        frame = replace(frame, entries=stream_entries(frame.entries, frame.regions, stream))
    limit = tables.t_stop(config.formats)
    candidates = np.flatnonzero(
        (frame.pixels.transmittance[:, *part] < limit).all((1, 2)) & (np.diff(frame.entries.start) > 0))
    for bank in range(2):
        tiles = candidates[header[candidates, 1] != 0] if bank else candidates
        if len(tiles):
            stop[tiles, bank] = _bisect(config, frame, tiles, bank, limit, part)
    return stop


def _bisect(
    config: AcceleratorConfig, frame: Frame, tiles: np.ndarray, bank: int, limit: int, part: tuple[slice, slice],
) -> np.ndarray:
    start, counts = frame.entries.start, np.diff(frame.entries.start)[tiles]
    low, high = np.zeros(len(tiles), np.int64), counts.astype(np.int64)  # all have stopped after `high`, but not after `low`
    never = ~_stopped(config, frame, tiles, counts, bank, limit, part)
    while (high - low > 1).any():
        middle = (low + high) // 2
        there = _stopped(config, frame, tiles, middle, bank, limit, part)
        high, low = np.where(there, middle, high), np.where(there, low, middle)
    del start
    return np.where(never, -1, high)


def _stopped(
    config: AcceleratorConfig, frame: Frame, tiles: np.ndarray, counts: np.ndarray, bank: int, limit: int,
    part: tuple[slice, slice],
) -> np.ndarray:
    """Whether all pixels of a bank in this part of a tile have stopped after the first `counts` intersections of each tile."""
    r, e = frame.registers, frame.entries
    level = r.header[tiles, 0] + bank
    tile_y, tile_x = np.divmod(tiles, r.tiles_x)
    header = np.stack([tile_x, tile_y, level, (level > 0).astype(np.int64), np.zeros(len(tiles), np.int64)], 1)
    start = np.concatenate(([0], np.cumsum(counts)))
    rows = np.arange(start[-1]) + np.repeat(e.start[:-1][tiles] - start[:-1], counts)
    used = (e.use[rows] >> bank & 1).astype(np.uint8)
    work = array.TileWork(np.ascontiguousarray(header), np.zeros((len(tiles), 3), np.int64), start, e.splat[rows], used)
    pixels = array.render(config, frame.splats, work, r.background)
    return (pixels.transmittance[:, *part] < limit).all((1, 2))
