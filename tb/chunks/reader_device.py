"""The reader of chunks between files. The requests go to one, and the beats come from another, some cycles after them."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal

from rtl.chunks.chunk_reader import ChunkReader
from rtl.emit import to_verilog
from spec.chunks import header_item
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request
from spec.records import gaussian_point
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.playback import Playback

MOST_DELAY = 300
"""Most cycles that the memory may take."""


class ReaderDevice(Bench):
    """The unit, started when the setting `frame` changes, and a memory that answers `delay` + 1 cycles after a request at the
    earliest."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"tested": header_item(config), "data": read_data(config)},
            {"reads": read_request(config), "points": gaussian_point(config)},
            {"geometry_base": BEAT_BITS, "delay": MOST_DELAY.bit_length(), "frame": 8}, {"busy": 1, "error": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = ChunkReader(self.config)
        self.join(m, unit, apart=("data",))
        self.delay_answers(m, unit, MOST_DELAY)
        before = Signal.like(self.frame)
        m.d.sync += before.eq(self.frame)
        m.d.comb += unit.start.eq(before != self.frame)
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The device of a configuration, emitted, with a file at each stream."""
    device, name = ReaderDevice(config), f"chunk-reader-{config.records}-{config.lists}"
    return device.playback(
        name, "reader_device", emitted("reader_device", config, lambda config: to_verilog(device, "reader_device")))
