"""The pixel writer between files, and what a file cannot do: the strobe of a frame's begin, a memory that becomes idle."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module

from rtl.vrc_array.pixel_writer import PixelWriter
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row
from tb.common.bench import Bench
from tb.common.framed import frame_by_frame
from tb.common.playback import Playback


class WriterBench(Bench):
    """The unit, given frames and a memory by `frame_by_frame`."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"rows": pixel_row(config)}, {"writes": write_request(config)},
            {"width": 14, "height": 14, "display": 1, "frame_base": BEAT_BITS, "tile_count": frame_tiles(config).bit_length(),
             "frame": 8},
            {"pixels": COUNTER_BITS, "finished": 1, "busy": 1, "early": 1})

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.unit = unit = PixelWriter(self.config)
        self.join(m, unit)
        frame_by_frame(m, self, unit)
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted, with files at its streams."""
    return WriterBench(config).playback(f"writer-{config.cores_x}", "writer_bench")
