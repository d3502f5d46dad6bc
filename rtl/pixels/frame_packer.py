"""Writes the array's rows of pixels to memory as a packed frame.

Rows become rows of blocks, and these become beats. Each beat goes to its block's slot. The entries of blocks are gathered in a
beat of the table, which is written when an entry of another beat comes, when it is complete, or at the end of the frame: tiles
that follow each other in a row share it. Words whose entries have not come are not written. In joint frames an entry of the
other eye is one of another beat::

    cycle         0     1     2     3     4     5     6     7     8     9
    beats       <40.0 ><40.1.><41.0.><42.0.>      <43.0 ><43.1.><44.0 >        block and beat; a dot marks a block's last one
    writes      <40.0 ><40.1 ><41.0 ><42.0 >      <43.0 ><43.1 ><44.0 >< 40..>
                                                                                where the table's beat became complete
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring

from rtl.pixels.block_packer import BlockPacker
from rtl.pixels.block_rows import BlockRows
from rtl.shapes import layout
from rtl.vrc_array.pixel_writer import frame_writer_ports
from spec.config import AcceleratorConfig
from spec.memory import WORD_BITS, WORDS, write_request
from spec.packed import BLOCKS, ENTRIES, ENTRY_BITS, SLOT_BEATS

_SETTINGS = ("width", "height", "frame_base")
_LOW = (ENTRIES - 1).bit_length()


class FramePacker(wiring.Component):
    """Turns the array's pixel rows into the memory writes of a packed frame (`spec.packed`).

    Parameters:
        config: the machine; `cores_x`, `cores_y` and `row_width` are used.

    Ports:
        rows: PixelRow items, tiles in any order, the rows of a tile as the array gives them.
        writes: the memory's write port. A block's beats are written whole; words of the table whose strobe is low are 0.
        writes_idle: the memory has completed all writes that it took.
        width, height, frame_base: settings of the frame; stable from `begin` to `finished`.
        joint, target_frame_base: in machines with joint frames, settings of the frame: blocks of the target go there.
        tile_count: tiles of the frame, or of either eye of a joint frame.
        begin: strobe before a frame's first row; clears `finished` and `pixels`.
        pixels: the frame's pixels that have come since `begin`, up to two cycles before; always 0 without `config.counters`.
        finished: all rows of `tile_count` tiles, in joint frames twice as many, have arrived since `begin`, and memory has all
            blocks and the table, or both tables. Stays high until `begin`.
        busy: a row is inside.

    Storage: 13 rows, five beats and a beat of the table. Throughput: a row of 16 pixels a cycle and a beat a cycle, whichever
    takes longer; the table takes a beat for ENTRIES / BLOCKS tiles that follow each other. Latency: as `BlockPacker`, and 2
    cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        self._rows, self._packer, self._config = BlockRows(config), BlockPacker(config), config
        super().__init__(frame_writer_ports(config, _SETTINGS))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.rows, m.submodules.packer = rows, packer = self._rows, self._packer
        wiring.connect(m, wiring.flipped(self.rows), rows.rows)
        wiring.connect(m, rows.block_rows, packer.rows)
        m.d.comb += [rows.width.eq(self.width), rows.height.eq(self.height)]
        beat, taken, room, complete = packer.beats.payload, Signal(), Signal(), Signal()
        due, table = self._table(m, packer.beats, taken, room, complete)
        moves = packer.beats.valid & (beat.size != 0)
        m.d.comb += [
            room.eq(~self.writes.valid | self.writes.ready), taken.eq(packer.beats.valid & packer.beats.ready),
            packer.beats.ready.eq(~due & room)]
        out = self.writes.payload
        with m.If(room):
            m.d.sync += self.writes.valid.eq(due | moves)
            with m.If(due):
                m.d.sync += out.eq(table)
            with m.Elif(moves):
                slot = beat.block << (SLOT_BEATS - 1).bit_length()
                m.d.sync += [out.word.eq(beat.word), out.strobe.eq((1 << WORDS) - 1),
                             out.beat.eq(self._base(beat.eye if self._config.joint else None) + slot + beat.size - 1)]
        m.d.comb += self.busy.eq(rows.busy | packer.busy | self.writes.valid)
        self._count(m, beat, taken, complete, due)
        return m

    def _base(self, eye: Value | None) -> Value:
        """The first beat of an eye's frame; None stands for the only one."""
        return self.frame_base if eye is None else Mux(eye, self.target_frame_base, self.frame_base)

    def _table(
        self, m: Module, beats: stream.Interface, taken: Value, room: Value, complete: Value,
    ) -> tuple[Value, data.View]:
        """Keeps a beat of the table. Returns whether it must be written before anything else, and its write."""
        beat, arrived, due = beats.payload, Signal(ENTRIES), Signal()
        entries = [Signal(ENTRY_BITS, name=f"entry_{n}", reset_less=True) for n in range(ENTRIES)]
        number, others = beat.block[:_LOW], beat.block[_LOW:]
        if self._config.joint:
            others = Cat(others, beat.eye)
        place, table = Signal.like(others, reset_less=True), Signal(layout(write_request(self._config)))
        base, low = (self._base(place[-1]), place[:-1]) if self._config.joint else (self.frame_base, place)
        each = WORD_BITS // ENTRY_BITS
        m.d.comb += [
            due.eq(arrived.any() & (arrived.all() | complete | beats.valid & beat.last & (place != others))),
            table.word.eq(Cat(Mux(arrived.bit_select(n, 1), entry, 0) for n, entry in enumerate(entries))),
            table.strobe.eq(Cat(arrived[each * n : each * (n + 1)].any() for n in range(WORDS))),
            table.beat.eq(base + (self.tile_count << (SLOT_BEATS * BLOCKS - 1).bit_length()) + low)]
        with m.If(due & room):
            m.d.sync += arrived.eq(0)
        with m.If(taken & beat.last):
            m.d.sync += [place.eq(others), arrived.eq(arrived | 1 << number)]
            for n, entry in enumerate(entries):
                with m.If(number == n):
                    m.d.sync += entry.eq(Cat(beat.size, beat.check))
        with m.If(self.begin):
            m.d.sync += arrived.eq(0)
        return due, table

    def _count(self, m: Module, beat: data.View, taken: Value, complete: Signal, due: Value) -> None:
        """Counts tiles whose blocks have left, and pixels that have come."""
        tiles, count, rows = Signal.like(self.tile_count), self.tile_count, self._rows.block_rows
        if self._config.joint:
            tiles, count = Signal(len(count) + 1), Mux(self.joint, count << 1, count)
        with m.If(taken & beat.last & beat.block[: (BLOCKS - 1).bit_length()].all()):
            m.d.sync += tiles.eq(tiles + 1)
        came = Signal.like(rows.payload.inside)
        if self._config.counters:
            m.d.sync += [came.eq(Mux(rows.valid & rows.ready, rows.payload.inside, 0)), self.pixels.eq(self.pixels + came)]
        with m.If(self.begin):
            m.d.sync += [tiles.eq(0), came.eq(0), self.pixels.eq(0)]
        m.d.comb += [complete.eq(tiles == count), self.finished.eq(complete & ~due & ~self.busy & self.writes_idle)]
