"""Which beats hold the entries of a tile: pages in turn, those beyond the first by the directory.

Pointers are asked for while a tile waits behind others, so that they have come when its first page is done::

    tiles ──► drop empty ones ──► ask for pointers ──► wait ──► walk the pages ──► beats
                                        │                            ▲
                                        └──► directory ─── memory ───┘ pointers
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.tile_lists.beats import check_config
from rtl.tile_lists.entry_writer import FIRST_PAGE_BEATS, UNIT_BITS
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES, DIRECTORY_BEATS, DIRECTORY_SLOTS, FIRST_PAGE_ENTRIES, WORDS
from spec.queues import LIST_POINTERS, LIST_TILES
from spec.records import COUNT_BITS, tile_group, tile_index

_UNIT_LOW = BEAT_BITS - UNIT_BITS
"""Bits of a beat inside its unit."""

_SECOND_PAGE = FIRST_PAGE_ENTRIES.bit_length()
"""The top bit of the second page's places."""


def listed_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A tile with entries; `last`: no more of its group follow."""
    return data.StructLayout({"tile": shape(tile_index(config)), "count": COUNT_BITS, "last": 1})


def wanted_layout() -> data.StructLayout:
    """A beat that is wanted, relative to the base of its kind: `more` + 1 entries or pointers are in it."""
    return data.StructLayout({"beat": BEAT_BITS, "directory": 1, "more": range(WORDS), "last": 1})


class ListedTiles(wiring.Component):
    """Tiles with entries, each marked if it is the last of its group that has any.

    Parameters:
        config: the machine.

    Ports:
        tiles: TileGroup items.
        listed: those with a count, as `listed_layout`.

    Throughput: one tile a cycle. A tile waits until its group's end or its next tile with entries is at the input.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_group(config)))), "listed": Out(stream.Signature(listed_layout(config)))})

    def elaborate(self, platform) -> Module:
        m = Module()
        item, held, valid = self.tiles.payload, Signal(self.listed.payload.shape(), reset_less=True), Signal()
        filled = item.count.any()
        m.d.comb += [
            self.listed.valid.eq(valid & (held.last | self.tiles.valid & filled)),
            self.listed.payload.eq(held),
            self.tiles.ready.eq(~filled | ~valid | self.listed.ready),
        ]
        with m.If(self.tiles.valid & self.tiles.ready & filled):
            m.d.sync += [held.tile.eq(item.tile), held.count.eq(item.count), held.last.eq(item.last), valid.eq(1)]
        with m.Elif(self.listed.valid & self.listed.ready):
            m.d.sync += valid.eq(0)
        with m.Elif(self.tiles.valid & item.last & ~filled):
            m.d.sync += held.last.eq(1)  # an empty tile ended the group
        return m


