"""Read ports of memory, and requests for consecutive beats."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request


def check_config(config: AcceleratorConfig) -> None:
    """Raises TypeError unless `config` is an AcceleratorConfig."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")


def read_port(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The ports `reads` and `data` of a unit: requests for beats, and the beats in the same order, any number of cycles
    later."""
    return {
        "reads": Out(stream.Signature(layout(read_request(config)))),
        "data": In(stream.Signature(layout(read_data(config)))),
    }


class BeatRun(wiring.Component):
    """Requests `count` consecutive beats from `base` on. Throughput: one request per cycle. Latency: one cycle from `start`.

    Parameters:
        config: the machine.
        count_bits: bits of `count`.

    Ports:
        start: strobe; it must not come while `busy`. `base` and `count` are taken in its cycle.
        reads: the requests, by ascending address.
        busy: a request is left.
    """

    def __init__(self, config: AcceleratorConfig, count_bits: int):
        check_config(config)
        super().__init__({
            "start": In(1), "base": In(BEAT_BITS), "count": In(count_bits), "busy": Out(1),
            "reads": Out(stream.Signature(layout(read_request(config)))),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        beat, left = Signal(BEAT_BITS, reset_less=True), Signal.like(self.count)
        m.d.comb += [self.busy.eq(left.any()), self.reads.valid.eq(self.busy), self.reads.payload.beat.eq(beat)]
        with m.If(self.start):
            m.d.sync += [beat.eq(self.base), left.eq(self.count)]
        with m.Elif(self.reads.valid & self.reads.ready):
            m.d.sync += [beat.eq(beat + 1), left.eq(left - 1)]
        return m
