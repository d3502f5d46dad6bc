"""The merge threshold beta from the sums over a frame: twice the mean count of its non-empty tiles, capped by the sort buffer.

The golden renderer divides two integers in float64 and rounds the quotient to the nearest integer, ties to even. The integers
are so small that the float64 rounding never changes the result, so the exact division here, with the same rule for ties, gives
the same number. The divider produces one bit per cycle and is used once per frame.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.tile_counters import total_bits
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, frame_lists


class AutoBeta(wiring.Component):
    """beta = min(round(2 total / filled), intersections that fit half the sort buffer), or 1 for an empty frame.

    The quotient is computed by restoring division.

    Parameters:
        config: the machine; `sort_buffer_bytes` and `row_width` are used, or with lists by super-tile `list_heads`.

    Ports:
        start: strobe that begins a division; it may only come while none is under way.
        total, filled: the sums of `TileCounters`; they must be stable until `done`.
        beta: the threshold.
        done: `beta` is valid; stays high until the next start.

    Latency: one cycle per bit of 2 total, plus one: 40 cycles for PAPER.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "start": In(1),
            "total": In(total_bits(config)),
            "filled": In(range(frame_lists(config) + 1)),
            "beta": Out(COUNT_BITS),
            "done": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        cap = self.config.sort_chunk
        bits = len(self.total) + 1
        # `quotient` holds the dividend at first. Each cycle its top bit moves out and a bit of the quotient enters at the
        # bottom.
        quotient = Signal(bits, reset_less=True)
        rest = Signal(len(self.filled), reset_less=True)  # always smaller than the divisor
        left = Signal(range(bits + 1))
        widened = Cat(quotient[-1], rest)
        less = widened - self.filled  # the sign bit is the result of the comparison
        fits = ~less[-1]
        m.d.comb += self.done.eq(left == 0)
        with m.If(self.start):
            m.d.sync += [quotient.eq(self.total << 1), rest.eq(0), left.eq(bits)]
        with m.Elif(~self.done):
            m.d.sync += [quotient.eq(Cat(fits, quotient)), left.eq(left - 1)]
            m.d.sync += rest.eq(Mux(fits, less, widened))

        twice = rest << 1
        up = (twice > self.filled) | (twice == self.filled) & quotient[0]
        rounded = Mux(quotient >= cap, cap, quotient[: len(Const(cap))] + up)
        # A filled tile has at least one intersection, so the quotient is at least 2 and needs no lower bound.
        m.d.comb += self.beta.eq(Mux(self.filled == 0, 1, rounded))
        return m
