"""The expected cycles of a machine's frame, from the golden frame alone, for progress bars. The cycle model is more exact."""

from __future__ import annotations

import math

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES, BEAT_ENTRIES, DISPLAY_PIXEL_BYTES, PIXEL_BYTES, TILE_SETTING_BYTES, colour_beats
from tb.frame.bound import array_ops, bound_cycles
from tb.top.memory import MemorySpeed
from tb.top.progress import Pass


def expected_pass(frame: Frame, speed: MemorySpeed, *, display: bool, pixels: int | None = None) -> Pass:
    """The expected work of the pass of one eye.

    In the geometry phase the headers of chunks, every Gaussian or those of the chunks that are not skipped, the tile table,
    and the colours of the survivors are read, and the survivors' splat records and the tile lists are written; memory limits
    this phase, or the units of a small machine. The rendering phase reads each splat record at least once; with super-tiles,
    the Gaussian of each pair.

    Args:
        frame: the golden frame of the eye.
        speed: the memory's speed.
        display: whether the machine writes display pixels.
        pixels: the pixels that are written in the pass; those of the frame by default.
    """
    r, entries = frame.registers, frame.entries
    tiles, count = len(r.header), len(entries.splat)
    tile_of = np.repeat(np.arange(tiles), np.diff(entries.start))
    survivors = len(np.unique(entries.splat))
    records = len(np.unique(entries.splat.astype(np.int64) * 8 + r.header[tile_of, 0]))
    config, points = frame.config, int(frame.read.sum())
    headers = 0 if frame.words.chunks is None else len(frame.words.chunks)
    reads = headers + -(-points // (2 if config.compact else 1)) + survivors * colour_beats(config, frame.words.sh_degree)
    reads += -(-tiles * TILE_SETTING_BYTES // BEAT_BYTES)
    writes = records + count + tiles
    if frame.pairs is not None:  # pairs are written combined, and records are read for each of them in the rendering phase
        count = len(frame.pairs.splat)
        reads -= survivors * colour_beats(config, frame.words.sh_degree)
        writes, records = -(-count // BEAT_ENTRIES), count * colour_beats(config, frame.words.sh_degree)
    memory = max(reads, writes) if speed.bytes_per_cycle is None else (reads + writes) * BEAT_BYTES / speed.bytes_per_cycle
    written = r.width * r.height if pixels is None else pixels
    rows = -(-written * (DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES) // BEAT_BYTES)
    bounds = bound_cycles(frame, array_ops(frame), records + count // BEAT_ENTRIES, rows, speed.bytes_per_cycle)
    geometry = max(memory, points * config.point_interval, survivors * config.colour_interval)
    return Pass(reads + writes, math.ceil(geometry), max(*bounds.values(), TILE), written)
