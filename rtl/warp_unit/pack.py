"""Groups of a column's pixels to beats of a row's.

Eight neighbours of a row share a beat, and rows begin anywhere in one. Each lane collects its rows' beats in a memory with a
word for each row and parity of the beat's address: a pixel is written into its place of the word. Where a pixel completes its
beat, or its row, the group goes into a queue, and its complete beats leave one by one while the columns that follow fill the
words of the other parity. A word is used again nine columns later, in which every group of rows has gone through the queue at
least once, those below the frame too, without a beat: so the queue, no longer than a column has groups, holds the scan back
before it could overrun a beat::

    cycle            0      1      2      3      4      5
    filled       <  A  ><  B  ><  C  >                       A completes three beats, B one, C none
    queue               <  A  ><  A  ><  A  ><  B  >
    read                   A0     A1     A3     B2
    writes                     < A0  >< A1  >< A3  >< B2  >
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.warp_unit.fill import filled_layout
from rtl.warp_unit.queue import column_bits, sub_bits, sub_rows
from rtl.warp_unit.window import painted_layout, picked
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, WORDS, frame_settings, write_request

_WORD_BITS = (WORDS - 1).bit_length()

ADDRESS_BITS = BEAT_BITS + _WORD_BITS
"""Bits of a pixel's address: words."""


