"""Writes intersections into the pages of their tiles during the geometry phase.

The place of a tile's next intersection is n + FIRST_PAGE_ENTRIES, where n is the number of the tile's intersections so far. The
top bit of a place tells its page, and a place that is a power of two begins a page. Let

    origin = page's first beat - (place of the page's first intersection, in beats).

Then the beat of an intersection is origin + (its place, in beats), and no bits of the place need be masked. Places and origins
lie in two memories that are read one after the other. The place of a tile is read, incremented and written back in a short
pipeline; where one of the next two intersections has the same tile, it takes the place from that pipeline instead of the
memory. The waveform shows an intersection that begins a page, as its place is a power of two. It takes two cycles, because the
pointer to the page is also written, into the directory::

    cycle        0        1        2        3        4      ...      7          8
    entries  < tile 7 >
    place             <   64   >
    origin                     < free page - 64 >
    hits                                         < tile 7 >
    writes                                                    <directory>< intersection >

Pages are allocated in units of the size of a first page, FIRST_PAGE_BEATS.
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
from rtl.stream import Buffer, Skid
from rtl.tile_lists.beats import check_config
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import (
    BEAT_BITS,
    BEAT_ENTRIES,
    DIRECTORY_BEATS,
    DIRECTORY_SLOTS,
    FIRST_PAGE_BEATS,
    FIRST_PAGE_ENTRIES,
    WORDS,
    write_request,
)
from spec.records import frame_tiles, intersection, intersection_item, intersection_tile

UNIT_BITS = BEAT_BITS - (FIRST_PAGE_BEATS - 1).bit_length()
"""Bits of a page's first unit."""

PAGE_LOW, BEAT_LOW = (FIRST_PAGE_ENTRIES - 1).bit_length(), (BEAT_ENTRIES - 1).bit_length()
"""Bits of a place's position in its unit, and in its beat."""


