"""Writes pairs into the pages of their lists during the first phase, a whole beat at a time.

Places, pages and origins are those of `rtl.tile_lists.entry_writer`. The pairs of a beat come from different splats, and up to
BEAT_ENTRIES - 1 of each list wait in a memory for the others of their beat. Position k of a beat has a memory of its own, which
a pair either writes or, where it completes the beat, reads, so pairs of the same list may follow each other in any way::

    cycle        0        1        2        3        4      ...     7
    entries  < pair >
    place             <  66  >
    slot                       <  66  >                                  66 is position 2: the pair is written to line 2
    hits                                         < list >
    entries           < pair >
    place                      <  67  >
    slot                                <  67  >                         position 3: lines 0 to 2 are read
    writes                                                        < pairs 64 to 67 >

When the frame's `end` comes, it waits until all pairs have their places, and then while one item for each list passes the same
pipeline. It writes the beat of those pairs that still wait, and sets the list's place back for the next frame.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value, signed
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.tile_lists.beats import check_config
from rtl.tile_lists.entry_writer import BEAT_LOW, PAGE_LOW, UNIT_BITS, Slot, page_origins, several
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import (
    BEAT_BITS,
    BEAT_ENTRIES,
    DIRECTORY_BEATS,
    DIRECTORY_SLOTS,
    FIRST_PAGE_ENTRIES,
    WORDS,
    write_request,
)
from spec.records import frame_lists, intersection, intersection_item, intersection_tile
from spec.supertiles import check_supertiles


class _Source(NamedTuple):
    """What enters the pipeline: an item, or the flush of a list."""

    taken: Value
    item: data.View
    flush: Value


class PairWriter(wiring.Component):
    """Writes pairs (IntersectionItem, whose `tile` is the list) into memory, and passes the list of each on to the tile merge
    unit (IntersectionTile).

    Parameters:
        config: the machine; `row_width` and `list_heads` matter here.
        slots: number of pages that a list may have beyond its first, up to DIRECTORY_SLOTS.

    Ports:
        entries: the IntersectionItem items of a frame, then one with `end`. The next frame may follow at once.
        hits: an IntersectionTile for each pair, in order, then one with `end`, which leaves only when all pairs of the frame
            are in memory.
        writes: a whole beat for each BEAT_ENTRIES pairs of a list; before them, where a pair begins a page other than the
            first, a word of the directory; after the last pair a whole beat for each list of which pairs are left, by falling
            number. Its pairs beyond those mean nothing. Words that are not written repeat those that are.
        writes_idle: all writes that were taken are in memory.
        directory_base, entries_base, entries_beats: first beats of the directory and of the pairs, and the size of the region
            of pairs; stable while `busy`.
        list_count: number of lists of the frame, 1 or more; stable while `busy`.
        full: there was no free space for a pair: the region has too few beats for the frame's first pages or for the page that
            the pair needed, or its list has all its pages. This pair and all that follow are neither written nor passed on.
            High until the next frame's first item.
        busy: high from a frame's first item until nothing of it but the `end` at `hits` is inside, and while places are cleared
            after a reset.

    A pair whose list is outside the frame is passed on in any case, but not written.

    Storage: for every list a place of 23 bits, an origin of 24, and BEAT_ENTRIES - 1 pairs of 48. Throughput: one pair per
    cycle, whatever the lists, and one cycle more for each page other than a first one. Latency: 3 cycles to `hits`, 7 to
    `writes`. A frame's `end` takes one cycle per list of the frame, and the latency of memory. After a reset, the places are
    cleared, which takes one cycle per list of the largest frame.
    """

    def __init__(self, config: AcceleratorConfig, *, slots: int = DIRECTORY_SLOTS):
        check_config(config)
        check_supertiles(config)
        if intersection(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"list_heads must let an Intersection fit {8 * ENTRY_BYTES} bits, not {config.list_heads!r}")
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
            "list_count": In(range(frame_lists(config) + 1)),
            "full": Out(1), "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        advance, passed, begins, begun = Signal(), Signal(), Signal(), Signal()
        placed, works = Signal(), Signal()
        clearing = Signal(range(frame_lists(self.config)), init=frame_lists(self.config) - 1)
        source, clears = self._sequence(m, advance, placed, passed, begins, begun, clearing)
        slot, flush = self._places(m, source, advance, works, placed, clears, clearing)
        self._pages(m, slot, flush, advance, works, begins, begun)
        m.d.comb += passed.eq(slot.valid & slot.item.end & advance)
        return m

    def _sequence(
        self, m: Module, advance: Signal, placed: Signal, passed: Signal, begins: Signal, begun: Signal, clearing: Signal,
    ) -> tuple[_Source, Signal]:
        """Clears places after a reset, then takes frames: pairs, a flush of each list, `end`. Returns what enters the pipeline,
        and whether a place is cleared. `placed`: all pairs have left the slot, and `passed`: `end` does; `begins`: a frame
        begins; `begun`: its `end` has not left yet."""
        taken, flush, clears, offered = Signal(), Signal(), Signal(), self.entries.valid
        item = Signal(self.entries.payload.shape())
        m.d.comb += [item.eq(self.entries.payload), self.busy.eq(begun | clears)]
        with m.FSM():
            with m.State("CLEAR"):
                m.d.comb += clears.eq(1)
                m.d.sync += clearing.eq(clearing - 1)
                with m.If(clearing == 0):
                    m.next = "TAKE"
            with m.State("TAKE"):
                ends = self.entries.payload.end
                m.d.comb += [
                    self.entries.ready.eq(advance & ~ends), taken.eq(offered & ~ends), begins.eq(offered & ~begun)]
                m.d.sync += [clearing.eq(self.list_count - 1), begun.eq(begun | offered)]
                with m.If(offered & ends & placed):
                    m.next = "FLUSH"
            with m.State("FLUSH"):
                m.d.comb += [taken.eq(1), flush.eq(1), item.tile.eq(clearing), item.end.eq(0)]
                with m.If(advance):
                    m.d.sync += clearing.eq(clearing - 1)
                    with m.If(clearing == 0):
                        m.next = "END"
            with m.State("END"):
                m.d.comb += [self.entries.ready.eq(advance), taken.eq(1)]
                with m.If(advance):
                    m.next = "LAST"
            with m.State("LAST"):
                with m.If(passed):
                    m.d.sync += begun.eq(0)
                    m.next = "TAKE"
        return _Source(taken, item, flush), clears

    def _places(
        self, m: Module, source: _Source, advance: Signal, works: Signal, placed: Signal, clears: Signal, clearing: Signal,
    ) -> tuple[Slot, Signal]:
        """Finds the places of pairs. Returns the slot, in which the page is chosen, and whether it holds the flush of a list.
        What the slot finds is written back in its cycle; the next two pairs of the same list take it from registers, as in
        `rtl.tile_lists.entry_writer`. A pair that has no place in memory leaves its
        list's place as it is; `works`: the slot holds a pair that has one. `placed`: no item is inside."""
        lists, bits = frame_lists(self.config), (FIRST_PAGE_ENTRIES << self.slots + 1).bit_length()
        m.submodules.places = places = memory.Memory(shape=bits, depth=lists, init=[])
        write, read = places.write_port(), places.read_port()
        item = source.item
        valid, entry, inside, flushed = Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal()
        again, again_later, place, flush = Signal(), Signal(), Signal(bits), Signal()
        summed, before = Signal(bits, reset_less=True), Signal(bits, reset_less=True)  # not yet in the memory
        slot = Slot(
            Signal(), Signal(item.shape(), reset_less=True), Signal(), Signal(bits, reset_less=True), Signal(reset_less=True),
            Signal(reset_less=True), entry.tile)
        m.d.comb += [
            read.addr.eq(item.tile), read.en.eq(advance),
            place.eq(Mux(again, summed, Mux(again_later, before, read.data))),
            write.addr.eq(Mux(clears, clearing, slot.item.tile)), write.en.eq(clears | advance & (works | flush)),
            write.data.eq(Mux(clears | flush, FIRST_PAGE_ENTRIES, summed)), placed.eq(~valid & ~slot.valid),
        ]
        with m.If(advance):
            m.d.sync += [valid.eq(source.taken), entry.eq(item), flushed.eq(source.flush)]
            m.d.sync += inside.eq(source.taken & ~item.end & (item.tile < self.list_count))
            m.d.sync += [again.eq(inside & (entry.tile == item.tile)), summed.eq(place + 1)]
            m.d.sync += [again_later.eq(slot.inside & (slot.item.tile == item.tile)), before.eq(summed)]
            m.d.sync += [slot.valid.eq(valid), slot.item.eq(entry), slot.inside.eq(inside), slot.place.eq(place)]
            m.d.sync += [slot.begins.eq(~several(place) & ~place[PAGE_LOW] & ~flushed), flush.eq(flushed)]
            m.d.sync += slot.again.eq(slot.inside & (slot.item.tile == entry.tile))
        return slot, flush

    def _pages(
        self, m: Module, slot: Slot, flush: Signal, advance: Signal, works: Signal, begins: Signal, begun: Signal,
    ) -> None:
        """Finds the page of the pair in the slot, allocates it where it begins there, and drives both outputs. `works`: there
        is a pair in the slot, and it has a place in memory."""
        m.submodules.hit_buffer = hits = Buffer(self.hits.payload.shape())
        wiring.connect(m, hits.source, wiring.flipped(self.hits))
        units, position = slot.place[PAGE_LOW:], slot.place[:BEAT_LOW]
        # the first free unit, and the number of free units; both are set between frames
        free, left = Signal(UNIT_BITS, reset_less=True), Signal(signed(UNIT_BITS + 1), reset_less=True)
        fits, links, linked, rest = Signal(), Signal(), Signal(), Signal()
        roomy = reduce(or_, (units[k] & left[k:].any() for k in range(1, self.slots + 1)))  # 2^k units fit; no carry chain
        m.d.comb += [
            fits.eq(~self.full & ~left[-1] & (~slot.begins | roomy)),
            works.eq(slot.inside & ~flush & fits),
            rest.eq(flush & position.any()),  # a flush with something to write
            links.eq(works & slot.begins & ~linked),
        ]
        origin = page_origins(m, frame_lists(self.config), slot, free, advance, advance & works & slot.begins)
        sends = links | works & position.all() & hits.sink.ready | rest
        room, quiet = self._requests(m, slot, links, sends, origin, free, advance & works)
        passes, hit = Signal(), slot.item.end | ~slot.inside | works
        m.d.comb += [
            passes.eq(Mux(slot.item.end, quiet, ~works & ~rest | (room & ~links))),
            hits.sink.valid.eq(slot.valid & passes & hit),
            hits.sink.payload.tile.eq(slot.item.tile), hits.sink.payload.end.eq(slot.item.end),
            advance.eq(~slot.valid | passes & (hits.sink.ready | ~hit)),
        ]
        with m.If(advance):
            m.d.sync += linked.eq(0)
        with m.Elif(links & room):
            m.d.sync += linked.eq(1)
        with m.If(~begun):
            m.d.sync += [free.eq(self.list_count), left.eq(self.entries_beats[BEAT_BITS - UNIT_BITS :] - self.list_count)]
            with m.If(begins):
                m.d.sync += self.full.eq(0)
        with m.Elif(advance & slot.inside & ~flush):
            m.d.sync += self.full.eq(~fits)
            with m.If(works & slot.begins):
                m.d.sync += [free.eq(free + units), left.eq(left - units)]

    def _lines(self, m: Module, slot: Slot, waits: Value, moves: Value) -> list[Signal]:
        """The pairs that wait for the beat of the list in the slot, one cycle later, by position. Where the pair in the slot
        itself `waits`, it is stored; `moves`: the cycle after the slot is free."""
        pair, read_out = Cat(slot.item.index, slot.item.depth_key), []
        for position in range(BEAT_ENTRIES - 1):
            line = memory.Memory(shape=len(pair), depth=frame_lists(self.config), init=[])
            m.submodules[f"line_{position}"] = line
            write, read = line.write_port(), line.read_port()
            m.d.comb += [
                write.addr.eq(slot.item.tile), write.data.eq(pair),
                write.en.eq(waits & (slot.place[:BEAT_LOW] == position)),
                read.addr.eq(slot.item.tile), read.en.eq(moves),
            ]
            read_out.append(read.data)
        return read_out

    def _requests(
        self, m: Module, slot: Slot, links: Signal, sends: Value, origin: Signal, free: Signal, works: Value,
    ) -> tuple[Value, Value]:
        """Sends the beat of the pair in the slot or, with `links`, the pointer to the page that it begins. `works`: the pair
        leaves the slot. Returns whether the write is taken, and whether all writes are in memory."""
        m.submodules.write_buffer = writes = Buffer(self.writes.payload.shape())
        wiring.connect(m, writes.source, wiring.flipped(self.writes))
        request, room = writes.sink.payload, writes.sink.ready
        p = Pipeline(m, load=slot.valid & sends, advance=room)
        units, pair = slot.place[PAGE_LOW:], Cat(slot.item.index, slot.item.depth_key)
        page = Cat(units[1 : 1 + self.slots], Const(0, DIRECTORY_SLOTS - self.slots))  # one-hot where a page begins
        parts = [page[i : i + WORDS] for i in range(0, DIRECTORY_SLOTS, WORDS)]
        pointer = Cat(Const(0, BEAT_BITS - UNIT_BITS), free, Const(0, 32 - BEAT_BITS))
        valid = p.control("valid", slot.valid & sends)
        linking, itself, number = p.data("linking", links), p.data("pair", pair), p.data("list", slot.item.tile)
        waiting = Cat(self._lines(m, slot, works & ~slot.place[:BEAT_LOW].all(), room))

        def beat_words(link: Value, pointer: Value, itself: Value, number: Value) -> Value:
            pairs = [*(waiting.word_select(i, len(pair)) for i in range(BEAT_ENTRIES - 1)), itself]
            gap = Const(0, 8 * ENTRY_BYTES - len(pair) - len(number))
            return Mux(link, pointer.replicate(WORDS), Cat(Cat(pair, number, gap) for pair in pairs))

        words = p.reg("words", beat_words, linking.to(1), p.data("pointers", pointer), itself, number)
        strobe = p.reg("strobe", lambda link, page: Mux(link, page, (1 << WORDS) - 1), linking,
                       p.data("page", reduce(or_, parts)))
        unit = p.reg("unit", lambda x, y: (x + y)[:UNIT_BITS], p.data("origin", origin).to(1), p.data("units", units))
        linked_at = p.data("linked_at", slot.item.tile * DIRECTORY_BEATS + sum(part.any() * i for i, part in enumerate(parts)))
        low = p.data("low", slot.place[BEAT_LOW:PAGE_LOW])
        relative = p.reg("relative", lambda link, at, unit, low: Mux(link, at, Cat(low, unit)), linking, linked_at, unit, low)
        base = p.reg("base", lambda link: Mux(link, self.directory_base, self.entries_base), linking.to(unit.stage))
        beat = p.reg("beat", lambda base, x: (base + x)[:BEAT_BITS], base, relative)
        end = beat.stage
        m.d.comb += [
            writes.sink.valid.eq(valid.at(end)), request.beat.eq(beat.value), request.strobe.eq(strobe.at(end)),
            request.word.as_value().eq(words.at(end)),
        ]
        inside = reduce(or_, (valid.at(stage) for stage in range(1, end + 1)))
        return room, ~inside & ~self.writes.valid & self.writes_idle
