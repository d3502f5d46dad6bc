"""Reads a packed frame from memory for a display, band by band.

A band is a row of blocks, BLOCK_HEIGHT rows of pixels. The entries of its blocks come first, a beat of the table at a time, and
some beats ahead of the slots, so that no request waits for an entry. All requests go one way and all beats come back in their
order; one bit for each request says which beats are those of the table::

    cycle       0     1     2     3     4     5     6     7     8     9    10
    reads           < T0  >< T1  >                  <0.0  ><0.1  >      <1.0  >< T2  >       two blocks of tile 0 and 1 ...
    data                             < T0  >< T1  >                  <0.0  ><0.1  >
    blocks                                              <  0  >      <  1  >
    beats                                                            <0.0  ><0.1  >
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.tile_lists.beats import check_config, read_port
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES, frame_settings, read_data
from spec.packed import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    BLOCKS,
    ENTRIES,
    ENTRY_BITS,
    SLOT_BEATS,
    listed_block,
    packed_entry,
)
from spec.records import TILE_BITS, frame_tiles

BEAT_TILES = ENTRIES // BLOCKS
"""Tiles whose entries lie in a beat of the table."""

TABLES_AHEAD = 4
"""Beats of the table that have been requested and not been walked through."""

BLOCKS_AHEAD = 16
"""Blocks whose beats are requested before the block is taken."""

REQUESTS_AHEAD = 64
"""Requests whose beats have not come back."""

_SETTINGS = ("width", "height", "frame_base")
_LANE, _PART = (BEAT_TILES - 1).bit_length(), (BLOCKS - 1).bit_length()
_SHIFT, _TILE_SHIFT = (BLOCK_HEIGHT - 1).bit_length(), (BLOCK_WIDTH - 1).bit_length()

GROUP = data.StructLayout({"beat": 2 * TILE_BITS, "first": _LANE, "last": _LANE, "part": _PART})
"""A beat of the table: its number, the first and the last tile of it that the band has, and the band's place in its tiles."""


