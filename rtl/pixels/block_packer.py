"""Packs blocks of pixels into beats.

The rows of a block wait for its last one, because only all of them tell whether the block is plain. Then the planes of each
row's groups are joined without gaps, and added to what waits for a whole beat. As bit planes, groups are whole bytes, so
nothing is shifted by less than a byte::

    cycle         0   1   2   3   4   5   6   7   8   9   10  11  12
    rows        < A >< B >< C >< D >< E >< F >< G >< H >
    coded                       < A >< B >< C >< D >< E >< F >< G >< H >
    waiting                         < A >< A >< A >< A >< E >< E ...        A to D are read while E to H come
    joined                                              < A >< B >< C >< D >
    beats                                                   <   0  ><   1  >
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pixels.block_differences import CODES, VALUES, BlockDifferences, place_layout
from rtl.pixels.check import first_state, next_state
from rtl.shapes import layout
from rtl.stream import Buffer
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES
from spec.packed import (
    ALL_PLANES,
    BLOCK_GROUPS,
    BLOCK_HEIGHT,
    CHANNELS,
    CHECK_BITS,
    GROUP,
    GROUPS,
    HEADER_BYTES,
    PLANES,
    PLANES_MOST,
    SLOT_BEATS,
    block_row,
    packed_beat,
)

ROW_BYTES = GROUPS * PLANES
"""Most bytes of a row's groups."""

PIECE_BYTES = HEADER_BYTES + ROW_BYTES
"""Most bytes that are joined at once: the header and row 0."""

_LOW = (BEAT_BYTES - 1).bit_length()


class _Row(NamedTuple):
    """What is read of a row that has waited: the bytes of its groups (those that are not stored are 0), their number by group,
    the beats of its block, and its place."""

    groups: list[Value]
    counts: list[Value]
    size: Value
    place: data.View


class _Joined(NamedTuple):
    """A row whose groups are joined: its bytes, their number, the beats of its block, its place, and whether there is one."""

    bytes: Value
    count: Value
    size: Value
    place: data.View
    valid: Value


