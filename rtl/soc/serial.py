"""A serial line: the sender of a UART, 8 data bits, no parity, one stop bit."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


class Sender(wiring.Component):
    """Sends bytes over a serial line.

    Parameters:
        divisor: cycles of a bit, at least 2.

    Ports:
        valid, byte: a byte to send; it is taken where `busy` is low.
        busy: a byte is under way.
        line: the line, high where nothing is sent.

    Throughput: a byte in ten bits' time.
    """

    def __init__(self, divisor: int):
        if not isinstance(divisor, int) or isinstance(divisor, bool) or divisor < 2:
            raise ValueError(f"divisor must be an integer of at least 2, not {divisor!r}")
        self._divisor = divisor
        super().__init__({"valid": In(1), "byte": In(8), "busy": Out(1), "line": Out(1, init=1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        bits, left, cycle = Signal(9), Signal(range(11)), Signal(range(self._divisor))
        m.d.comb += self.busy.eq(left.any())
        with m.If(self.busy):
            with m.If(cycle == 0):
                m.d.sync += [
                    cycle.eq(self._divisor - 1), left.eq(left - 1), self.line.eq(bits[0]), bits.eq(Cat(bits[1:], Const(1, 1)))]
            with m.Else():
                m.d.sync += cycle.eq(cycle - 1)
        with m.Elif(self.valid):
            m.d.sync += [bits.eq(Cat(self.byte, Const(1, 1))), left.eq(10), cycle.eq(self._divisor - 1), self.line.eq(0)]
        return m