class PageWalk(wiring.Component):
    """Tiles to the beats they lie in, in order; their directory's beats among them, ahead.

    Parameters:
        config: the machine.

    Ports:
        listed: tiles with entries.
        pointers: first units of pages beyond first ones, as the wanted directory beats give them. Always taken in the end: no
            more are asked for than have room.
        wanted: beats.

    Throughput: one beat a cycle, between tiles, too; one cycle more at the end of a page, for a directory beat, and for a tile
    of more than 16,352 entries, which has two of them. Directory beats go first.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        self.config = config
        super().__init__({
            "listed": In(stream.Signature(listed_layout(config))),
            "pointers": In(stream.Signature(UNIT_BITS)),
            "wanted": Out(stream.Signature(wanted_layout())),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=self.listed.payload.shape().size, depth=LIST_TILES)
        m.submodules.pointers = pointers = SyncFIFOBuffered(width=UNIT_BITS, depth=LIST_POINTERS)
        m.d.comb += [
            pointers.w_data.eq(self.pointers.payload), pointers.w_en.eq(self.pointers.valid),
            self.pointers.ready.eq(pointers.w_rdy),
        ]
        directory, page = Signal(self.wanted.payload.shape()), Signal(self.wanted.payload.shape())
        asks, walks, offered = Signal(), Signal(), Signal()  # `offered`: a page's beat that was not taken stays
        m.d.sync += offered.eq(walks & ~asks & ~self.wanted.ready)
        self._ask(m, waiting, directory, asks, offered, pointers.r_en & pointers.r_rdy)
        self._walk(m, waiting, pointers, page, walks, walks & ~asks & self.wanted.ready)
        m.d.comb += [self.wanted.valid.eq(asks | walks), self.wanted.payload.eq(Mux(asks, directory, page))]
        return m

    def _ask(
        self, m: Module, waiting: SyncFIFOBuffered, wanted: data.View, asks: Signal, waits: Signal, used: Value,
    ) -> None:
        """Tiles into the queue, behind requests for their pointers; `asks`: one is wanted; `used`: a pointer left."""
        tile, valid, second = Signal(self.listed.payload.shape(), reset_less=True), Signal(), Signal()
        place = Signal(COUNT_BITS + 1, reset_less=True)  # of the tile's last entry: its top bit is of the last page
        room = Signal(range(LIST_POINTERS + 1), init=LIST_POINTERS)
        asked, leaves = Signal(), Signal()
        exist = Cat(place[_SECOND_PAGE + slot :].any() for slot in range(DIRECTORY_SLOTS))  # pages come in turn
        low, high = exist[:WORDS], exist[WORDS:]
        part = Mux(second, high, low)
        m.d.comb += [
            asks.eq(valid & low[0] & waiting.w_rdy & (room >= WORDS) & ~waits),
            asked.eq(asks & self.wanted.ready),
            leaves.eq(valid & waiting.w_rdy & (~low[0] | asked & (second | ~high[0]))),
            wanted.beat.eq(tile.tile * DIRECTORY_BEATS + second), wanted.directory.eq(1), wanted.more.eq(sum(part[1:])),
            waiting.w_en.eq(leaves), waiting.w_data.eq(tile),
            self.listed.ready.eq(~valid | leaves),
        ]
        m.d.sync += room.eq(room + used - Mux(asked, wanted.more + 1, 0))
        with m.If(asked):
            m.d.sync += second.eq(~leaves)
        with m.If(self.listed.ready):
            m.d.sync += [valid.eq(self.listed.valid), tile.eq(self.listed.payload)]
            m.d.sync += place.eq(self.listed.payload.count + (FIRST_PAGE_ENTRIES - 1))

    def _walk(
        self, m: Module, waiting: SyncFIFOBuffered, pointers: SyncFIFOBuffered, wanted: data.View, walks: Signal, moves: Value,
    ) -> None:
        """Tiles out of the queue, and their beats; `walks`: one is wanted; `moves`: it is taken."""
        tile = self.listed.payload.shape()(waiting.r_data)
        valid, turns, ends, loads = Signal(), Signal(), Signal(), Signal()
        beat, left, last = Signal(BEAT_BITS, reset_less=True), Signal(COUNT_BITS, reset_less=True), Signal(reset_less=True)
        in_page, page = Signal(DIRECTORY_SLOTS + _UNIT_LOW + 1, reset_less=True), Signal(DIRECTORY_SLOTS + 1, reset_less=True)
        m.d.comb += [
            ends.eq(left <= BEAT_ENTRIES),
            walks.eq(valid & ~turns),
            wanted.beat.eq(beat), wanted.last.eq(ends & last), wanted.more.eq(Mux(ends, left - 1, BEAT_ENTRIES - 1)),
            loads.eq(waiting.r_rdy & (~valid | moves & ends)), waiting.r_en.eq(loads), pointers.r_en.eq(turns),
        ]
        with m.If(moves):
            m.d.sync += [beat.eq(beat + 1), left.eq(left - BEAT_ENTRIES), in_page.eq(in_page - 1)]
            m.d.sync += [valid.eq(~ends), turns.eq(~ends & (in_page == 1))]
        with m.If(turns & pointers.r_rdy):
            m.d.sync += [beat.eq(Cat(Const(0, _UNIT_LOW), pointers.r_data)), turns.eq(0)]
            m.d.sync += [page.eq(page << 1), in_page.eq(Cat(Const(0, _UNIT_LOW + 1), page))]
        with m.If(loads):
            m.d.sync += [beat.eq(tile.tile * FIRST_PAGE_BEATS), left.eq(tile.count), last.eq(tile.last), valid.eq(1)]
            m.d.sync += [page.eq(1), in_page.eq(FIRST_PAGE_BEATS)]
