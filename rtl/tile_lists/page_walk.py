"""Finds the beats that hold the intersections of a tile: its pages in turn, of which the directory locates all but the first.

The pointers of a tile are requested while it waits behind other tiles, so that they have come when its first page is read::

    tiles ──► drop empty tiles ──► request pointers ──► queue ──► walk the pages ──► beats
                                        │                              ▲
                                        └──► directory ──── memory ────┘ pointers
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.tile_lists.beats import check_config
from rtl.tile_lists.entry_writer import UNIT_BITS
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES, DIRECTORY_BEATS, DIRECTORY_SLOTS, FIRST_PAGE_BEATS, FIRST_PAGE_ENTRIES, WORDS
from spec.queues import LIST_POINTERS, LIST_TILES
from spec.records import COUNT_BITS, list_index, tile_group

_UNIT_LOW = BEAT_BITS - UNIT_BITS
"""Bits of a beat's position in its unit."""

_SECOND_PAGE = FIRST_PAGE_ENTRIES.bit_length()
"""Number of the top bit of the places in the second page (`rtl.tile_lists.entry_writer` says what a place is)."""


def listed_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A tile with intersections; `last`: no further tile with intersections of its group follows."""
    return data.StructLayout({"tile": shape(list_index(config)), "count": COUNT_BITS, "last": 1})


def wanted_layout() -> data.StructLayout:
    """A wanted beat of a tile list or, with `directory`, of the directory; its address is relative to that region's base. It
    holds `more` + 1 intersections or pointers."""
    return data.StructLayout({"beat": BEAT_BITS, "directory": 1, "more": range(WORDS), "last": 1})


class ListedTiles(wiring.Component):
    """Passes on the tiles with intersections, and marks the last such tile of each group.

    Parameters:
        config: the machine.

    Ports:
        tiles: TileGroup items.
        listed: the tiles with intersections, as `listed_layout`, in order.

    Throughput: one tile per cycle. Latency: a tile waits until the end of its group, or the group's next tile with
    intersections, is at the input.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_group(config)))), "listed": Out(stream.Signature(listed_layout(config)))})

    def elaborate(self, platform: object) -> Module:
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
    """Turns tiles into the beats that hold their intersections, in order. Beats of the directory are requested ahead, between
    them.

    Parameters:
        config: the machine.

    Ports:
        listed: the tiles with intersections.
        pointers: the first units of pages beyond the first, from the wanted directory beats, in order. They never block for
            good, because no more pointers are requested than there is free space for.
        wanted: the beats, as `wanted_layout`.

    Throughput: one beat per cycle, without gaps between tiles. One cycle is added at the end of a page, for each directory
    beat, and for a tile of more than 16,352 intersections, which has two directory beats. Directory beats have priority.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        self.config = config
        super().__init__({
            "listed": In(stream.Signature(listed_layout(config))),
            "pointers": In(stream.Signature(UNIT_BITS)),
            "wanted": Out(stream.Signature(wanted_layout())),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=self.listed.payload.shape().size, depth=LIST_TILES)
        m.submodules.pointers = pointers = SyncFIFOBuffered(width=UNIT_BITS, depth=LIST_POINTERS)
        m.d.comb += [
            pointers.w_data.eq(self.pointers.payload), pointers.w_en.eq(self.pointers.valid),
            self.pointers.ready.eq(pointers.w_rdy),
        ]
        directory, page = Signal(self.wanted.payload.shape()), Signal(self.wanted.payload.shape())
        asks, walks, offered = Signal(), Signal(), Signal()  # `offered`: a page's beat was offered and must stay until taken
        m.d.sync += offered.eq(walks & ~asks & ~self.wanted.ready)
        self._ask(m, waiting, directory, asks, offered, pointers.r_en & pointers.r_rdy)
        self._walk(m, waiting, pointers, page, walks, walks & ~asks & self.wanted.ready)
        m.d.comb += [self.wanted.valid.eq(asks | walks), self.wanted.payload.eq(Mux(asks, directory, page))]
        return m

    def _ask(
        self, m: Module, waiting: SyncFIFOBuffered, wanted: data.View, asks: Signal, waits: Signal, used: Value,
    ) -> None:
        """Requests the pointers of a tile, then puts the tile into the queue. `asks`: a directory beat is wanted; `waits`: it
        must not be offered now; `used`: a pointer has left its queue."""
        tile, valid, second = Signal(self.listed.payload.shape(), reset_less=True), Signal(), Signal()
        place = Signal(COUNT_BITS + 1, reset_less=True)  # of the tile's last intersection; its top bit tells the page
        room = Signal(range(LIST_POINTERS + 1), init=LIST_POINTERS)
        asked, leaves = Signal(), Signal()
        exist = Cat(place[_SECOND_PAGE + slot :].any() for slot in range(DIRECTORY_SLOTS))  # pages that the tile has
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
        """Takes tiles from the queue and walks through their pages. `walks`: a beat is wanted; `moves`: it is taken."""
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
