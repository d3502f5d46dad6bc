"""Unpacks blocks of a packed frame into rows of pixels, for a display.

A block's first beat has the codes of all groups, so the number of bytes of each row is known from then on. A row leaves when
all of its bytes have come, the last one when all beats of the block have. The row's bytes are cut into groups in two stages,
planes become differences, and differences are added up along the row and then to the row above::

    cycle        0     1     2     3     4     5     6     7     8     9    10
    blocks     < 7 >                                                              a block of three beats
    beats            <7.0 ><7.1 ><7.2 >
    bytes                  <  A  ><  B  ><  C  ><  D  >                           the row whose bytes are taken
    rows                                                <  A  ><  B  ><  C  ><  D  >
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pixels.block_differences import CODES, VALUES
from rtl.pixels.check import first_state, next_state
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES, read_data
from spec.packed import (
    ALL_PLANES,
    BLOCK_GROUPS,
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    CHANNELS,
    CHECK_BITS,
    GROUP,
    GROUPS,
    HEADER_BYTES,
    PLANES,
    SLOT_BEATS,
    PackedError,
    display_row,
    listed_block,
    packed_header,
)

ROW_BYTES = GROUPS * PLANES
"""Most bytes of a row."""

_LOW = (BEAT_BYTES - 1).bit_length()


class _Taken(NamedTuple):
    """A row whose bytes are complete: the bytes, the planes of its groups, its number in the block, the header's first pixel,
    whether the row begins with it, and the error that leaves with the row."""

    valid: Value
    bytes: Value
    planes: list[Value]
    row: Value
    first: Value
    begins: Value
    error: Value


class BlockUnpacker(wiring.Component):
    """Unpacks blocks (`spec.packed`) into rows of pixels (DisplayRow), and says what is wrong with a block.

    Ports:
        blocks: ListedBlock items: which blocks come.
        beats: ReadData items: of each block as many beats as its size says, lowest first. A block whose size is 0 or above
            SLOT_BEATS has none. A beat with an error counts as one that differs.
        rows: four rows for each block, in order. Those of a block whose error is CHECK hold what its beats say, those of blocks
            with other errors are 0.
        busy: something is inside.

    Storage: nine rows. Throughput: a block in 6 cycles, or in at most 3 cycles more than it has beats. Latency: the first row
    leaves at the earliest 7 cycles after the block came.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self._header = layout(packed_header(config))
        super().__init__({
            "blocks": In(stream.Signature(layout(listed_block(config)))),
            "beats": In(stream.Signature(layout(read_data(config)))),
            "rows": Out(stream.Signature(layout(display_row(config)))),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        advance, valid = Signal(), Signal(5)
        m.d.comb += [advance.eq(~self.rows.valid | self.rows.ready), self.rows.valid.eq(valid[4])]
        taken, active = self._take(m, advance)
        with m.If(advance):
            m.d.sync += valid.eq(Cat(taken.valid, valid[:4]))
        differences, rows, errors = self._cut(m, taken, valid, advance)
        self._add(m, differences, rows, errors, valid, advance)
        m.d.comb += self.busy.eq(active | valid.any())
        return m

    def _take(self, m: Module, advance: Signal) -> tuple[_Taken, Value]:
        """Takes a block, its beats, and the bytes of its rows. Returns the row, and whether a block is at work."""
        active, begun, size, left = Signal(), Signal(), Signal(4), Signal(4)
        check, state, differs = Signal(CHECK_BITS), Signal(CHECK_BITS), Signal()
        header, row, error = Signal(self._header), Signal(range(BLOCK_HEIGHT)), Signal(PackedError.width())
        waiting, count = Signal(8 * (ROW_BYTES + BEAT_BYTES)), Signal(range(ROW_BYTES + BEAT_BYTES + 1))
        right = error == PackedError.NONE
        block, beat, plain = self.blocks.payload, self.beats.payload.word.as_value(), size == SLOT_BEATS
        impossible = (block.size == 0) | (block.size > SLOT_BEATS)
        codes = Signal(CODES)
        planes = [Signal(range(PLANES + 1), name=f"taken_{g}") for g in range(GROUPS)]
        m.d.comb += [n.eq(Mux(right, Mux(plain, PLANES, _planes(codes[g])), 0)) for g, n in enumerate(planes)]
        needed, leaves, moves = Signal(range(ROW_BYTES + 1)), Signal(), Signal()
        last = row == BLOCK_HEIGHT - 1
        m.d.comb += [
            codes.eq(header.code.as_value().word_select(row, CODES.size)), needed.eq(sum(planes)),
            self.blocks.ready.eq(~active),
            self.beats.ready.eq(active & left.any() & (~begun | (count <= ROW_BYTES) | ~right)),
            moves.eq(self.beats.valid & self.beats.ready),
            leaves.eq(active & advance & (begun | ~left.any()) & (count >= needed) & (~last | ~left.any())),
        ]
        with m.If(self.blocks.valid & ~active):
            m.d.sync += [
                active.eq(1), begun.eq(0), size.eq(block.size), check.eq(block.check), row.eq(0), count.eq(0), differs.eq(0),
                left.eq(Mux(impossible, 0, block.size)), state.eq(first_state(block.block)),
                error.eq(Mux(block.size == 0, PackedError.MISSING, Mux(impossible, PackedError.SIZE, PackedError.NONE)))]
        kept, rest = Signal.like(waiting), Signal.like(count)
        m.d.comb += [kept.eq(Mux(leaves, waiting >> Cat(Const(0, 3), needed), waiting)),
                     rest.eq(Mux(leaves, count - needed, count))]
        with m.If(leaves):
            m.d.sync += [row.eq(row + 1), active.eq(~last), waiting.eq(kept), count.eq(rest)]
        with m.If(moves):
            m.d.sync += [left.eq(left - 1), begun.eq(1), state.eq(next_state(state, beat)),
                         differs.eq(differs | self.beats.payload.error)]
            with m.If(begun):
                m.d.sync += [waiting.eq(kept | beat << Cat(Const(0, 3), rest)), count.eq(rest + BEAT_BYTES)]
            with m.Elif(plain):
                m.d.sync += [waiting.eq(beat), count.eq(BEAT_BYTES)]
            with m.Else():
                found, total = Signal(self._header), Signal(range(PLANES * BLOCK_GROUPS + HEADER_BYTES + BEAT_BYTES))
                m.d.comb += [found.eq(beat[: self._header.size]), total.eq(
                    sum(_planes(found.code[g]) for g in range(BLOCK_GROUPS)) + (HEADER_BYTES + BEAT_BYTES - 1))]
                m.d.sync += [waiting.eq(beat[self._header.size :]), count.eq(BEAT_BYTES - HEADER_BYTES), header.eq(found)]
                with m.If(total[_LOW:] != size):
                    m.d.sync += error.eq(PackedError.LENGTH)
        wrong = right & last & ((state != check) | differs)
        return _Taken(
            leaves, Mux(right, waiting[: 8 * ROW_BYTES], 0), planes, row,
            header.first.as_value(), right & ~plain & (row == 0),
            Mux(last, Mux(wrong, PackedError.CHECK, error), PackedError.NONE)), active

    def _cut(
        self, m: Module, taken: _Taken, valid: Signal, advance: Signal,
    ) -> tuple[data.View, list[Signal], list[Signal]]:
        """Two stages that cut a row's bytes into groups and make differences of their planes. Returns these, and of every stage
        the row's number and error."""
        half = GROUPS // 2
        rows = [Signal(range(BLOCK_HEIGHT), name=f"row_{n}", reset_less=True) for n in range(5)]
        errors = [Signal(PackedError.width(), name=f"error_{n}", reset_less=True) for n in range(5)]
        halves = [Signal(8 * PLANES * half, name=f"half_{n}", reset_less=True) for n in range(2)]
        planes = [Signal(range(PLANES + 1), name=f"planes_{n}", reset_less=True) for n in range(GROUPS)]
        first, begins = Signal(8 * CHANNELS, reset_less=True), Signal(reset_less=True)
        out = Signal(VALUES, name="differences", reset_less=True)
        with m.If(advance & taken.valid):
            m.d.sync += [
                halves[0].eq(taken.bytes), halves[1].eq(taken.bytes >> Cat(Const(0, 3), sum(taken.planes[:half]))),
                rows[0].eq(taken.row), errors[0].eq(taken.error), first.eq(taken.first), begins.eq(taken.begins),
                *(kept.eq(count) for kept, count in zip(planes, taken.planes, strict=True))]
        for n in range(1, 5):
            with m.If(advance & valid[n - 1]):
                m.d.sync += [rows[n].eq(rows[n - 1]), errors[n].eq(errors[n - 1])]
        for group in range(GROUPS):
            number, k = divmod(group, CHANNELS)
            before, own = sum(planes[half * number : group], start=Const(0, 1)), Signal(8 * PLANES, name=f"group_{group}")
            m.d.comb += own.eq(halves[number] >> Cat(Const(0, 3), before))
            kept = self._signed(m, own, planes[group], group)
            with m.If(advance & valid[0]):
                for i in range(GROUP):
                    x = GROUP * number + i
                    value = Cat(plane[i] for plane in kept)
                    m.d.sync += out[x][k].eq(Mux(begins, first[8 * k : 8 * k + 8], value) if x == 0 else value)
        return out, rows, errors

    def _signed(self, m: Module, planes: Signal, count: Value, group: int) -> list[Signal]:
        """All planes of a group of `count` planes, which lie in the lowest bytes; the highest one has the sign."""
        sign, kept = Signal(8, name=f"sign_{group}"), [Signal(8, name=f"plane_{group}_{j}") for j in range(PLANES)]
        with m.Switch(count):
            for n in range(1, PLANES + 1):
                with m.Case(n):
                    m.d.comb += sign.eq(planes[8 * n - 8 : 8 * n])
        m.d.comb += [plane.eq(Mux(count > j, planes[8 * j : 8 * j + 8], sign)) for j, plane in enumerate(kept)]
        return kept

    def _add(
        self, m: Module, differences: data.View, rows: list[Signal], errors: list[Signal], valid: Signal, advance: Signal,
    ) -> None:
        """Three stages that add differences up: in fours along the row, along the whole row, and to the row above. The output
        adds green."""
        fours, along = Signal(VALUES, reset_less=True), Signal(VALUES, reset_less=True)
        channels, out = Signal(VALUES, reset_less=True), self.rows.payload
        for k in range(CHANNELS):
            for x in range(BLOCK_WIDTH):
                four = x // 4 * 4
                with m.If(advance & valid[1]):
                    m.d.sync += fours[x][k].eq(sum(differences[i][k] for i in range(four, x + 1)))
                with m.If(advance & valid[2]):
                    m.d.sync += along[x][k].eq(fours[x][k] + sum(fours[i][k] for i in range(3, four, 4)))
                with m.If(advance & valid[3]):
                    m.d.sync += channels[x][k].eq(along[x][k] + Mux(rows[3] == 0, 0, channels[x][k]))
        for x in range(BLOCK_WIDTH):
            r, g, b, coverage = (channels[x][k] for k in range(CHANNELS))
            for k, value in enumerate((r + g, g, b + g, coverage)):
                m.d.comb += out.pixel[CHANNELS * x + k].eq(value)
        m.d.comb += out.error.eq(errors[4])


def _planes(code: Value) -> Value:
    """The planes of a group."""
    return Mux(code == ALL_PLANES, PLANES, code)
