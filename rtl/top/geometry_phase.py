"""The units of the geometry phase: from Gaussians in memory to tile lists of intersections and splat records in memory."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.chunks.chunk_reader import ChunkReader
from rtl.culling.colour import ColourUnit
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.saturations import SaturationCounters
from rtl.culling.tile_test import TileTest
from rtl.shapes import layout
from rtl.tile_lists.entry_writer import IntersectionWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.table_loader import TableLoader
from rtl.tile_lists.tile_settings import mask_port
from rtl.top.chunked import add_chunk_test
from rtl.top.ports import connect_settings, phase_ports, watch
from spec.config import AcceleratorConfig
from spec.records import frame_tiles, intersection_tile
from spec.registers import CHUNK_EVENTS, CHUNK_READ_CLIENTS
from spec.saturations import SATURATIONS, WATCHED

WRITERS = ("entries", "views")
"""Memory clients of this phase that write, by the names of `spec.registers`."""

STAGES = ("geometry", "projection", "tile_test", "colour", "entry_write")
"""Stages of this phase whose input streams are watched by the performance counters."""

_COUNTS = (
    "points", "culled_near", "culled_faint", "culled_outside", "survivors", "entries", "filtered",
    *(saturation.name for saturation in SATURATIONS))


def readers(config: AcceleratorConfig) -> tuple[str, ...]:
    """Memory clients of this phase that read, by the names of `spec.registers`."""
    return ("geometry", "tiles", "colour", *(CHUNK_READ_CLIENTS if config.chunks else ()))


class GeometryPhase(wiring.Component):
    """Geometry reader, projection, tile test, colour unit and entry writer::

        geometry ─► GeometryReader ─► ProjectionUnit ─► TileTest ─► IntersectionWriter ─► entries
                                                          ▲   │         └─► hits
        tiles ─► TableLoader ─────────────────────────────┘   └─► ColourUnit ─► views
                                                        colour ─────┘

    In machines with chunks the Gaussians come in the chunks that pass the chunk test::

        chunks ─► ChunkHeaderReader ─► ChunkTest ─► ChunkReader ─► ProjectionUnit
                                           ▲    geometry ─┘
        TableLoader ─► LevelBounds ────────┘

    Parameters:
        config: the machine.

    Ports:
        settings, tiles_x, tile_count: settings of the frame and its numbers of tiles.
        clear: strobe before a frame.
        start_table, start: strobes, in this order; the second may come once `table_done` is high.
        reads_NAME, data_NAME: the memory clients of `readers`; writes_NAME, idle_NAME: those of WRITERS.
        hits: IntersectionTile items for the tile merge unit; the frame's `end` follows when the last intersection has been
            written.
        table_done: the table of tiles has been read since `clear`.
        done: all splat records of the frame are in memory. That its intersections are in memory too is shown by the end of
            `hits`.
        full: the intersections need more memory than there is.
        ready: nothing is being cleared.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each.
        points, culled_near, culled_faint, culled_outside, survivors, entries, filtered: counts of the frame.
        saturated_means, saturated_depths, saturated_keys, saturated_colours: counts of saturations, see `spec.saturations`.

    With chunks:
        chunks_read, chunks_skipped: further counts of the frame.

    With stereo:
        target: the target eye's pass is running.
        mask_tile, mask: see `mask_port`; used while the table is read.
        rendered_tiles: tiles of the pass that are rendered; valid from `table_done` on.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            **phase_ports(config, readers(config), WRITERS, STAGES, (*_COUNTS, *(CHUNK_EVENTS if config.chunks else ()))),
            "start_table": In(1), "hits": Out(stream.Signature(layout(intersection_tile(config)))), "table_done": Out(1),
            "full": Out(1),
            **({**mask_port(config), "rendered_tiles": Out(range(frame_tiles(config) + 1))} if config.stereo else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.reader = reader = (ChunkReader if self.config.chunks else GeometryReader)(self.config)
        m.submodules.loader = loader = TableLoader(self.config)
        m.submodules.projection = projection = ProjectionUnit(self.config)
        m.submodules.tile_test = tile_test = TileTest(self.config)
        m.submodules.colour = colour = ColourUnit(self.config, sh_degree=self.config.sh_degree)
        m.submodules.writer = writer = IntersectionWriter(self.config)
        for unit in (reader, loader, projection, tile_test, colour, writer):
            connect_settings(m, self, unit)
        wiring.connect(m, loader.levels, tile_test.table)
        wiring.connect(m, reader.points, projection.sink)
        wiring.connect(m, projection.source, tile_test.splats)
        wiring.connect(m, tile_test.survivors, colour.survivors)
        wiring.connect(m, tile_test.entries, writer.entries)
        wiring.connect(m, writer.hits, wiring.flipped(self.hits))
        for name, unit in (("geometry", reader), ("tiles", loader), ("colour", colour)):
            wiring.connect(m, unit.reads, wiring.flipped(getattr(self, f"reads_{name}")))
            wiring.connect(m, wiring.flipped(getattr(self, f"data_{name}")), unit.data)
        for name, unit in (("entries", writer), ("views", colour)):
            wiring.connect(m, unit.writes, wiring.flipped(getattr(self, f"writes_{name}")))
        m.d.comb += [
            reader.start.eq(self.start), loader.start.eq(self.start_table), writer.writes_idle.eq(self.idle_entries),
            self.full.eq(writer.full), self.ready.eq(~writer.busy),
        ]
        watch(m, self, (reader.data, projection.sink, tile_test.splats, colour.survivors, writer.entries))
        if self.config.chunks:
            add_chunk_test(m, self, loader, reader)
        self._follow(m, loader, tile_test, colour)
        if self.config.stereo:
            m.d.comb += [self.mask_tile.eq(loader.mask_tile), loader.mask.eq(self.mask),
                         self.rendered_tiles.eq(loader.rendered_tiles)]
        if self.config.counters:
            self._count(m, reader, projection, tile_test)
            self._count_saturated(m, projection, colour)
        return m

    def _follow(self, m: Module, loader: TableLoader, tile_test: TileTest, colour: ColourUnit) -> None:
        """Follows the ends of table and frame. `idle_views` falls only a cycle after a write was taken, hence `settled`."""
        survivors, ended, settled = tile_test.survivors, Signal(), Signal()
        m.d.sync += settled.eq(ended & colour.finished)
        m.d.comb += self.done.eq(ended & settled & colour.finished & self.idle_views)
        with m.If(loader.done):
            m.d.sync += self.table_done.eq(1)
        with m.If(survivors.valid & survivors.ready & survivors.payload.end):
            m.d.sync += ended.eq(1)
        with m.If(self.clear):
            m.d.sync += [self.table_done.eq(0), ended.eq(0)]

    def _count(self, m: Module, reader: GeometryReader, projection: ProjectionUnit, tile_test: TileTest) -> None:
        for name, items in (("points", reader.points), ("survivors", tile_test.survivors), ("entries", tile_test.entries)):
            with m.If(items.valid & items.ready & ~items.payload.end):
                m.d.sync += getattr(self, name).eq(getattr(self, name) + 1)
            with m.If(self.clear):
                m.d.sync += getattr(self, name).eq(0)
        m.d.comb += [
            self.culled_near.eq(projection.culled_near), self.culled_faint.eq(projection.culled_faint),
            self.culled_outside.eq(projection.culled_outside), self.saturated_means.eq(projection.saturated_means),
            self.filtered.eq(tile_test.filtered)]

    def _count_saturated(self, m: Module, projection: ProjectionUnit, colour: ColourUnit) -> None:
        m.submodules.saturations = counts = SaturationCounters(self.config)
        splats, views = projection.source, colour.writes
        m.d.comb += [
            counts.clear.eq(self.clear),
            counts.splats.eq(splats.payload), counts.splats_move.eq(splats.valid & splats.ready & ~splats.payload.end),
            counts.views.eq(views.payload.word.as_value()), counts.views_move.eq(views.valid & views.ready),
            *(getattr(self, s.name).eq(getattr(counts, s.name)) for s in WATCHED)]