class BlockPacker(wiring.Component):
    """Packs the rows of blocks (BlockRow) into beats (PackedBeat).

    Ports:
        rows: the rows of each block, row 0 first.
        beats: each block's beats, lowest first, the blocks in the same order; for a block whose row 0 has no pixel of the frame
            one item of size 0.
        busy: something is inside.

    Storage: twelve rows and seven beats. Throughput: a row a cycle and a beat a cycle, whichever takes longer. Latency: a
    block's first beat leaves at most 9 cycles after its last row arrived.
    """

    def __init__(self, config: AcceleratorConfig):
        self._differences = BlockDifferences(config)
        self._place = place_layout(config)
        self._joint = config.joint
        super().__init__({
            "rows": In(stream.Signature(layout(block_row(config)))),
            "beats": Out(stream.Signature(layout(packed_beat(config)))),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.differences = differences = self._differences
        m.submodules.out = out = Buffer(self.beats.payload.shape())
        wiring.connect(m, wiring.flipped(self.rows), differences.rows)
        wiring.connect(m, out.source, wiring.flipped(self.beats))
        header, advance = Signal(8 * HEADER_BYTES, reset_less=True), Signal()
        row, ready, waits = self._wait(m, differences.coded, advance, header)
        joined, valid = self._join(m, row, ready, advance)
        fills = self._fill(m, joined, header, advance, out.sink)
        m.d.comb += self.busy.eq(differences.busy | waits | valid | fills | self.beats.valid)
        return m

    def _wait(
        self, m: Module, coded: stream.Interface, advance: Signal, header: Signal,
    ) -> tuple[_Row, Value, Value]:
        """Keeps the rows of a block until the last one has come, and shows them one after the other; the block's header follows
        when row 0 is taken. Returns the row, whether there is one, and whether any waits."""
        item, full, ready, reading = coded.payload, Signal(BLOCK_HEIGHT), Signal(), Signal(range(BLOCK_HEIGHT))
        rows = [Signal(VALUES, name=f"row_{n}", reset_less=True) for n in range(BLOCK_HEIGHT)]
        codes = [Signal(CODES, name=f"codes_{n}", reset_less=True) for n in range(BLOCK_HEIGHT)]
        place, size, outside = Signal(self._place, reset_less=True), Signal(4, reset_less=True), Signal(reset_less=True)
        planes, leaves, takes = Signal(range(PLANES * BLOCK_GROUPS + 1)), Signal(BLOCK_HEIGHT), Signal()
        total = Signal.like(planes)
        number, last = item.place.row, item.place.row == BLOCK_HEIGHT - 1
        m.d.comb += [
            leaves.eq((advance & ready) << reading), coded.ready.eq(~(full & ~leaves).bit_select(number, 1)),
            takes.eq(coded.valid & coded.ready), total.eq(planes + sum(_stored(item.codes[g]) for g in range(GROUPS))),
        ]
        m.d.sync += full.eq(full & ~leaves | takes << number)
        for n in range(BLOCK_HEIGHT):
            with m.If(takes & (number == n)):
                m.d.sync += [rows[n].eq(item.values), codes[n].eq(item.codes)]
        with m.If(advance & ready):
            m.d.sync += reading.eq(reading + 1)
            with m.If(reading == BLOCK_HEIGHT - 1):
                m.d.sync += ready.eq(0)
            with m.If(reading == 0):
                m.d.sync += header.eq(Cat(rows[0][0], *codes))
        with m.If(takes):
            m.d.sync += planes.eq(Mux(last, 0, total))
            with m.If(number == 0):
                m.d.sync += outside.eq(item.place.outside)
            with m.If(last):  # comes no earlier than the last row of the block before leaves
                m.d.sync += [ready.eq(1), place.block.eq(item.place.block), size.eq(Mux(outside, 0, Mux(
                    total > PLANES_MOST, SLOT_BEATS, (total + (HEADER_BYTES + BEAT_BYTES - 1)) >> _LOW)))]
                if self._joint:
                    m.d.sync += place.eye.eq(item.place.eye)
        shown = Signal(self._place)
        m.d.comb += [shown.eq(place), shown.row.eq(reading)]
        values, code = Signal(VALUES), Signal(CODES)
        m.d.comb += [values.eq(Array([row.as_value() for row in rows])[reading]),
                     code.eq(Array([each.as_value() for each in codes])[reading])]
        return _shown(values, code, size, shown), ready, full.any()

    def _join(self, m: Module, row: _Row, ready: Value, advance: Signal) -> tuple[_Joined, Value]:
        """Two stages that join the groups of a row. Returns the row, and whether anything is inside."""
        valid, half_bytes = Signal(2), ROW_BYTES // 2
        halves = [Signal(8 * half_bytes, name=f"half_{n}", reset_less=True) for n in range(2)]
        counts = [Signal(range(half_bytes + 1), name=f"count_{n}", reset_less=True) for n in range(2)]
        blocks = [Signal(4, name=f"size_{n}", reset_less=True) for n in range(2)]
        places = [Signal(self._place, name=f"place_{n}", reset_less=True) for n in range(2)]
        joined, count = Signal(8 * ROW_BYTES, reset_less=True), Signal(range(ROW_BYTES + 1), reset_less=True)
        with m.If(advance):
            m.d.sync += valid.eq(Cat(ready, valid[0]))
        with m.If(advance & ready):
            m.d.sync += [blocks[0].eq(row.size), places[0].eq(row.place)]
            for n in range(2):
                groups, sizes = row.groups[4 * n : 4 * n + 4], row.counts[4 * n : 4 * n + 4]
                pairs = [_appended(groups[i], sizes[i], groups[i + 1]) for i in (0, 2)]
                m.d.sync += [halves[n].eq(_appended(pairs[0], sizes[0] + sizes[1], pairs[1])), counts[n].eq(sum(sizes))]
        with m.If(advance & valid[0]):
            m.d.sync += [joined.eq(_appended(halves[0], counts[0], halves[1])), count.eq(counts[0] + counts[1]),
                         blocks[1].eq(blocks[0]), places[1].eq(places[0])]
        return _Joined(joined, count, blocks[1], places[1], valid[1]), valid.any()

    def _fill(
        self, m: Module, row: _Joined, header: Signal, advance: Signal, sink: stream.Interface,
    ) -> Value:
        """The last stage adds the rows to what waits for a whole beat, and sends whole beats. Returns whether anything waits.

        Fewer than two beats wait when a row is added. After a block's last row their bytes are rounded up to whole beats,
        behind which the next block begins while these still wait; `current` is the block whose beats are sent.
        """
        most = 2 * BEAT_BYTES - 1 + PIECE_BYTES
        waiting, count = Signal(8 * most), Signal(range(most + BEAT_BYTES))
        block = data.StructLayout({
            "number": row.place.block.shape(), **({"eye": 1} if self._joint else {}), "size": 4})
        current, after, begun, queued, some = Signal(block), Signal(block), Signal(), Signal(), Signal()
        sent, state, follows = Signal(4), Signal(CHECK_BITS), Signal(CHECK_BITS)
        sends, leaves, ends, takes, pops = Signal(), Signal(), Signal(), Signal(), Signal()
        begins, last = row.place.row == 0, row.place.row == BLOCK_HEIGHT - 1
        head, beats, left = begins & ~_plain(row.size) & row.size.any(), count[_LOW:], Signal.like(count[_LOW:])
        behind = (beats > 1) | (beats == 1) & ~pops  # a beat is left where one leaves; `left` comes too late to tell
        out, first, total = sink.payload, Signal(block), Signal.like(count)
        m.d.comb += [
            sends.eq(begun & (beats.any() | ~some)), leaves.eq(sends & sink.ready), ends.eq(leaves & out.last),
            pops.eq(begun & some & sink.ready), left.eq(beats - (beats.any() & pops)),
            advance.eq(~row.valid | ((beats <= 1) | (beats == 2) & pops) & (~begins | ~queued)),
            takes.eq(advance & row.valid), follows.eq(next_state(state, waiting[: 8 * BEAT_BYTES])),
            sink.valid.eq(sends), out.word.eq(waiting[: 8 * BEAT_BYTES]), out.block.eq(current.number),
            out.size.eq(Mux(some, sent + 1, 0)), out.last.eq(out.size == current.size), out.check.eq(Mux(some, follows, 0)),
            first.number.eq(row.place.block), first.size.eq(row.size),
            total.eq(Cat(count[:_LOW], left) + row.count + Mux(head, HEADER_BYTES, 0)),
        ]
        if self._joint:
            m.d.comb += [out.eye.eq(current.eye), first.eye.eq(row.place.eye)]
        kept, piece = Mux(leaves & some, waiting >> 8 * BEAT_BYTES, waiting), Mux(head, Cat(header, row.bytes), row.bytes)
        placed = piece << Cat(Const(0, 3), count[:_LOW])
        m.d.sync += [waiting.eq(kept), count.eq(Cat(count[:_LOW], left))]
        with m.If(takes):
            m.d.sync += [
                waiting.eq(kept | Mux(behind, placed << 8 * BEAT_BYTES, placed)),
                count.eq(Mux(last, Cat(Const(0, _LOW), (total + (BEAT_BYTES - 1))[_LOW:]), total))]
        with m.If(leaves):
            m.d.sync += [sent.eq(sent + 1), state.eq(follows)]
        with m.If(ends | ~begun):
            follower = Signal(block)
            m.d.comb += follower.eq(Mux(queued, after, first))
            m.d.sync += [begun.eq(queued | takes & begins), queued.eq(0), current.eq(follower), sent.eq(0),
                         some.eq(follower.size.any()), state.eq(first_state(follower.number))]
        with m.Elif(takes & begins):
            m.d.sync += [queued.eq(1), after.eq(first)]
        return count.any() | begun


def _plain(size: Value) -> Value:
    """Whether a block of so many beats is plain."""
    return size == SLOT_BEATS


def _shown(values: data.View, codes: data.View, size: Value, place: data.View) -> _Row:
    """A row of differences by bit planes. In a block with a header, the first pixel is in the header."""
    plain = _plain(size)
    drops, groups, counts = (place.row == 0) & ~plain, [], []
    for group in range(GROUPS):
        half, k = divmod(group, CHANNELS)
        code = codes[group]
        bits = [values[GROUP * half + i][k] for i in range(GROUP)]
        if half == 0:
            bits[0] = Mux(drops, 0, bits[0])
        planes = [Cat(value[j] for value in bits) & (plain | (code > min(j, ALL_PLANES - 1))).replicate(GROUP)
                  for j in range(PLANES)]
        groups.append(Cat(planes))
        counts.append(Mux(plain, PLANES, _stored(code)))
    return _Row(groups, counts, size, place)


def _stored(code: Value) -> Value:
    """The planes of a group with a header."""
    return Mux(code == ALL_PLANES, PLANES, code)


def _appended(low: Value, count: Value, high: Value) -> Value:
    """Bytes behind the lower `count` bytes of `low`, whose others are 0."""
    return (low | high << Cat(Const(0, 3), count))[: len(low) + len(high)]
