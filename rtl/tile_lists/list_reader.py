"""Reads the intersections of tiles from memory for the sorter, one group of tiles after the other."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.tile_lists.beats import check_config, read_port
from rtl.tile_lists.entry_writer import UNIT_BITS
from rtl.tile_lists.page_walk import ListedTiles, PageWalk
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_BITS, WORDS
from spec.queues import LIST_BEATS
from spec.records import chunk_item, intersection, tile_group


class ListReader(wiring.Component):
    """Turns TileGroup items into the intersections of their tiles, as ChunkItem items. The order of a tile's intersections is
    that in which they were written.

    Parameters:
        config: the machine; `row_width` matters here, or with lists by super-tile `list_heads`. Their lists take the place of
            tiles.

    Ports:
        tiles: TileGroup items of every tile of a frame, in order. A tile's count is the number of its intersections in memory.
        directory_base, entries_base: first beats of the directory and of the intersections; stable during a frame.
        reads, data: read port of memory. The directory is read only for tiles with more than one page.
        groups: ChunkItem items; `last` is set in a group's last intersection. A group without intersections gives no item, and
            `empty` is always 0.
        clear: strobe: resets `error`.
        error: memory answered with an error. The intersections of such beats are undefined, but are passed on, and pages whose
            pointers were lost are read from undefined addresses. The number of items does not change.

    Storage: LIST_TILES tiles, LIST_POINTERS pointers, LIST_BEATS descriptors of beats, two beats.

    Throughput: one intersection per cycle while memory keeps up; the unit requests up to LIST_BEATS beats ahead. At a latency
    of 100 cycles this rate is reached where 32 neighbouring tiles with intersections have more than about 130 intersections
    together. At the beginning of a frame whose first tiles need their directory, one latency of memory is added.

    Latency: 8 cycles from a tile to its first request, one from a beat to its first intersection. A tile that may be the last
    one with intersections of its group waits for the tiles after it.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        if intersection(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"row_width must let an Intersection fit {8 * ENTRY_BYTES} bits, not {config.row_width!r}")
        self.config = config
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_group(config)))),
            "directory_base": In(BEAT_BITS), "entries_base": In(BEAT_BITS),
            **read_port(config),
            "groups": Out(stream.Signature(layout(chunk_item(config)))),
            "clear": In(1), "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.listed = listed = ListedTiles(self.config)
        m.submodules.walk = walk = PageWalk(self.config)
        wiring.connect(m, wiring.flipped(self.tiles), listed.tiles)
        wiring.connect(m, listed.listed, walk.listed)
        kinds = data.StructLayout({"directory": 1, "more": range(WORDS), "last": 1})
        m.submodules.flight = flight = SyncFIFOBuffered(width=kinds.size, depth=LIST_BEATS)
        self._request(m, walk.wanted, flight)
        self._unpack(m, kinds(flight.r_data), flight, walk.pointers)
        return m

    def _request(self, m: Module, wanted: stream.Interface, flight: SyncFIFOBuffered) -> None:
        """Sends the address of a wanted beat to memory, and a descriptor of its content to the queue `flight`."""
        m.submodules.requests = requests = Buffer(self.reads.payload.shape())
        wiring.connect(m, requests.source, wiring.flipped(self.reads))
        want, valid = wanted.payload, wanted.valid & flight.w_rdy
        p = Pipeline(m, load=valid, advance=requests.sink.ready)
        base = p.reg("base", lambda x: x, p.data("its_base", Mux(want.directory, self.directory_base, self.entries_base)))
        beat = p.reg("beat", lambda x, y: (x + y)[:BEAT_BITS], base, p.data("relative", want.beat))
        m.d.comb += [
            requests.sink.payload.beat.eq(beat.value),
            requests.sink.valid.eq(p.control("valid", valid).at(beat.stage)),
            wanted.ready.eq(requests.sink.ready & flight.w_rdy),
            flight.w_en.eq(wanted.valid & requests.sink.ready),
            flight.w_data.eq(Cat(want.directory, want.more, want.last)),
        ]

    def _unpack(self, m: Module, kind: data.View, flight: SyncFIFOBuffered, pointers: stream.Interface) -> None:
        """Unpacks beats: a beat of intersections and a beat of pointers are each loaded into a register that is shifted out."""
        beat, item = self.data.payload, self.groups.payload
        entries, more, valid = Signal.like(beat.word.as_value(), reset_less=True), Signal.like(kind.more), Signal()
        slots, more_slots, slots_valid = Signal.like(entries), Signal.like(kind.more), Signal()
        last, ends, slots_end, taken = Signal(reset_less=True), Signal(), Signal(), Signal()
        m.d.comb += [
            ends.eq(valid & self.groups.ready & ~more.any()),
            slots_end.eq(slots_valid & pointers.ready & ~more_slots.any()),
            self.data.ready.eq(flight.r_rdy & Mux(kind.directory, ~slots_valid | slots_end, ~valid | ends)),
            taken.eq(self.data.valid & self.data.ready),
            flight.r_en.eq(taken),
            self.groups.valid.eq(valid),
            Cat(item[f.name] for f in intersection(self.config).fields).eq(entries),
            item.last.eq(last & ~more.any()),
            pointers.valid.eq(slots_valid), pointers.payload.eq(slots[BEAT_BITS - UNIT_BITS : BEAT_BITS]),
        ]
        with m.If(taken & ~kind.directory):
            m.d.sync += [entries.eq(beat.word.as_value()), more.eq(kind.more), last.eq(kind.last), valid.eq(1)]
        with m.Elif(valid & self.groups.ready):
            m.d.sync += [entries.eq(entries >> 8 * ENTRY_BYTES), more.eq(more - 1), valid.eq(~ends)]
        with m.If(taken & kind.directory):
            m.d.sync += [slots.eq(beat.word.as_value()), more_slots.eq(kind.more), slots_valid.eq(1)]
        with m.Elif(slots_valid & pointers.ready):
            m.d.sync += [slots.eq(slots >> 32), more_slots.eq(more_slots - 1), slots_valid.eq(~slots_end)]
        with m.If(self.clear):
            m.d.sync += self.error.eq(0)
        with m.Elif(taken & beat.error):
            m.d.sync += self.error.eq(1)
