"""The merge threshold from a frame's sums: twice the mean count of its non-empty tiles, capped by the sort buffer.

The golden renderer rounds the quotient of two integers in float64, ties to even. Counts and tiles are far too few for that
quotient to round twice, so the exact one with the same ties is the same number; one bit a cycle, once a frame.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.tile_counters import total_bits
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, frame_tiles


class AutoBeta(wiring.Component):
    """min(round(2 total / filled), entries of half the sort buffer), or 1 for an empty frame, by restoring division.

    Parameters:
        config: the machine; `row_width` and `sort_buffer_bytes` matter here.

    Ports:
        start: strobe; nothing else is under way.
        total, filled: sums of `TileCounters`, stable until `done`.
        beta: the threshold.
        done: `beta` is right; high until the next start.

    Latency: a cycle a bit of 2 total, and one: 40 for PAPER.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "start": In(1),
            "total": In(total_bits(config)),
            "filled": In(range(frame_tiles(config) + 1)),
            "beta": Out(COUNT_BITS),
            "done": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        cap = self.config.sort_chunk
        bits = len(self.total) + 1
        # The dividend leaves `quotient` at the top, one bit a cycle, and the quotient enters below.
        quotient = Signal(bits, reset_less=True)
        rest = Signal(len(self.filled), reset_less=True)  # smaller than the divisor
        left = Signal(range(bits + 1))
        widened = Cat(quotient[-1], rest)
        less = widened - self.filled  # its sign is the comparison
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
        m.d.comb += self.beta.eq(Mux(self.filled == 0, 1, rounded))  # a filled tile has an entry: the quotient is 2 or more
        return m