class FrameReader(wiring.Component):
    """Reads the table and the slots of a packed frame (`spec.packed`), and gives its blocks to a `BlockUnpacker`.

    Parameters:
        config: the machine; `row_width` is used.

    Ports:
        start: strobe; a frame is read. It must not come while `busy`.
        width, height, frame_base: settings of the frame; stable from a cycle before `start` on, while `busy`.
        tile_count: tiles of the frame; stable as well.
        reads, data: read port of memory.
        blocks: ListedBlock items: the blocks of a band from left to right, the bands from top to bottom. Where memory answers a
            beat of the table with an error, the sizes and checks of its blocks are 0.
        beats: ReadData items: the beats of these blocks, as many as their sizes say; none for an impossible size.
        busy: a frame is being read, or a block has not been taken.

    Storage: TABLES_AHEAD beats of the table and BLOCKS_AHEAD blocks. Throughput: a request a cycle, and a cycle more for every
    block; each beat of the table is read once for each of the BLOCKS bands that it has entries of. Latency: 2 cycles from
    `start` to the first request, and 4 cycles from a beat of the table to the first request for a block.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        super().__init__({
            "start": In(1), **{f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in _SETTINGS},
            "tile_count": In(range(frame_tiles(config) + 1)), **read_port(config),
            "blocks": Out(stream.Signature(layout(listed_block(config)))),
            "beats": Out(stream.Signature(layout(read_data(config)))), "busy": Out(1),
        })
        self._entry = layout(packed_entry(config))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.groups = groups = SyncFIFOBuffered(width=GROUP.size, depth=TABLES_AHEAD)
        m.submodules.tables = tables = SyncFIFOBuffered(width=8 * BEAT_BYTES, depth=TABLES_AHEAD)
        m.submodules.kinds = kinds = SyncFIFOBuffered(width=1, depth=REQUESTS_AHEAD)
        m.submodules.listed = listed = SyncFIFOBuffered(width=self.blocks.payload.shape().size, depth=BLOCKS_AHEAD)
        room, taken, ends = Signal(), Signal(), Signal()
        asks, group, walks = self._walk_table(m, groups.w_rdy, taken, ends)
        left, beat = self._walk_blocks(m, groups, tables, listed, room & ~asks, ends)
        reads = self.reads
        m.d.comb += [
            room.eq((~reads.valid | reads.ready) & kinds.w_rdy), taken.eq(room & asks),
            groups.w_data.eq(group), groups.w_en.eq(taken), kinds.w_data.eq(asks), kinds.w_en.eq(room & (asks | left.any())),
            self.blocks.payload.eq(listed.r_data), self.blocks.valid.eq(listed.r_rdy), listed.r_en.eq(self.blocks.ready),
            self.busy.eq(walks | groups.r_rdy | left.any() | kinds.r_rdy | listed.r_rdy | reads.valid)]
        with m.If(reads.ready):
            m.d.sync += reads.valid.eq(0)
        with m.If(kinds.w_en):
            table = self.frame_base + (self.tile_count << (SLOT_BEATS * BLOCKS - 1).bit_length()) + group.beat
            m.d.sync += [reads.valid.eq(1), reads.payload.beat.eq(Mux(asks, table, self.frame_base + beat))]
        is_table, there = kinds.r_data, self.data.valid & kinds.r_rdy
        m.d.comb += [
            self.data.ready.eq(kinds.r_rdy & Mux(is_table, tables.w_rdy, self.beats.ready)),
            kinds.r_en.eq(self.data.valid & self.data.ready),
            tables.w_en.eq(there & is_table), self.beats.valid.eq(there & ~is_table),
            tables.w_data.eq(Mux(self.data.payload.error, 0, self.data.payload.word.as_value())),
            self.beats.payload.eq(self.data.payload)]
        return m

    def _walk_table(
        self, m: Module, space: Signal, taken: Signal, ends: Signal,
    ) -> tuple[Signal, data.View, Signal]:
        """Goes through the bands and the beats of the table that each of them needs. Returns whether one is asked for, what it
        is, and whether any band is left."""
        columns, bands = Signal(TILE_BITS + 1, reset_less=True), Signal(TILE_BITS + 1 + _PART, reset_less=True)
        m.d.sync += [columns.eq((self.width + (BLOCK_WIDTH - 1)) >> _TILE_SHIFT),
                     bands.eq((self.height + (BLOCK_HEIGHT - 1)) >> _SHIFT)]
        walks, band, first, beat = Signal(), Signal.like(bands), Signal(2 * TILE_BITS), Signal(2 * TILE_BITS - _LANE)
        last, group, ahead = Signal.like(first), Signal(GROUP), Signal(range(TABLES_AHEAD + 1))
        asks, row_ends, part = Signal(), Signal(), band[:_PART]
        following = Mux(part == BLOCKS - 1, first + columns, first)
        m.d.comb += [
            last.eq(first + columns - 1), row_ends.eq(beat == last[_LANE:]), asks.eq(walks & space & (ahead != TABLES_AHEAD)),
            group.beat.eq(beat), group.first.eq(Mux(beat == first[_LANE:], first[:_LANE], 0)),
            group.last.eq(Mux(row_ends, last[:_LANE], BEAT_TILES - 1)), group.part.eq(part)]
        m.d.sync += ahead.eq(ahead + taken - ends)
        with m.If(self.start):
            m.d.sync += [walks.eq(1), band.eq(0), first.eq(0), beat.eq(0)]
        with m.Elif(taken):
            m.d.sync += beat.eq(beat + 1)
            with m.If(row_ends):
                m.d.sync += [band.eq(band + 1), first.eq(following), beat.eq(following[_LANE:]), walks.eq(band + 1 != bands)]
        return asks, group, walks

    def _walk_blocks(
        self, m: Module, groups: SyncFIFOBuffered, tables: SyncFIFOBuffered, listed: SyncFIFOBuffered, room: Signal,
        ends: Signal,
    ) -> tuple[Signal, Signal]:
        """Goes through the blocks of the oldest beat of the table, and lists them. Returns how many beats of a block are left
        to be asked for, and the place of the next one in the frame."""
        group, left, beat = data.View(GROUP, groups.r_data), Signal(range(SLOT_BEATS + 1)), Signal(BEAT_BITS)
        lane, begun, at = Signal(_LANE), Signal(), Signal(_LANE)
        entry, block, lists = Signal(self._entry), Signal(self.blocks.payload.shape()), Signal()
        m.d.comb += [
            at.eq(Mux(begun, lane, group.first)), entry.eq(tables.r_data.word_select(Cat(group.part, at), ENTRY_BITS)),
            block.block.eq(Cat(group.part, at, group.beat)), block.size.eq(entry.size), block.check.eq(entry.check),
            lists.eq(groups.r_rdy & tables.r_rdy & listed.w_rdy & ((left == 0) | (left == 1) & room)),
            listed.w_data.eq(block), listed.w_en.eq(lists), ends.eq(lists & (at == group.last)),
            groups.r_en.eq(ends), tables.r_en.eq(ends)]
        with m.If(left.any() & room):
            m.d.sync += [left.eq(left - 1), beat.eq(beat + 1)]
        with m.If(lists):
            m.d.sync += [
                lane.eq(at + 1), begun.eq(~ends), left.eq(Mux(entry.size > SLOT_BEATS, 0, entry.size)),
                beat.eq(block.block << (SLOT_BEATS - 1).bit_length())]
        return left, beat
