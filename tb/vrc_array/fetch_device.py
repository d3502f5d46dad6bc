"""Splat fetch in a test bench whose memory delays its answers.

`reads` go to a file and `data` comes from a file. The file can stand for the memory because the requests are compared with the
golden ones, so it is known in advance which beats they read. The bench delivers a beat `delay` + 1 cycles after its request
left, and not earlier. When the setting `frame` changes, `clear` is high for one cycle.
"""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.vrc_array.splat_fetch import SplatFetch
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request
from spec.queues import COUNTER_BITS
from spec.records import array_entry, chunk_entry, tile_use
from tb.common.playback import Playback, Stream

MOST_DELAY = 127
"""Largest `delay`, in cycles from a request to its beat."""

_SETTINGS = (("views_base", BEAT_BITS), ("view_shift", 2))
_OBSERVED = (("hits", COUNTER_BITS), ("misses", COUNTER_BITS), ("error", 1), ("busy", 1))


class FetchBench(wiring.Component):
    """Splat fetch with delayed `data`, and with a `clear` strobe that a changed setting causes."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "sorted": In(stream.Signature(layout(chunk_entry(config)))),
            "tiles": In(stream.Signature(layout(tile_use(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "entries": Out(stream.Signature(layout(array_entry(config)))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            **{name: In(bits) for name, bits in _SETTINGS},
            **{name: Out(bits) for name, bits in _OBSERVED},
            "frame": In(8),
            "delay": In(range(MOST_DELAY + 1)),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.unit = unit = SplatFetch(self.config)
        for name in ("sorted", "tiles", "entries", "reads"):
            port, own = getattr(unit, name), wiring.flipped(getattr(self, name))
            wiring.connect(m, *((port, own) if name in ("entries", "reads") else (own, port)))
        before, age, due = Signal(8), Signal(MOST_DELAY + 1), Signal(16)
        left, answered = self.reads.valid & self.reads.ready, self.data.valid & self.data.ready
        m.d.comb += [
            *(getattr(unit, name).eq(getattr(self, name)) for name, _ in _SETTINGS),
            *(getattr(self, name).eq(getattr(unit, name)) for name, _ in _OBSERVED),
            unit.clear.eq(before != self.frame),
            unit.data.payload.eq(self.data.payload),
            unit.data.valid.eq(self.data.valid & due.any()),
            self.data.ready.eq(unit.data.ready & due.any()),
        ]
        # A request that leaves has age 0 at the next edge. Each request in flight is a bit of this shift register.
        m.d.sync += [
            before.eq(self.frame), age.eq(left << self.delay | age >> 1), due.eq(due + age[0] - answered)]
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return Playback(
        name=f"fetch-{config.splat_cache_lines}", module="fetch_bench",
        verilog=to_verilog(FetchBench(config), "fetch_bench"),
        inputs=(Stream("sorted", chunk_entry(config)), Stream("tiles", tile_use(config)), Stream("data", read_data(config))),
        outputs=(Stream("entries", array_entry(config)), Stream("reads", read_request(config))),
        settings=(*_SETTINGS, ("frame", 8), ("delay", MOST_DELAY.bit_length())), observed=_OBSERVED)
