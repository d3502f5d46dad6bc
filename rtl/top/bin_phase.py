"""The first phase of machines with super-tiles: from Gaussians in memory to lists of pairs in memory."""

from __future__ import annotations

from functools import reduce
from operator import and_

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.chunks.chunk_reader import ChunkReader
from rtl.shapes import layout
from rtl.supertiles.buckets import depth_buckets
from rtl.supertiles.eyes import columns_apart
from rtl.supertiles.pair_writer import PairWriter
from rtl.supertiles.warp_strips import known_write
from rtl.tile_lists.table_loader import TableLoader
from rtl.top import splat_path
from rtl.top.chunked import add_chunk_test
from rtl.top.list_sets import ListSets
from rtl.top.ports import connect_settings, phase_ports
from rtl.top.splat_path import SplatPath
from rtl.top.splat_paths import SplatPaths
from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, SUPER_Y, TILE
from spec.memory import frame_settings
from spec.records import (
    TILE_BITS,
    chunk_item,
    frame_lists,
    frame_tiles,
    gaussian_point,
    intersection_tile,
    list_group,
    surviving_splat,
    tile_group,
)
from spec.registers import CHUNK_EVENTS, CHUNK_READ_CLIENTS
from spec.supertiles import check_supertiles, supertile

READERS = ("geometry", "tiles", *CHUNK_READ_CLIENTS)
WRITERS = ("entries",)
"""Memory clients of this phase, by the names of `spec.registers`."""

STAGES = ("geometry", *splat_path.STAGES, "entry_write")
"""Stages of this phase whose input streams are watched by the performance counters."""

_COUNTS = ("points", "pairs", *splat_path.COUNTS, *CHUNK_EVENTS)

_COLUMN, _ROW = (SUPER_X * TILE).bit_length() - 1, (SUPER_Y * TILE).bit_length() - 1
"""log2 of a super-tile's width and height in pixels."""