def several(value: Value) -> Value:
    """Whether more than one bit is set, without a carry chain."""
    if len(value) == 1:
        return Const(0, 1)
    low, high = value[: len(value) // 2], value[len(value) // 2 :]
    return several(low) | several(high) | low.any() & high.any()


class Slot(NamedTuple):
    """The pipeline stage in which an intersection's page is chosen."""

    valid: Signal
    item: Signal
    inside: Signal  # the item is an intersection of a tile of the frame
    place: Signal
    begins: Signal  # the place begins a page other than the first
    again: Signal  # the item before had the same tile
    next_tile: Value  # tile of the item in the stage before


def page_origins(m: Module, tiles: int, slot: Slot, free: Signal, advance: Signal, begins: Value) -> Signal:
    """The origin for the intersection in the slot, from a memory of `tiles` origins; it is stored for the tile where a page
    `begins`."""
    m.submodules.origins = origins = memory.Memory(shape=UNIT_BITS, depth=tiles, init=[])
    write, read = origins.write_port(), origins.read_port()
    before, origin = Signal(UNIT_BITS, reset_less=True), Signal(UNIT_BITS)
    units, allocated = slot.place[PAGE_LOW:], Signal(UNIT_BITS)
    m.d.comb += allocated.eq(free - units)
    with m.If(slot.begins):
        m.d.comb += origin.eq(allocated)
    with m.Elif(units == 1):  # a first page
        m.d.comb += origin.eq(slot.item.tile - 1)
    with m.Else():
        m.d.comb += origin.eq(Mux(slot.again, before, read.data))
    m.d.comb += [
        read.addr.eq(slot.next_tile), read.en.eq(advance),
        write.addr.eq(slot.item.tile), write.data.eq(allocated), write.en.eq(begins),
    ]
    with m.If(advance):
        m.d.sync += before.eq(origin)
    return origin


class IntersectionWriter(wiring.Component):
    """Writes intersections (IntersectionItem) into memory, and passes the tile of each on to the tile merge unit
    (IntersectionTile).

    Parameters:
        config: the machine; `row_width` matters here.
        slots: number of pages that a tile may have beyond its first, up to DIRECTORY_SLOTS.

    Ports:
        entries: the IntersectionItem items of a frame, then one with `end`. The next frame may follow at once.
        hits: an IntersectionTile for each intersection, in order, then one with `end`, which leaves only when all writes of
            the frame are in memory.
        writes: one write for each intersection, in order, and before it one for a word of the directory where the intersection
            begins a page other than the first. Words that are not written repeat those that are.
        writes_idle: all writes that were taken are in memory.
        directory_base, entries_base, entries_beats: first beats of the directory and of the intersections, and the size of the
            region of intersections; stable while `busy`.
        tile_count: number of tiles of the frame, 1 or more; stable from the cycle before a frame's first item while `busy`.
        full: there was no free space for an intersection: the region has too few beats for the frame's first pages or for the
            page that the intersection needed, or its tile has all its pages. This intersection and all that follow are neither
            written nor passed on. High until the next frame's first item.
        busy: high from a frame's first item until the places have been cleared after its `end`, and while they are cleared
            after a reset.

    An intersection whose tile is outside the frame is passed on in any case, but not written.

    Storage: for every tile of the largest frame a place of 23 bits and an origin of 24, for PAPER 14,400 x 47 bits; and one
    intersection that may be taken while the writer does not move.
    Throughput: one intersection per cycle, whatever the tiles, and one cycle more for each page other than a first one.
    Latency: 3 cycles to `hits`, 7 to `writes`. After a frame's `end` the places are cleared, one cycle per tile of the frame,
    while its lists are read; the next frame's intersections would have to wait. After a reset clearing takes one cycle per tile
    of the largest frame.

    The intersections of a splat lie in different tiles, so each is a write of its own, of a quarter of a beat.
    reports/write_combining.md (`msv2 study run write_combining`) shows what would be saved if beats waited for more
    intersections of their tile: in frames of 1920x1080 it takes 4,096 lines of 256 bits to save much, which is more storage
    than PAPER's places and origins together.
    """

    def __init__(self, config: AcceleratorConfig, *, slots: int = DIRECTORY_SLOTS):
        check_config(config)
        if intersection(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"row_width must let an Intersection fit {8 * ENTRY_BYTES} bits, not {config.row_width!r}")
        if not isinstance(slots, int) or isinstance(slots, bool):
            raise TypeError(f"slots must be an integer, not {slots!r}")
        if not 1 <= slots <= DIRECTORY_SLOTS:
            raise ValueError(f"slots must be in 1..{DIRECTORY_SLOTS}, not {slots!r}")
        self.config, self.slots = config, slots
        super().__init__({
            "entries": In(stream.Signature(layout(intersection_item(config)))),
            "hits": Out(stream.Signature(layout(intersection_tile(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            "directory_base": In(BEAT_BITS), "entries_base": In(BEAT_BITS), "entries_beats": In(BEAT_BITS),
            "tile_count": In(range(frame_tiles(config) + 1)),
            "full": Out(1), "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        advance, passed, begun, taken = Signal(), Signal(), Signal(), Signal()
        self._tiles = Signal.like(self.tile_count, name="tiles", reset_less=True)  # a copy, as the port comes from far away
        m.d.sync += self._tiles.eq(self.tile_count)
        m.submodules.taking = entries = Skid(self.entries.payload.shape())  # `advance` comes late, and the tile test is long
        wiring.connect(m, wiring.flipped(self.entries), entries.sink)
        m.d.comb += taken.eq(entries.source.valid & entries.source.ready)
        slot = self._places(m, entries.source, taken, advance, passed, begun)
        self._pages(m, slot, advance, begun, taken)
        m.d.comb += passed.eq(slot.valid & slot.item.end & advance)
        return m

    def _places(
        self, m: Module, entries: stream.Interface, taken: Signal, advance: Signal, passed: Signal, begun: Signal,
    ) -> Slot:
        """Finds the places of intersections, and clears all places. Returns the slot, in which the page is chosen. `taken`: an
        item of `entries` is taken; `passed`: the frame's end leaves the slot.

        The place of a tile is read in the cycle before the slot; the incremented place is written in the slot's cycle, because
        one cycle has time for the read, a multiplexer and an adder, but not for the write as well. So the next two
        intersections of the same tile must take the place from registers: `summed` if the one just before had the same tile,
        `before` if only the one before that had::

            entries          < A >< B >< C >
            read                  < A >< B >< C >    B has A's tile: `summed`; C has A's tile, but B does not: `before`
            slot, written              < A >< B >
        """
        tiles, bits = frame_tiles(self.config), (FIRST_PAGE_ENTRIES << self.slots + 1).bit_length()
        m.submodules.places = places = memory.Memory(shape=bits, depth=tiles, init=[])
        write, read = places.write_port(), places.read_port()
        item, clearing = entries.payload, Signal(range(tiles), init=tiles - 1)
        valid, entry, inside, again = Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal()
        again_later, place = Signal(), Signal(bits)
        summed, before = Signal(bits, reset_less=True), Signal(bits, reset_less=True)  # not yet in the memory
        slot = Slot(
            Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal(bits, reset_less=True), Signal(reset_less=True),
            Signal(reset_less=True), entry.tile)
        m.d.comb += [
            read.addr.eq(item.tile), read.en.eq(advance),
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
                m.d.comb += entries.ready.eq(advance)
                with m.If(taken):
                    m.d.sync += begun.eq(1)
                    with m.If(item.end):
                        m.next = "LAST"
            with m.State("LAST"):
                m.d.sync += clearing.eq(self._tiles - 1)
                with m.If(passed):
                    m.next = "CLEAR"
        with m.If(advance):
            m.d.sync += [valid.eq(taken), entry.eq(item), inside.eq(taken & ~item.end & (item.tile < self._tiles))]
            m.d.sync += [again.eq(inside & (entry.tile == item.tile)), summed.eq(place + 1)]
            m.d.sync += [again_later.eq(slot.inside & (slot.item.tile == item.tile)), before.eq(summed)]
            m.d.sync += [slot.valid.eq(valid), slot.item.eq(entry), slot.inside.eq(inside), slot.place.eq(place)]
            m.d.sync += slot.begins.eq(~several(place) & ~place[PAGE_LOW])
            m.d.sync += slot.again.eq(slot.inside & (slot.item.tile == entry.tile))
        return slot

    def _pages(self, m: Module, slot: Slot, advance: Signal, begun: Signal, taken: Signal) -> None:
        """Finds the page of the intersection in the slot, allocates it where it begins there, and drives both outputs."""
        m.submodules.hit_buffer = hits = Buffer(self.hits.payload.shape())
        wiring.connect(m, hits.source, wiring.flipped(self.hits))
        units = slot.place[PAGE_LOW:]
        # the first free unit, and the number of free units; both are set between frames
        free, left = Signal(UNIT_BITS, reset_less=True), Signal(signed(UNIT_BITS + 1), reset_less=True)
        fits, works, links, linked = Signal(), Signal(), Signal(), Signal()
        roomy = reduce(or_, (units[k] & left[k:].any() for k in range(1, self.slots + 1)))  # 2^k units fit; no carry chain
        m.d.comb += [
            fits.eq(~self.full & ~left[-1] & (~slot.begins | roomy)),
            works.eq(slot.inside & fits),
            links.eq(works & slot.begins & ~linked),
        ]
        origin = page_origins(m, frame_tiles(self.config), slot, free, advance, advance & works & slot.begins)
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
            m.d.sync += [free.eq(self._tiles), left.eq(self.entries_beats[BEAT_BITS - UNIT_BITS :] - self._tiles)]
            with m.If(taken):
                m.d.sync += self.full.eq(0)
        with m.Elif(advance & slot.inside):
            m.d.sync += self.full.eq(~fits)
            with m.If(works & slot.begins):
                m.d.sync += [free.eq(free + units), left.eq(left - units)]

    def _requests(
        self, m: Module, slot: Slot, links: Signal, sends: Value, origin: Signal, free: Signal,
    ) -> tuple[Value, Value]:
        """Sends the write of an intersection or, with `links`, of the pointer to the page that it begins. Returns whether the
        write is taken, and whether all writes are in memory."""
        m.submodules.write_buffer = writes = Buffer(self.writes.payload.shape())
        wiring.connect(m, writes.source, wiring.flipped(self.writes))
        request, room = writes.sink.payload, writes.sink.ready
        p = Pipeline(m, load=slot.valid & sends, advance=room)
        units, entry = slot.place[PAGE_LOW:], Cat(slot.item[f.name] for f in intersection(self.config).fields)
        page = Cat(units[1 : 1 + self.slots], Const(0, DIRECTORY_SLOTS - self.slots))  # one-hot where a page begins
        pairs = ((slot.place[:BEAT_LOW] == i).replicate(WORDS // BEAT_ENTRIES) for i in range(BEAT_ENTRIES))
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
        low = p.data("low", slot.place[BEAT_LOW:PAGE_LOW])
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
