"""The chunk test at the head of the first phase, in machines that read their Gaussians in chunks."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import wiring

from rtl.chunks.chunk_reader import ChunkReader
from rtl.chunks.chunk_test import ChunkTest
from rtl.chunks.header_reader import ChunkHeaderReader
from rtl.chunks.level_bounds import LevelBounds
from rtl.tile_lists.table_loader import TableLoader
from rtl.top.ports import connect_settings


def add_chunk_test(m: Module, phase: wiring.Component, loader: TableLoader, reader: ChunkReader) -> None:
    """Adds the units that read the headers of chunks and give the reader those chunks that pass the chunk test.

    The bounds of levels are made anew from the table of tiles of each pass.

    Args:
        m: the module of the phase.
        phase: the phase, with the ports `settings`, `clear`, `start`, `reads_chunks`, `data_chunks` and, if the machine has
            counters, `chunks_read` and `chunks_skipped`.
        loader: the loader of the table of tiles.
        reader: the reader of Gaussians.
    """
    m.submodules.headers = headers = ChunkHeaderReader(phase.config)
    m.submodules.bounds = bounds = LevelBounds(phase.config)
    m.submodules.chunk_test = test = ChunkTest(phase.config)
    if phase.config.joint:
        _add_target(m, phase, loader, bounds, test)
    for unit in (headers, bounds, test):
        connect_settings(m, phase, unit)
    wiring.connect(m, headers.reads, wiring.flipped(phase.reads_chunks))
    wiring.connect(m, wiring.flipped(phase.data_chunks), headers.data)
    wiring.connect(m, headers.headers, test.headers)
    wiring.connect(m, test.tested, reader.tested)
    levels = loader.levels
    m.d.comb += [
        headers.start.eq(phase.start), bounds.clear.eq(phase.clear),
        bounds.item.eq(levels.payload), bounds.taken.eq(levels.valid & levels.ready), test.bounds.eq(bounds.bounds)]
    if phase.config.counters:
        m.d.comb += [phase.chunks_read.eq(test.chunks_read), phase.chunks_skipped.eq(test.chunks_skipped)]


def _add_target(m: Module, phase: wiring.Component, loader: TableLoader, source: LevelBounds, test: ChunkTest) -> None:
    """Adds the level bounds of the target eye, whose tiles follow those of the source."""
    m.submodules.target_bounds = target = LevelBounds(phase.config)
    connect_settings(m, phase, target)
    levels = loader.levels
    m.d.comb += [
        target.clear.eq(phase.clear), target.item.eq(levels.payload), target.taken.eq(levels.valid & levels.ready),
        test.target_bounds.eq(target.bounds),
        source.other.eq(levels.payload.eye), target.other.eq(~levels.payload.eye)]
