"""Tile entries into their tiles' pages, while culling runs.

A tile's next entry has the place n + FIRST_PAGE_ENTRIES, n being its entries so far: the top bit of a place names its page, a
power of two begins one, and with

    origin = page's first beat - (places of the page's first entry, in beats)

an entry lies at origin + place, with nothing to cut off. Places and origins are two memories, read one behind the other, so
that each is read, changed and written back within two cycles, and only an entry on the same tile in the very next cycle
must take the value from the register behind the adder (as `rtl.sort_tmu.tile_counters` does)::

    cycle        0        1        2        3        4      ...      7          8
    entries  < tile 7 >
    place             <   64   >                                                        new page: 64 is a power of two
    origin                     < free page less 64 >                                    two cycles, as the page is a write, too
    hits                                         < tile 7 >
    writes                                                    <directory><  entry  >

Pages are handed out in units of a first page, FIRST_PAGE_BEATS.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value, signed
from amaranth.lib import memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.tile_lists.beats import check_config
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES, DIRECTORY_BEATS, DIRECTORY_SLOTS, FIRST_PAGE_ENTRIES, WORDS, write_request
from spec.records import ENTRY_BYTES, entry_item, frame_tiles, tile_entry, tile_hit

FIRST_PAGE_BEATS = FIRST_PAGE_ENTRIES // BEAT_ENTRIES
"""The unit of pages: each has a power of two of it, and begins at a multiple of it."""

UNIT_BITS = BEAT_BITS - (FIRST_PAGE_BEATS - 1).bit_length()
"""Bits of a page's number in units."""

_PAGE_LOW, _BEAT_LOW = (FIRST_PAGE_ENTRIES - 1).bit_length(), (BEAT_ENTRIES - 1).bit_length()
"""Bits of a place inside its unit, and inside its beat."""


