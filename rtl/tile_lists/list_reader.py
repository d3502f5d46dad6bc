"""Tiles' entries from memory to the sorter, a group behind the other."""

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
from spec.memory import BEAT_BITS, WORDS
from spec.queues import LIST_BEATS
from spec.records import ENTRY_BYTES, chunk_entry, tile_entry, tile_group


class ListReader(wiring.Component):
    """TileGroups to the entries of their tiles, in the order in which they were written, as ChunkEntry items.

    Parameters:
        config: the machine; `row_width` matters here.

    Ports:
        tiles: TileGroup items of every tile of a frame, in order. A tile's count is that of its entries in memory.
        directory_base, entries_base: first beats of both; stable during a frame.
        reads, data: memory. Only tiles of more than one page need their directory.
        groups: ChunkEntry items, `last` with a group's last entry; a group without entries gives none; `empty` is 0.
        clear: strobe, lowers `error`.
        error: memory answered with an error; the entries of such beats mean nothing but go their way, and pages whose
            pointers were lost are read from anywhere. As many entries leave in any case.

    Storage: LIST_TILES tiles, LIST_POINTERS pointers, LIST_BEATS descriptors of beats, two beats. Throughput: one entry a
    cycle while memory keeps up, LIST_BEATS beats ahead; for a latency of 100 cycles wherever 32 neighbouring tiles with entries
    have more than about 130 of them. At a frame's beginning a latency more, if its first tiles need their directory.
    Latency: 8 cycles from a tile to its first request, one from a beat to its entry; a tile that may be its group's last with
    entries waits for those behind it.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        if tile_entry(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"row_width must leave an entry {8 * ENTRY_BYTES} bits, not {config.row_width!r}")
        self.config = config
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_group(config)))),
            "directory_base": In(BEAT_BITS), "entries_base": In(BEAT_BITS),
            **read_port(config),
            "groups": Out(stream.Signature(layout(chunk_entry(config)))),
            "clear": In(1), "error": Out(1),
        })

    def elaborate(self, platform) -> Module:
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
        """A wanted beat's address to memory, what it will be to the queue."""
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
        """A beat of entries and one of pointers, each into a register that is shifted out, side by side."""
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
            Cat(item[f.name] for f in tile_entry(self.config).fields).eq(entries),
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
