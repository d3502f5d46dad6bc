"""Record fetch in a test bench whose memory delays its answers.

When the setting `frame` changes, `clear` is high for one cycle. `delay_chunks` and `delay_colour` are the latencies of headers
and records, less one cycle. With `lag`, the beats of a pair leave `beats` at the earliest so many cycles after its point left
`points`, as those that wait for projection and tile test do.
"""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring

from rtl.emit import to_verilog
from rtl.supertiles.record_fetch import RecordFetch
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request
from spec.queues import COUNTER_BITS
from spec.records import chunk_item, gaussian_point
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.playback import Playback

MOST_DELAY = 300
"""Largest delay, in cycles from a request to its beat."""

MOST_LAG = 255
"""Largest `lag`."""


class RecordFetchBench(Bench):
    """Record fetch with delayed data, delayed takers of its beats, and a `clear` strobe that a changed setting causes."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        beats, request, delay = read_data(config), read_request(config), MOST_DELAY.bit_length()
        super().__init__(
            {"sorted": chunk_item(config), "data_chunks": beats, "data_colour": beats},
            {"points": gaussian_point(config), "beats": beats, "reads_chunks": request, "reads_colour": request},
            {"chunks_base": BEAT_BITS, "colour_base": BEAT_BITS, "sh_degree": 2, "frame": 8, "delay_chunks": delay,
             "delay_colour": delay, "lag": MOST_LAG.bit_length()},
            {"hits": COUNTER_BITS, "misses": COUNTER_BITS, "error": 1, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = RecordFetch(self.config)
        self.join(m, unit, apart=("data_chunks", "data_colour", "beats"))
        for client in ("_chunks", "_colour"):
            self.delay_answers(m, unit, MOST_DELAY, client)
        self._lag(m, unit)
        before = Signal(8)
        m.d.comb += unit.clear.eq(before != self.frame)
        m.d.sync += before.eq(self.frame)
        return m

    def _lag(self, m: Module, unit: wiring.Component) -> None:
        """Holds beats until their point is `lag` cycles old."""
        age, due, free = Signal(MOST_LAG + 1), Signal(16), Signal()
        m.d.comb += [
            free.eq((self.lag == 0) | due.any()),
            self.beats.payload.eq(unit.beats.payload), self.beats.valid.eq(unit.beats.valid & free),
            unit.beats.ready.eq(self.beats.ready & free)]
        with m.If(self.lag.any()):
            left, taken = self.points.valid & self.points.ready, self.beats.valid & self.beats.ready
            beats = Mux(self.sh_degree.any(), 2, 1)
            m.d.sync += [age.eq(left << self.lag | age >> 1), due.eq(due + Mux(age[0], beats, 0) - taken)]


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    device, name = RecordFetchBench(config), "record_fetch_bench"
    return device.playback(f"record-fetch-{config.name}", name, emitted(name, config, lambda _: to_verilog(device, name)))
