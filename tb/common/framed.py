"""A wrapper for test benches of units that write a frame to memory: it starts frames and models the memory's idle signal."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring

IDLE_AFTER = 9
"""Cycles after a write until the memory model reports that it is idle."""


def frame_by_frame(m: Module, bench: wiring.Component, unit: wiring.Component) -> None:
    """Drives the unit's `begin` and `writes_idle`. The unit's `rows` and `writes` must be connected to those of the bench.

    `begin` is high for one cycle when the setting `frame` changes. The memory becomes idle IDLE_AFTER cycles after a write.
    `early` goes high and stays high if the unit raises `finished` too soon: before the memory was idle, or before its last
    write.
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
