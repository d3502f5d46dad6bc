"""Splat fetch in a test bench whose memory delays its answers.

When the setting `frame` changes, `clear` is high for one cycle.
"""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal

from rtl.vrc_array.splat_fetch import SplatFetch
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request
from spec.queues import COUNTER_BITS
from spec.records import array_splat, chunk_item, tile_use
from tb.common.bench import Bench
from tb.common.playback import Playback

MOST_DELAY = 127
"""Largest `delay`, in cycles from a request to its beat."""


class FetchBench(Bench):
    """Splat fetch with delayed `data`, and with a `clear` strobe that a changed setting causes."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"sorted": chunk_item(config), "tiles": tile_use(config), "data": read_data(config)},
            {"entries": array_splat(config), "reads": read_request(config)},
            {"views_base": BEAT_BITS, "view_shift": 2, "frame": 8, "delay": MOST_DELAY.bit_length()},
            {"hits": COUNTER_BITS, "misses": COUNTER_BITS, "error": 1, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = SplatFetch(self.config)
        self.join(m, unit, apart=("data",))
        self.delay_answers(m, unit, MOST_DELAY)
        before = Signal(8)
        m.d.comb += unit.clear.eq(before != self.frame)
        m.d.sync += before.eq(self.frame)
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return FetchBench(config).playback(f"fetch-{config.splat_cache_lines}", "fetch_bench")
