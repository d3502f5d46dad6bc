"""Test benches of units that write a frame to memory, which start frames and model the memory's idle signal."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring

from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row
from tb.common.bench import Bench

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


class FrameWriterBench(Bench):
    """A unit that writes pixel rows to a frame in memory, with frames and a memory supplied by `frame_by_frame`.

    Parameters:
        config: the machine.
        unit: the unit, with the ports of `rtl.vrc_array.pixel_writer.frame_writer_ports`.
        settings: widths of the unit's settings besides those that all such units have.
    """

    def __init__(self, config: AcceleratorConfig, unit: wiring.Component, settings: dict[str, int]):
        self._unit = unit
        super().__init__(
            {"rows": pixel_row(config)}, {"writes": write_request(config)},
            {"width": 14, "height": 14, **settings, "frame_base": BEAT_BITS, "tile_count": frame_tiles(config).bit_length(),
             "frame": 8},
            {"pixels": COUNTER_BITS, "finished": 1, "busy": 1, "early": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = self._unit
        self.join(m, self._unit)
        frame_by_frame(m, self, self._unit)
        return m
