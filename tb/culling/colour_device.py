"""The colour unit in a test bench whose memory delays its answers.

`reads` and `writes` go to files and `data` comes from a file. The file can stand for the memory because the requests are
compared with the golden ones, so it is known in advance which beats they read. The bench delivers a beat `delay` + 1 cycles
after its request left, and not earlier.
"""

from __future__ import annotations

from functools import cache, partial

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.colour import ColourUnit, splat_interval
from rtl.emit import to_verilog
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request, write_request
from spec.queues import COLOUR_LOOKAHEAD
from spec.records import surviving_splat
from tb.common.emission import emitted
from tb.common.playback import Playback, Stream

MOST_DELAY = COLOUR_LOOKAHEAD - 1
"""Largest `delay`, in cycles from a request to its beat."""

_SETTINGS = (("sh_degree", 2), ("colour_base", BEAT_BITS), ("views_base", BEAT_BITS), ("view_shift", 2))
_OBSERVED = (("finished", 1), ("error", 1))


class ColourBench(wiring.Component):
    """The colour unit with delayed `data`.

    Parameters:
        config: the machine's configuration.
        sh_degree: the highest degree of spherical harmonics that the unit supports.
    """

    def __init__(self, config: AcceleratorConfig, sh_degree: int = 3) -> None:
        self._unit = ColourUnit(config, sh_degree=sh_degree)
        super().__init__({
            "survivors": In(stream.Signature(layout(surviving_splat(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            **{name: In(bits) for name, bits in _SETTINGS},
            **{name: Out(bits) for name, bits in _OBSERVED},
            "delay": In(range(MOST_DELAY + 1)),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        wiring.connect(m, wiring.flipped(self.survivors), unit.survivors)
        for name in ("reads", "writes"):
            wiring.connect(m, getattr(unit, name), wiring.flipped(getattr(self, name)))
        age, due = Signal(MOST_DELAY + 1), Signal(16)
        left, answered = self.reads.valid & self.reads.ready, self.data.valid & self.data.ready
        m.d.comb += [
            *(getattr(unit, name).eq(getattr(self, name)) for name, _ in _SETTINGS),
            *(getattr(self, name).eq(getattr(unit, name)) for name, _ in _OBSERVED),
            unit.data.payload.eq(self.data.payload),
            unit.data.valid.eq(self.data.valid & due.any()),
            self.data.ready.eq(unit.data.ready & due.any()),
        ]
        # A request that leaves has age 0 at the next edge. Each request in flight is a bit of this shift register.
        m.d.sync += [age.eq(left << self.delay | age >> 1), due.eq(due + age[0] - answered)]
        return m


def _emit(config: AcceleratorConfig, sh_degree: int) -> str:
    return to_verilog(ColourBench(config, sh_degree), "colour_bench")


@cache
def playback(config: AcceleratorConfig, sh_degree: int = 3) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"colour-{splat_interval(config)}-{sh_degree}"
    return Playback(
        name=name, module="colour_bench", verilog=emitted(f"{name}-bench", config, partial(_emit, sh_degree=sh_degree)),
        inputs=(Stream("survivors", surviving_splat(config)), Stream("data", read_data(config))),
        outputs=(Stream("reads", read_request(config)), Stream("writes", write_request(config))),
        settings=(*_SETTINGS, ("delay", MOST_DELAY.bit_length())), observed=_OBSERVED)