class BinPhase(wiring.Component):
    """Chunk reader, projection, tile test, depth buckets and pair writer::

        chunks ─► ChunkHeaderReader ─► ChunkTest ─► ChunkReader ─► SplatPath ─► depth_buckets ─► PairWriter ─► entries
                                           ▲    geometry ─┘            ▲                             └─► hits
        tiles ─► TableLoader ─┬─► LevelBounds                          │
                              └────────────────────────────────────────┘

    `SplatPath` and the buckets also serve the second phase, which uses them through the ports below. In machines whose phases
    overlap, `SplatPaths` and `ListSets` stand in their places, and the tile merge unit, which takes the hits, is in the latter.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        settings, tiles_x, tile_count: settings of the frame and its numbers of tiles.
        clear: strobe before a frame.
        start_table, start: strobes, in this order; the second may come once `table_done` is high.
        reads_NAME, data_NAME: the memory clients of READERS; writes_NAME, idle_NAME: those of WRITERS.
        hits: IntersectionTile items for the tile merge unit, a list for each pair; the frame's `end` follows when the last pair
            is in memory.
        table_done: the table of tiles has been read since `clear`.
        done: all Gaussians of the frame have passed, and its pairs are in memory.
        full: the pairs need more memory than there is.
        ready: nothing is being cleared, and lists have their bounds.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each.
        points, pairs, culled_near, culled_faint, culled_outside, survivors, entries, filtered, chunks_read, chunks_skipped,
        saturated_means, saturated_depths, saturated_keys: counts of the frame's first phase.

    For the second phase:
        rendering: level: the second phase.
        gathered, supertiles, tested: see `SplatPath`.
        merged: TileGroup items of all lists, in order. listed: the same as ListGroup items.
        sorted_item, sorted_taken: what leaves the sorter, and whether it does, which sets the next frame's bounds.
        list_count: number of lists; valid from `ready` on.

    With a warp unit and joint frames (`spec.joint_warp`):
        second: the second phase is in its second sweep. known: what the table says of a tile of the target. rendered_tiles: the
        tiles that the first sweep renders.

    With overlapped phases, instead of `hits`, `rendering`, `merged` and `list_count`:
        second_settings: settings of the frame in its second phase.
        which: which of two sets of what the phases hand over the first phase uses; the second one uses the other.
        saturated: a list has more pairs than can be counted, or a pair's list is not one of the frame.
    """

    def __init__(self, config: AcceleratorConfig):
        ports = phase_ports(config, READERS, WRITERS, STAGES, _COUNTS)
        in_turn = {
            "hits": Out(stream.Signature(layout(intersection_tile(config)))), "rendering": In(1),
            "merged": In(stream.Signature(layout(tile_group(config)))), "list_count": Out(range(frame_lists(config) + 1))}
        overlapped = {"second_settings": In(layout(frame_settings(config))), "which": In(1), "saturated": Out(1)}
        super().__init__({
            **ports, "start_table": In(1), "table_done": Out(1),
            "full": Out(1), **(overlapped if config.overlap else in_turn),
            "gathered": In(stream.Signature(layout(gaussian_point(config)))),
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "tested": Out(stream.Signature(layout(surviving_splat(config)))),
            "listed": Out(stream.Signature(layout(list_group(config)))),
            "sorted_item": In(layout(chunk_item(config))), "sorted_taken": In(1),
            **(self._sweep_ports(config) if config.warps_joint else {})})
        check_supertiles(config)
        self.config = config

    def _sweep_ports(self, config: AcceleratorConfig) -> dict[str, wiring.Member]:
        return {"second": In(1), "known": Out(known_write(config)),
                "rendered_tiles": Out(range((frame_tiles(config) << 1) + 1))}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.reader = reader = ChunkReader(self.config)
        m.submodules.loader = loader = TableLoader(self.config)
        overlap = self.config.overlap
        m.submodules.path = path = SplatPaths(self.config) if overlap else SplatPath(self.config)
        m.submodules.buckets = buckets = ListSets(self.config) if overlap else depth_buckets(self.config)
        m.submodules.writer = writer = PairWriter(self.config)
        for unit in (reader, loader, writer):
            connect_settings(m, self, unit)
        wiring.connect(m, loader.levels, path.table)
        wiring.connect(m, reader.points, path.points)
        wiring.connect(m, path.binned, buckets.pairs)
        wiring.connect(m, buckets.entries, writer.entries)
        if overlap:
            self._two_frames(m, path, buckets, writer)
        else:
            wiring.connect(m, writer.hits, wiring.flipped(self.hits))
        for name in ("gathered", "supertiles"):
            wiring.connect(m, wiring.flipped(getattr(self, name)), getattr(path, name))
        wiring.connect(m, path.tested, wiring.flipped(self.tested))
        if not overlap:
            wiring.connect(m, wiring.flipped(self.merged), buckets.groups)
        wiring.connect(m, buckets.listed, wiring.flipped(self.listed))
        for name, unit in (("geometry", reader), ("tiles", loader)):
            wiring.connect(m, unit.reads, wiring.flipped(getattr(self, f"reads_{name}")))
            wiring.connect(m, wiring.flipped(getattr(self, f"data_{name}")), unit.data)
        wiring.connect(m, writer.writes, wiring.flipped(self.writes_entries))
        m.d.comb += [
            path.settings.eq(self.settings), path.clear.eq(self.clear),
            *(() if overlap else (path.rendering.eq(self.rendering),)),
            reader.start.eq(self.start), loader.start.eq(self.start_table),
            writer.writes_idle.eq(self.idle_entries), writer.list_count.eq(buckets.list_count),
            buckets.sorted_item.eq(self.sorted_item), buckets.sorted_taken.eq(self.sorted_taken),
            *(() if overlap else (self.list_count.eq(buckets.list_count),)), self.full.eq(writer.full)]
        if self.config.warps_joint:
            level = loader.levels.payload
            m.d.sync += [self.known.en.eq(loader.levels.valid & loader.levels.ready & level.eye),
                         self.known.tile.eq(level.tile), self.known.known.eq(level.rendered)]
            m.d.comb += [path.second.eq(self.second), self.rendered_tiles.eq(loader.rendered_tiles)]
        add_chunk_test(m, self, loader, reader)
        self._begin(m, path, buckets, writer.busy)
        self._follow(m, loader, path, writer.hits if overlap else self.hits)
        watched = (reader.data, writer.entries)
        m.d.comb += [
            self.stage_valid.eq(Cat(watched[0].valid, path.stage_valid, watched[1].valid)),
            self.stage_ready.eq(Cat(watched[0].ready, path.stage_ready, watched[1].ready))]
        if self.config.counters:
            self._count(m, reader, path)
        return m

    def _two_frames(self, m: Module, path: SplatPaths, sets: ListSets, writer: PairWriter) -> None:
        """Connects what is there for the frames of both phases."""
        wiring.connect(m, writer.hits, sets.hits)
        m.d.comb += [
            path.second_settings.eq(self.second_settings), path.which.eq(self.which), sets.which.eq(self.which),
            self.saturated.eq(sets.saturated)]
        for name in ("beta", "auto_beta"):
            m.d.comb += [getattr(sets, name).eq(self.settings[name]),
                         getattr(sets, f"second_{name}").eq(self.second_settings[name])]

    def _begin(self, m: Module, path: SplatPath | SplatPaths, buckets: wiring.Component, writing: Value) -> None:
        """Counts the frame's super-tiles, row by row, and then gives the lists their bounds. Until the number of lists is known
        the phase is not ready."""
        columns, rows, count = Signal(TILE_BITS), Signal(TILE_BITS), Signal.like(buckets.supertile_count)
        counting, settling, waits = Signal(), Signal(2), ~buckets.busy & (rows == 0)
        width: Value = self.settings.width
        if self.config.joint:  # as many columns of tiles more as the frames of both eyes are apart
            width = width + (columns_apart(self.settings.joint, self.settings.shift) << (TILE.bit_length() - 1))
        with m.If(self.clear):
            m.d.sync += [
                columns.eq((width + ((1 << _COLUMN) - 1)) >> _COLUMN),
                rows.eq((self.settings.height + ((1 << _ROW) - 1)) >> _ROW), count.eq(0), counting.eq(1)]
        with m.Elif(rows != 0):
            m.d.sync += [rows.eq(rows - 1), count.eq(count + columns)]
        with m.Elif(waits):
            m.d.sync += counting.eq(0)
        m.d.sync += settling.eq(Cat(buckets.clear, settling))
        m.d.comb += [
            buckets.supertile_count.eq(count), buckets.clear.eq(counting & waits),
            self.ready.eq(~counting & ~settling.any() & ~writing)]
        more = [unit.ready for unit, has in ((path, self.config.joint), (buckets, self.config.overlap)) if has]
        if more:
            m.d.comb += self.ready.eq(reduce(and_, more, ~counting & ~settling.any() & ~writing))

    def _follow(self, m: Module, loader: TableLoader, path: SplatPath | SplatPaths, hits: stream.Interface) -> None:
        """Follows the ends of table and frame."""
        written = Signal()
        with m.If(loader.done):
            m.d.sync += self.table_done.eq(1)
        with m.If(hits.valid & hits.ready & hits.payload.end):
            m.d.sync += written.eq(1)
        with m.If(self.clear):
            m.d.sync += [self.table_done.eq(0), written.eq(0)]
        m.d.comb += self.done.eq(written & ~path.busy)

    def _count(self, m: Module, reader: ChunkReader, path: SplatPath | SplatPaths) -> None:
        for name, items in (("points", reader.points), ("pairs", path.binned)):
            with m.If(items.valid & items.ready & ~items.payload.end):
                m.d.sync += getattr(self, name).eq(getattr(self, name) + 1)
            with m.If(self.clear):
                m.d.sync += getattr(self, name).eq(0)
        m.d.comb += [getattr(self, name).eq(getattr(path, name)) for name in splat_path.COUNTS]
