"""Packs groups of a column's pixels into beats along the rows.

Eight neighbouring pixels of a row share a beat, and a row may begin anywhere in a beat. Each lane collects the beats of its
rows in a memory. The memory has two words for each row, for even and odd addresses of beats, and a pixel is written into its
place in a word. If a pixel completes its beat or its row, its group enters a queue. The group's complete beats leave one by
one, while the following columns fill the words of the other parity.

A word is used again nine columns later. By then every group of rows has passed the queue at least once; rows below the frame
pass it too, without a beat. As the queue is no longer than the number of groups in a column, it holds the scan back before a
beat could be overwritten::

    cycle            0      1      2      3      4      5
    filled       <  A  ><  B  ><  C  >                       A completes three beats, B one, C none
    queue               <  A  ><  A  ><  A  ><  B  >
    read                   A0     A1     A3     B2
    writes                     < A0  >< A1  >< A3  >< B2  >
"""

from __future__ import annotations

from typing import Any

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
"""Bits of a pixel's address, which counts 32-bit words."""


def queue_groups(config: AcceleratorConfig) -> int:
    """Groups with complete beats that may wait: as many as are left at the end of a column in which all rows are complete."""
    groups = sub_rows(config)
    waiting = max(2, groups - groups // config.warp_lanes + 1)
    return min(groups, 1 << (waiting - 1).bit_length())


def _complete_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A group with complete beats: the lanes to write, their row, the address of lane 0's pixel, and its column.

    Only the column's place in a beat (`near`) and whether it is beyond the first beat (`far`) are needed.
    """
    return data.StructLayout({"lanes": config.warp_lanes, "sub": sub_bits(config), "word": ADDRESS_BITS, "near": _WORD_BITS,
                              "far": 1})


class Pack(wiring.Component):
    """Turns groups of pixels into memory writes.

    Parameters:
        config: the machine; `row_width` and `warp_lanes` are used.

    Ports:
        start: strobe before a strip; the unit must be empty.
        base: address of the strip's first pixel in words, sampled with `start`.
        width, last, rows: columns of the frame, its last column, and the rows of the strip that lie in the frame.
        filled: the strip's groups, down every column, columns from left to right; a group comes once for every filled hole.
        writes: the memory's write port; words whose strobe is low are 0. Beats leave in the order in which they are completed,
            and from the top row down if they are completed together.
        commits, column_ends, strip_ends: strobes; the last slot of a group is taken; the group is the last of its column; it is
            the last of the strip.
        column: the column of that group.
        busy: a beat is inside.

    Storage: two beats of 25-bit pixels per row, and the queue. Throughput: one group per cycle as long as no more than one beat
    of 8 pixels per cycle becomes complete. Latency: 2 cycles from the last pixel of a beat.
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

    def elaborate(self, platform: object) -> Module:
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
        """Tracks the place of the group at the input."""
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
        """Adds the memory of a lane's beats; sets `complete` if the group's pixel completes one."""
        group, bits = self.filled.payload, _WORD_BITS + 1
        shape = data.ArrayLayout(painted_layout(), WORDS)
        m.submodules[f"beats_{lane}"] = store = memory.Memory(shape=shape, depth=2 * sub_rows(self.config), init=[])
        write = store.write_port(granularity=1)
        place, patch, whole, pixel = Signal(bits), Signal(), Signal(), Signal(painted_layout())
        m.d.comb += [
            place.eq(word[:bits] + self._apart(lane)),
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

    def _queue(self, m: Module, commits: Signal, sub: Signal, word: Signal, complete: Signal) -> tuple[Any, ...]:
        """The queue of groups with complete beats: its head, whether there is one, whether there is free space, its pop."""
        depth, shape = queue_groups(self.config), self._complete()
        words = Array(Signal(shape, name=f"complete_{i}", reset_less=True) for i in range(depth))
        count, first, free = Signal(range(depth + 1)), Signal(range(depth)), Signal(range(depth))
        pushes, pops, new = Signal(), Signal(), Signal(shape)
        inside = Cat(self._row(lane, sub) < self.rows for lane in range(self.config.warp_lanes))
        m.d.comb += [
            pushes.eq(commits & complete.any()), new.lanes.eq(self._lanes(complete & inside, word)), new.sub.eq(sub),
            new.word.eq(word), new.near.eq(self.column[:_WORD_BITS]), new.far.eq((self.column >> _WORD_BITS).any()),
            *self._kept(new)]
        m.d.sync += count.eq(count + pushes - pops)
        with m.If(pushes):
            m.d.sync += [words[free].eq(new), free.eq(free + 1)]  # the depth is a power of two, so the index wraps
        with m.If(pops):
            m.d.sync += first.eq(first + 1)
        return words[first], count.any(), count != depth, pops

    def _send(self, m: Module, head: data.View, valid: Value, pops: Signal, reads: list[memory.ReadPort]) -> None:
        """Sends the complete beats of the group at the head, lane by lane."""
        lanes, out, bits = range(self.config.warp_lanes), self.writes.payload, _WORD_BITS + 1
        todo, done, pick, last, moves = Signal(len(lanes)), Signal(len(lanes)), Signal(len(lanes)), Signal(), Signal()
        lane, word = Signal(range(len(lanes)), reset_less=True), Signal(ADDRESS_BITS, reset_less=True)
        below = Signal(range(len(lanes) << len(self.width)), reset_less=True)  # words from lane 0's row to the row of this lane
        near, far = Signal(_WORD_BITS, reset_less=True), Signal(reset_less=True)
        which = Cat(Cat(pick[i] for i in lanes if i >> bit & 1).any() for bit in range(len(lane)))
        m.d.comb += [
            todo.eq(head.lanes & ~done), pick.eq(todo & ~(todo - 1)), last.eq(~(todo & ~pick).any()),
            moves.eq(valid & (~self.writes.valid | self.writes.ready)), pops.eq(moves & last)]
        for i, read in enumerate(reads):
            place = (head.word[:bits] + self._apart(i))[_WORD_BITS]
            m.d.comb += [read.en.eq(moves & pick[i]), read.addr.eq(Cat(place, head.sub))]
        with m.If(self.writes.ready | ~self.writes.valid):
            m.d.sync += self.writes.valid.eq(valid & todo.any())
        with m.If(moves):
            m.d.sync += [
                done.eq(Mux(last, 0, done | pick)), lane.eq(which), near.eq(head.near), far.eq(head.far),
                word.eq(head.word), below.eq(picked(pick, [i * self.width for i in lanes]))]
        address, begin = Signal(ADDRESS_BITS), Signal(_WORD_BITS)
        at = address[:_WORD_BITS]
        self._keep(m, head, moves, pick)
        pixels = Array(read.data for read in reads)[lane]
        m.d.comb += [
            # If the row's first pixel lies in this beat, words before it are not written
            begin.eq(Mux(far | (near >= at), 0, at - near)),
            address.eq(word + below), out.beat.eq(address >> _WORD_BITS),
            *(out.strobe[i].eq(self._strobe((begin <= i) & (at >= i), i)) for i in range(WORDS)),
            *(out.word[i].eq(Mux(out.strobe[i], Cat(pixels[i].colour.as_value(), pixels[i].covered.replicate(8)), 0))
              for i in range(WORDS)),
        ]

    def _apart(self, lane: int) -> Value:
        """Words from lane 0's row to the row of a lane; the low bits, which tell words and two beats apart."""
        return lane * self.width[: _WORD_BITS + 1]

    def _complete(self) -> data.StructLayout:
        """What waits of a group with complete beats."""
        return _complete_layout(self.config)

    def _lanes(self, lanes: Value, word: Value) -> Value:
        """Those of the lanes whose beats are written; `word` is the address of lane 0's pixel."""
        return lanes

    def _kept(self, new: data.View) -> list[Any]:
        """Sets what else waits of a group."""
        return []

    def _keep(self, m: Module, head: data.View, moves: Value, pick: Value) -> None:
        """Keeps what else `_strobe` needs of the group `head` when the beat of the lane that `pick` names `moves`."""

    def _strobe(self, strobe: Value, word: int) -> Value:
        """Whether a word of the beat is written, if it lies in the group's row."""
        return strobe