def _several(value: Value) -> Value:
    """More than one bit is set; no carry chain."""
    if len(value) == 1:
        return Const(0, 1)
    low, high = value[: len(value) // 2], value[len(value) // 2 :]
    return _several(low) | _several(high) | low.any() & high.any()


class _Slot(NamedTuple):
    """An entry where its page is chosen."""

    valid: Signal
    item: Signal
    inside: Signal  # an entry, of a tile of the frame
    place: Signal
    begins: Signal  # a page other than the first
    again: Signal  # the slot before was of the same tile
    next_tile: Value  # of the slot behind


class EntryWriter(wiring.Component):
    """EntryItems into memory, and each on to the tile merge unit as a TileHit.

    Parameters:
        config: the machine; `row_width` matters here.
        slots: pages that a tile may have beyond its first, up to DIRECTORY_SLOTS.

    Ports:
        entries: EntryItem items of a frame, then one with `end`. Frames follow each other.
        hits: a TileHit for each entry, then one with `end`: that leaves only when everything the frame wrote is in memory.
        writes: an entry each, and a word of the directory for each page but first ones. Words that are not written repeat those
            that are.
        writes_idle: all writes that were taken are in memory.
        directory_base, entries_base, entries_beats: first beats of both, room for entries; stable while `busy`.
        tile_count: tiles of the frame, 1 or more; likewise.
        full: an entry found no room: too few beats for the frame's first pages or for the page it needed, or its tile has all
            its pages. It and all that follow are neither written nor passed on. Until the next frame's first item.
        busy: high from a frame's first item until the places are cleared behind its `end`, and while they are cleared after
            a reset.

    An entry outside the frame is passed on in any case, but not written.

    Storage: for every tile of the largest frame a place of 23 bits and an origin of 24; for PAPER 14,400 x 47 bits.
    Throughput: one entry a cycle whatever the tiles, and one cycle more for each page but first ones. Latency: 3 cycles to
    `hits`, 7 to `writes`. Behind a frame's `end`, one cycle a tile of the frame is spent on clearing, while its lists are read;
    the next frame's entries would wait for it. After a reset, one cycle a tile of the largest frame.

    Entries of a splat lie in different tiles, so that each is a write of its own, of a quarter of a beat. What beats would save
    that wait for more entries of their tile is in reports/write_combining.md (`python -m msv2.studies write_combining`): in
    frames of 1920x1080 it takes 4,096 lines of 256 bits to save much, more than places and origins of PAPER together.
    """

    def __init__(self, config: AcceleratorConfig, *, slots: int = DIRECTORY_SLOTS):
        check_config(config)
        if tile_entry(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"row_width must leave an entry {8 * ENTRY_BYTES} bits, not {config.row_width!r}")
        if not isinstance(slots, int) or isinstance(slots, bool):
            raise TypeError(f"slots must be an integer, not {slots!r}")
        if not 1 <= slots <= DIRECTORY_SLOTS:
            raise ValueError(f"slots must be in 1..{DIRECTORY_SLOTS}, not {slots!r}")
        self.config, self.slots = config, slots
        super().__init__({
            "entries": In(stream.Signature(layout(entry_item(config)))),
            "hits": Out(stream.Signature(layout(tile_hit(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            "directory_base": In(BEAT_BITS), "entries_base": In(BEAT_BITS), "entries_beats": In(BEAT_BITS),
            "tile_count": In(range(frame_tiles(config) + 1)),
            "full": Out(1), "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        advance, passed, begun = Signal(), Signal(), Signal()
        slot = self._places(m, advance, passed, begun)
        self._pages(m, slot, advance, begun)
        m.d.comb += passed.eq(slot.valid & slot.item.end & advance)
        return m

    def _places(self, m: Module, advance: Signal, passed: Signal, begun: Signal) -> _Slot:
        """Entries and their places, and the clearing of all places; `passed`: the frame's end leaves the slot that returns.

        A place is read a cycle before its slot, and the next one of its tile written in the slot's cycle: behind the memory is
        time for a choice and a sum, not for going back into it as well. The two entries behind may be of the same tile, and
        get what is on its way::

            entries          < A >< B >< C >
            read                  < A >< B >< C >    B of A's tile: `summed`; C of A's tile, B not: `before`
            slot, written              < A >< B >
        """
        tiles, bits = frame_tiles(self.config), (FIRST_PAGE_ENTRIES << self.slots + 1).bit_length()
        m.submodules.places = places = memory.Memory(shape=bits, depth=tiles, init=[])
        write, read = places.write_port(), places.read_port()
        item, taken, clearing = self.entries.payload, Signal(), Signal(range(tiles), init=tiles - 1)
        valid, entry, inside, again = Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal()
        again_later, place = Signal(), Signal(bits)
        summed, before = Signal(bits, reset_less=True), Signal(bits, reset_less=True)  # on their way into the memory
        slot = _Slot(
            Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal(bits, reset_less=True), Signal(reset_less=True),
            Signal(reset_less=True), entry.tile)
        m.d.comb += [
            read.addr.eq(item.tile), read.en.eq(advance), taken.eq(self.entries.valid & self.entries.ready),
            place.eq(Mux(again, summed, Mux(again_later, before, read.data))),
            write.addr.eq(slot.item.tile), write.data.eq(summed), write.en.eq(advance & slot.inside),
            self.busy.eq(begun),
        ]
        with m.FSM():
            with m.State("CLEAR"):
                m.d.comb += [self.busy.eq(1), write.addr.eq(clearing), write.data.eq(FIRST_PAGE_ENTRIES), write.en.eq(1)]
                m.d.sync += clearing.eq(clearing - 1)
                with m.If(clearing == 0):
                    m.d.sync += begun.eq(0)
                    m.next = "TAKE"
            with m.State("TAKE"):
                m.d.comb += self.entries.ready.eq(advance)
                with m.If(taken):
                    m.d.sync += begun.eq(1)
                    with m.If(item.end):
                        m.next = "LAST"
            with m.State("LAST"):
                m.d.sync += clearing.eq(self.tile_count - 1)
                with m.If(passed):
                    m.next = "CLEAR"
        with m.If(advance):
            m.d.sync += [valid.eq(taken), entry.eq(item), inside.eq(taken & ~item.end & (item.tile < self.tile_count))]
            m.d.sync += [again.eq(inside & (entry.tile == item.tile)), summed.eq(place + 1)]
            m.d.sync += [again_later.eq(slot.inside & (slot.item.tile == item.tile)), before.eq(summed)]
            m.d.sync += [slot.valid.eq(valid), slot.item.eq(entry), slot.inside.eq(inside), slot.place.eq(place)]
            m.d.sync += slot.begins.eq(~_several(place) & ~place[_PAGE_LOW])
            m.d.sync += slot.again.eq(slot.inside & (slot.item.tile == entry.tile))
        return slot

    def _pages(self, m: Module, slot: _Slot, advance: Signal, begun: Signal) -> None:
        """A slot's page, handed out where it begins one, and both outputs."""
        m.submodules.hit_buffer = hits = Buffer(self.hits.payload.shape())
        wiring.connect(m, hits.source, wiring.flipped(self.hits))
        units = slot.place[_PAGE_LOW:]
        free, left = Signal(UNIT_BITS), Signal(signed(UNIT_BITS + 1))  # first unit not handed out, and how many there are
        fits, works, links, linked = Signal(), Signal(), Signal(), Signal()
        roomy = reduce(or_, (units[k] & left[k:].any() for k in range(1, self.slots + 1)))  # 2^k fit: no carry chain
        m.d.comb += [
            fits.eq(~self.full & ~left[-1] & (~slot.begins | roomy)),
            works.eq(slot.inside & fits),
            links.eq(works & slot.begins & ~linked),
        ]
        origin = self._origin(m, slot, free, advance, advance & works & slot.begins)
        room, quiet = self._requests(m, slot, links, works & (links | hits.sink.ready), origin, free)
        passes, hit = Signal(), slot.item.end | ~slot.inside | works
        m.d.comb += [
            passes.eq(Mux(slot.item.end, quiet, ~works | (room & ~links))),
            hits.sink.valid.eq(slot.valid & passes & hit),
            hits.sink.payload.tile.eq(slot.item.tile), hits.sink.payload.end.eq(slot.item.end),
            advance.eq(~slot.valid | passes & (hits.sink.ready | ~hit)),
        ]
        with m.If(advance):
            m.d.sync += linked.eq(0)
        with m.Elif(links & room):
            m.d.sync += linked.eq(1)
        with m.If(~begun):
            m.d.sync += [free.eq(self.tile_count), left.eq(self.entries_beats[BEAT_BITS - UNIT_BITS :] - self.tile_count)]
            with m.If(self.entries.valid & self.entries.ready):
                m.d.sync += self.full.eq(0)
        with m.Elif(advance & slot.inside):
            m.d.sync += self.full.eq(~fits)
            with m.If(works & slot.begins):
                m.d.sync += [free.eq(free + units), left.eq(left - units)]

    def _origin(self, m: Module, slot: _Slot, free: Signal, advance: Signal, begins: Value) -> Signal:
        """A slot's origin: kept for its tile where it `begins` a page."""
        m.submodules.origins = origins = memory.Memory(shape=UNIT_BITS, depth=frame_tiles(self.config), init=[])
        write, read = origins.write_port(), origins.read_port()
        before, origin = Signal(UNIT_BITS, reset_less=True), Signal(UNIT_BITS)
        units = slot.place[_PAGE_LOW:]
        with m.If(slot.begins):
            m.d.comb += origin.eq(free - units)
        with m.Elif(units == 1):  # a first page
            m.d.comb += origin.eq(slot.item.tile - 1)
        with m.Else():
            m.d.comb += origin.eq(Mux(slot.again, before, read.data))
        m.d.comb += [
            read.addr.eq(slot.next_tile), read.en.eq(advance),
            write.addr.eq(slot.item.tile), write.data.eq(origin), write.en.eq(begins),
        ]
        with m.If(advance):
            m.d.sync += before.eq(origin)
        return origin

    def _requests(
        self, m: Module, slot: _Slot, links: Signal, sends: Value, origin: Signal, free: Signal,
    ) -> tuple[Value, Value]:
        """The write of an entry or, with `links`, of the page it begins; whether it is taken, whether all are in memory."""
        m.submodules.write_buffer = writes = Buffer(self.writes.payload.shape())
        wiring.connect(m, writes.source, wiring.flipped(self.writes))
        request, room = writes.sink.payload, writes.sink.ready
        p = Pipeline(m, load=slot.valid & sends, advance=room)
        units, entry = slot.place[_PAGE_LOW:], Cat(slot.item[f.name] for f in tile_entry(self.config).fields)
        page = Cat(units[1 : 1 + self.slots], Const(0, DIRECTORY_SLOTS - self.slots))  # one bit of it, where one begins
        pairs = ((slot.place[:_BEAT_LOW] == i).replicate(WORDS // BEAT_ENTRIES) for i in range(BEAT_ENTRIES))
        parts = [page[i : i + WORDS] for i in range(0, DIRECTORY_SLOTS, WORDS)]
        pointer = Cat(Const(0, BEAT_BITS - UNIT_BITS), free, Const(0, 32 - BEAT_BITS))
        valid = p.control("valid", slot.valid & sends)
        linking = p.data("linking", links)
        words = p.reg("words", lambda link, *x: Mux(link, *x), linking, p.data("pointers", pointer.replicate(2)),
                      p.data("entry", Cat(entry, Const(0, 8 * ENTRY_BYTES - len(entry)))))
        strobe = p.reg("strobe", lambda link, *x: Mux(link, *x), linking, p.data("page", reduce(or_, parts)),
                       p.data("pair", Cat(*pairs)))
        unit = p.reg("unit", lambda x, y: (x + y)[:UNIT_BITS], p.data("origin", origin).to(1), p.data("units", units))
        linked_at = p.data("linked_at", slot.item.tile * DIRECTORY_BEATS + sum(part.any() * i for i, part in enumerate(parts)))
        low = p.data("low", slot.place[_BEAT_LOW:_PAGE_LOW])
        relative = p.reg("relative", lambda link, at, unit, low: Mux(link, at, Cat(low, unit)), linking, linked_at, unit, low)
        base = p.reg("base", lambda link: Mux(link, self.directory_base, self.entries_base), linking.to(unit.stage))
        beat = p.reg("beat", lambda base, x: (base + x)[:BEAT_BITS], base, relative)
        end = beat.stage
        m.d.comb += [
            writes.sink.valid.eq(valid.at(end)), request.beat.eq(beat.value), request.strobe.eq(strobe.at(end)),
            request.word.as_value().eq(words.at(end).replicate(BEAT_ENTRIES)),
        ]
        inside = reduce(or_, (valid.at(stage) for stage in range(1, end + 1)))
        return room, ~inside & ~self.writes.valid & self.writes_idle
