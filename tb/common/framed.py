"""For benches of units that write a frame to memory: what files of items cannot do."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring

IDLE_AFTER = 9
"""Cycles after a write until the memory says that it is idle."""


def frame_by_frame(m: Module, bench: wiring.Component, unit: wiring.Component) -> None:
    """Gives the unit of a bench, whose `rows` and `writes` are joined, frames and a memory.

    `begin` is high for a cycle where the setting `frame` changes. The memory is idle IDLE_AFTER cycles after a write. `early`
    stays high once `finished` was high before that: it then came too soon, as the memory was not idle, or a row too soon.
    """
    before, wait, finished = Signal(8), Signal(range(IDLE_AFTER + 1)), Signal()
    written = bench.writes.valid & bench.writes.ready
    m.d.comb += [unit.begin.eq(before != bench.frame), unit.writes_idle.eq(wait == 0)]
    m.d.sync += [before.eq(bench.frame), finished.eq((finished | unit.finished) & ~unit.begin)]
    with m.If(written):
        m.d.sync += wait.eq(IDLE_AFTER)
    with m.Elif(wait.any()):
        m.d.sync += wait.eq(wait - 1)
    m.d.sync += bench.early.eq((bench.early | finished & (written | wait.any())) & ~unit.begin)
