"""Splat fetch between files, and a memory that keeps its answers back until they are due.

`frame` is a setting; where it changes, `clear` is high for a cycle.
"""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal

from rtl.vrc_array.splat_fetch import SplatFetch
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request
from spec.queues import COUNTER_BITS
from spec.records import array_entry, chunk_entry, tile_use
from tb.common.bench import Bench
from tb.common.playback import Playback

MOST_DELAY = 127
"""Cycles from a request to its beat."""


class FetchBench(Bench):
    """The unit, its `data` delayed and its `clear` made of a setting that changes."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"sorted": chunk_entry(config), "tiles": tile_use(config), "data": read_data(config)},
            {"entries": array_entry(config), "reads": read_request(config)},
            {"views_base": BEAT_BITS, "view_shift": 2, "frame": 8, "delay": MOST_DELAY.bit_length()},
            {"hits": COUNTER_BITS, "misses": COUNTER_BITS, "error": 1, "busy": 1})

    def elaborate(self, platform) -> Module:
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
    """The bench of a configuration, emitted, with files at its streams."""
    return FetchBench(config).playback(f"fetch-{config.splat_cache_lines}", "fetch_bench")
