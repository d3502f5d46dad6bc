"""A unit with two inputs, one output and selectable faults, for tests of the testbench itself."""


from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from spec.formats import SQ
from spec.records import Field, Record, uint
from tb.common.playback import Playback, Stream

RECORD = Record("Item", "", (Field("number", uint(8), ""), Field("values", SQ(10, 10), "", 9)))
CHANGES, WITHDRAWS, SWALLOWS, DOUBLES, STOPS, REPEATS = 1, 2, 3, 4, 5, 6
FAULTY_NUMBER = 7


class FaultyUnit(wiring.Component):
    """`out` is `left ^ right ^ key`; item FAULTY_NUMBER of `left` suffers the fault, if any."""

    left: In(stream.Signature(RECORD.width))
    right: In(stream.Signature(RECORD.width))
    key: In(8)
    fault: In(3)
    out: Out(stream.Signature(RECORD.width))
    count: Out(8)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        word = Signal(RECORD.width)
        full, here, again, free, moves = Signal(), Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            free.eq((~full | self.out.ready) & ~again & ~(here & (self.fault == STOPS))),
            moves.eq(self.left.valid & self.right.valid & free),
            self.left.ready.eq(moves),
            self.right.ready.eq(moves),
            self.out.payload.eq(word),
            self.out.valid.eq(full),
        ]
        with m.If(moves):
            m.d.sync += [
                word.eq(self.left.payload ^ self.right.payload ^ self.key),
                here.eq(self.left.payload[:8] == FAULTY_NUMBER),
                full.eq(Mux(self.left.payload[:8] == FAULTY_NUMBER, self.fault != SWALLOWS, 1)),
                again.eq((self.left.payload[:8] == FAULTY_NUMBER) & ((self.fault == DOUBLES) | (self.fault == REPEATS))),
                self.count.eq(self.count + 1),
            ]
        with m.Elif(full & self.out.ready):
            m.d.sync += [full.eq(again), again.eq(self.fault == REPEATS)]
        with m.Elif(full & here & (self.fault == CHANGES)):
            m.d.sync += word.eq(word + 1)
        with m.Elif(full & here & (self.fault == WITHDRAWS)):
            m.d.sync += full.eq(0)
        return m


def faulty_playback() -> Playback:
    """The unit between files."""
    return Playback(
        "faulty", "faulty_unit", to_verilog(FaultyUnit(), "faulty_unit"), (Stream("left", RECORD), Stream("right", RECORD)),
        (Stream("out", RECORD),), settings=(("key", 8), ("fault", 3)), observed=(("count", 8),))