def queue_groups(config: AcceleratorConfig) -> int:
    """Groups with complete beats that may wait: of a column where all rows are complete, those left at its end."""
    groups = sub_rows(config)
    waiting = max(2, groups - groups // config.warp_lanes + 1)
    return min(groups, 1 << (waiting - 1).bit_length())


def _complete_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A group that completes beats: the lanes to write of, which of their rows, the address of lane 0's pixel, its column."""
    return data.StructLayout({"lanes": config.warp_lanes, "sub": sub_bits(config), "word": ADDRESS_BITS, "near": _WORD_BITS,
                              "far": 1})


class Pack(wiring.Component):
    """Groups to writes.

    Parameters:
        config: the machine; `row_width` and `warp_lanes` matter here.

    Ports:
        start: strobe before a strip; nothing is inside.
        base: address of the strip's first pixel in words, taken with `start`.
        width, last, rows: columns of the frame, the last one, rows of the strip that lie in it.
        filled: the strip's groups, down every column, left to right; a group comes once for every hole that is filled.
        writes: the memory's; words whose strobe is low are 0. In the order in which beats are complete, higher rows first.
        commits, column_ends, strip_ends: strobes, a group's last slot is taken; it is the last of its column, and of the strip.
        column: its column.
        busy: a beat is inside.

    Storage: two beats of 25-bit pixels a row; the queue. Throughput: a group a cycle while no more than a beat a cycle becomes
    complete, which is 8 pixels. Latency: 2 cycles from a beat's last pixel.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "start": In(1), "base": In(ADDRESS_BITS), "rows": In(range(TILE + 1)),
            "width": In(next(f.width for f in frame_settings(config).fields if f.name == "width")),
            "last": In(column_bits(config)),
            "filled": In(stream.Signature(filled_layout(config))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "commits": Out(1), "column_ends": Out(1), "strip_ends": Out(1), "column": Out(column_bits(config)), "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        lanes = range(self.config.warp_lanes)
        commits, sub, word = self.commits, Signal(range(sub_rows(self.config))), Signal(ADDRESS_BITS, reset_less=True)
        self._walk(m, commits, sub, word)
        reads = []
        complete = Signal(len(lanes))
        for lane in lanes:
            reads.append(self._store(m, lane, sub, word, complete[lane]))
        head, head_valid, room, pops = self._queue(m, commits, sub, word, complete)
        fits, group = Signal(), self.filled
        m.d.comb += [
            fits.eq(room | ~complete.any()),
            group.ready.eq(~group.payload.last | fits), commits.eq(group.valid & group.payload.last & fits)]
        self._send(m, head, head_valid, pops, reads)
        m.d.comb += self.busy.eq(head_valid | self.writes.valid)
        return m

    def _walk(self, m: Module, commits: Signal, sub: Signal, word: Signal) -> None:
        """The place of the group at the input."""
        x, column_word = self.column, Signal(ADDRESS_BITS, reset_less=True)
        m.d.comb += [
            self.column_ends.eq(commits & (sub == sub_rows(self.config) - 1)),
            self.strip_ends.eq(self.column_ends & (x == self.last))]
        with m.If(self.start):
            m.d.sync += [x.eq(0), sub.eq(0), column_word.eq(self.base), word.eq(self.base)]
        with m.Elif(commits):
            m.d.sync += [sub.eq(sub + 1), word.eq(word + self.width * self.config.warp_lanes)]
            with m.If(self.column_ends):
                m.d.sync += [x.eq(x + 1), column_word.eq(column_word + 1), word.eq(column_word + 1)]

    def _store(self, m: Module, lane: int, sub: Signal, word: Signal, complete: Value) -> memory.ReadPort:
        """A lane's beats; whether the group's pixel completes one."""
        group, bits = self.filled.payload, _WORD_BITS + 1
        shape = data.ArrayLayout(painted_layout(), WORDS)
        m.submodules[f"beats_{lane}"] = store = memory.Memory(shape=shape, depth=2 * sub_rows(self.config), init=[])
        write = store.write_port(granularity=1)
        place, patch, whole, pixel = Signal(bits), Signal(), Signal(), Signal(painted_layout())
        m.d.comb += [
            place.eq(word[:bits] + lane * self.width[:bits]),
            patch.eq(group.fills & (group.lane == lane)),
            whole.eq(group.last & ~group.holes[lane]),
            pixel.colour.eq(Mux(patch, group.colour, group.pixels[lane].colour)),
            pixel.covered.eq(patch | group.pixels[lane].covered),
            write.addr.eq(Cat(place[_WORD_BITS], sub)),
            write.en.eq(Mux(self.filled.valid & (patch | whole), 1 << place[:_WORD_BITS], 0)),
            *(write.data[i].eq(pixel) for i in range(WORDS)),
            complete.eq(place[:_WORD_BITS].all() | (self.column == self.last)),
        ]
        return store.read_port()

    def _row(self, lane: int, sub: Value) -> Value:
        return Cat(Const(lane, (self.config.warp_lanes - 1).bit_length()), sub)

    def _queue(self, m: Module, commits: Signal, sub: Signal, word: Signal, complete: Signal) -> tuple:
        """Groups with complete beats: the first of them, whether there is one, room for more, and what takes it out."""
        depth, shape = queue_groups(self.config), _complete_layout(self.config)
        words = Array(Signal(shape, name=f"complete_{i}", reset_less=True) for i in range(depth))
        count, first, free = Signal(range(depth + 1)), Signal(range(depth)), Signal(range(depth))
        pushes, pops, new = Signal(), Signal(), Signal(shape)
        inside = Cat(self._row(lane, sub) < self.rows for lane in range(self.config.warp_lanes))
        m.d.comb += [
            pushes.eq(commits & complete.any()), new.lanes.eq(complete & inside), new.sub.eq(sub), new.word.eq(word),
            new.near.eq(self.column[:_WORD_BITS]), new.far.eq((self.column >> _WORD_BITS).any())]
        m.d.sync += count.eq(count + pushes - pops)
        with m.If(pushes):
            m.d.sync += [words[free].eq(new), free.eq(free + 1)]  # depths are powers of two
        with m.If(pops):
            m.d.sync += first.eq(first + 1)
        return words[first], count.any(), count != depth, pops

    def _send(self, m: Module, head: data.View, valid: Value, pops: Signal, reads: list[memory.ReadPort]) -> None:
        """The complete beats of the first group, lane by lane."""
        lanes, out, bits = range(self.config.warp_lanes), self.writes.payload, _WORD_BITS + 1
        todo, done, pick, last, moves = Signal(len(lanes)), Signal(len(lanes)), Signal(len(lanes)), Signal(), Signal()
        lane, word = Signal(range(len(lanes)), reset_less=True), Signal(ADDRESS_BITS, reset_less=True)
        below = Signal(range(len(lanes) << len(self.width)), reset_less=True)  # words from lane 0's row
        near, far = Signal(_WORD_BITS, reset_less=True), Signal(reset_less=True)
        which = Cat(Cat(pick[i] for i in lanes if i >> bit & 1).any() for bit in range(len(lane)))
        m.d.comb += [
            todo.eq(head.lanes & ~done), pick.eq(todo & ~(todo - 1)), last.eq(~(todo & ~pick).any()),
            moves.eq(valid & (~self.writes.valid | self.writes.ready)), pops.eq(moves & last)]
        for i, read in enumerate(reads):
            place = (head.word[:bits] + i * self.width[:bits])[_WORD_BITS]
            m.d.comb += [read.en.eq(moves & pick[i]), read.addr.eq(Cat(place, head.sub))]
        with m.If(self.writes.ready | ~self.writes.valid):
            m.d.sync += self.writes.valid.eq(valid & todo.any())
        with m.If(moves):
            m.d.sync += [
                done.eq(Mux(last, 0, done | pick)), lane.eq(which), near.eq(head.near), far.eq(head.far),
                word.eq(head.word), below.eq(picked(pick, [i * self.width for i in lanes]))]
        address, begin = Signal(ADDRESS_BITS), Signal(_WORD_BITS)
        at = address[:_WORD_BITS]
        pixels = Array(read.data for read in reads)[lane]
        m.d.comb += [
            begin.eq(Mux(far | (near >= at), 0, at - near)),  # the row's first pixel lies in this beat
            address.eq(word + below), out.beat.eq(address >> _WORD_BITS),
            *(out.strobe[i].eq((begin <= i) & (at >= i)) for i in range(WORDS)),
            *(out.word[i].eq(Mux(out.strobe[i], Cat(pixels[i].colour.as_value(), pixels[i].covered.replicate(8)), 0))
              for i in range(WORDS)),
        ]
