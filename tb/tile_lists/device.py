"""The units of tile lists, connected to a memory, with the tile merge unit between them.

The frames of a run follow each other as in the machine: a frame's intersections are accepted after everything of the previous
frame has left.
"""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring

from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.stream import Fork
from rtl.tile_lists.entry_writer import IntersectionWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.table_loader import TableLoader
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.records import (
    COUNT_BITS,
    INDEX_BITS,
    Field,
    Record,
    chunk_item,
    frame_tiles,
    gaussian_point,
    intersection_item,
    tile_group,
    tile_header,
    tile_level,
    tile_use,
    uint,
)
from tb.common.bench import Bench
from tb.common.playback import Playback
from tb.tile_lists.memory import MEMORY, add_memory

OBSERVED = {
    **dict.fromkeys(("full", "list_error", "header_error", "table_error", "geometry_error", "writer_busy", "merge_busy"), 1),
    "gaps": 24,
}
"""The widths in bits of plain outputs. `gaps` counts the cycles without an intersection between the first and the last of a
frame's lists."""

_BASES = ("directory_base", "entries_base", "tiles_base", "geometry_base")


def load_item(config: AcceleratorConfig) -> Record:
    """A beat that the host writes. The last one has `frames` set: then table and geometry are read once, and that many frames
    follow."""
    frames = Field("frames", uint(8), "frames that follow")
    return Record("LoadItem", load_item.__doc__, (*write_request(config).fields, frames))


class ListDevice(Bench):
    """The units, connected as in the machine.

    Parameters:
        config: the machine's configuration.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        tiles = frame_tiles(config).bit_length()
        super().__init__(
            {"load": load_item(config), "entries": intersection_item(config)},
            {"written": write_request(config), "groups": chunk_item(config), "headers": tile_header(config),
             "uses": tile_use(config), "levels": tile_level(config), "points": gaussian_point(config)},
            {"tiles_x": tiles, "tile_count": tiles, "beta": COUNT_BITS, "entries_beats": BEAT_BITS, "gaussians": INDEX_BITS,
             **dict.fromkeys(_BASES, BEAT_BITS), "latency": 10, "hesitates": 8, "bad": BEAT_BITS}, OBSERVED)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        config = self.config
        units = {
            "writer": IntersectionWriter(config), "merge": TileMergeUnit(config), "fork": Fork(layout(tile_group(config))),
            "reader": ListReader(config), "headers": HeaderMaker(config), "table": TableLoader(config),
            "geometry": GeometryReader(config)}
        for name, unit in units.items():
            m.submodules[f"{name}_unit"] = unit
            for setting in [name for name in self.settings if name in unit.signature.members]:
                m.d.comb += getattr(unit, setting).eq(getattr(self, setting))
        writer, merge, fork, reader, maker, table, geometry = units.values()
        wiring.connect(m, writer.hits, merge.hits)
        wiring.connect(m, merge.groups, fork.sink)
        wiring.connect(m, fork.sources[0], reader.tiles)
        wiring.connect(m, fork.sources[1], maker.tiles)
        for source, name in ((writer.writes, "written"), (reader.groups, "groups"), (maker.headers, "headers"),
                             (maker.levels, "uses"), (table.levels, "levels"), (geometry.points, "points")):
            wiring.connect(m, source, wiring.flipped(getattr(self, name)))
        add_memory(
            m, {name: getattr(self, name) for name in ("latency", "hesitates", "bad")}, self.load, self.written,
            writer.writes_idle, [(unit.reads, unit.data) for unit in (reader, maker, table, geometry)])
        m.d.comb += [
            self.full.eq(writer.full), self.list_error.eq(reader.error), self.header_error.eq(maker.error),
            self.table_error.eq(table.error), self.geometry_error.eq(geometry.error),
            self.writer_busy.eq(writer.busy), self.merge_busy.eq(merge.busy),
        ]
        start, opens = Signal(), self._frames(m, writer)
        m.d.comb += [
            start.eq(self.load.valid & self.load.ready & self.load.payload.frames.any()),
            self.load.ready.eq(~table.busy & ~geometry.busy),
            table.start.eq(start), geometry.start.eq(start), reader.clear.eq(start), maker.clear.eq(start),
            writer.entries.payload.eq(self.entries.payload),
            writer.entries.valid.eq(self.entries.valid & opens), self.entries.ready.eq(writer.entries.ready & opens),
        ]
        return m

    def _frames(self, m: Module, writer: IntersectionWriter) -> Signal:
        """Whether intersections are accepted: a frame remains to be done, and everything of the previous one has left."""
        frames, opens, within, begun = Signal(8), Signal(), Signal(), Signal()
        listed, headers, uses = Signal(COUNT_BITS + 1), Signal.like(self.tile_count), Signal.like(self.tile_count)
        hit = writer.hits.payload
        m.d.comb += within.eq(writer.hits.valid & writer.hits.ready & ~hit.end & (hit.tile < self.tile_count))
        m.d.sync += [
            listed.eq(listed + within - (self.groups.valid & self.groups.ready)),
            headers.eq(headers + (self.headers.valid & self.headers.ready)),
            uses.eq(uses + (self.uses.valid & self.uses.ready)),
        ]
        starts = self.load.valid & self.load.ready & self.load.payload.frames.any()
        with m.If(starts):
            m.d.sync += [frames.eq(self.load.payload.frames), self.gaps.eq(0)]
        with m.FSM():
            with m.State("ENTRIES"):
                m.d.comb += opens.eq(frames.any())
                m.d.sync += begun.eq(0)
                with m.If(self.entries.valid & self.entries.ready & self.entries.payload.end):
                    m.next = "LISTS"
            with m.State("LISTS"):
                m.d.sync += begun.eq(begun | self.groups.valid)
                m.d.sync += self.gaps.eq(self.gaps + (begun & listed.any() & ~self.groups.valid))
                with m.If((listed == 0) & (headers == self.tile_count) & (uses == self.tile_count)):
                    m.d.sync += [frames.eq(frames - 1), headers.eq(0), uses.eq(0)]
                    m.next = "ENTRIES"
        return opens


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The device of a configuration and its memory, emitted, with files at its streams."""
    device = ListDevice(config)
    return device.playback(f"lists-{config.row_width}", "list_device", to_verilog(device, "list_device") + MEMORY)
