"""The frame packer in a test bench that supplies what files of items cannot: the strobe that begins a frame, and a memory that
becomes idle."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module

from rtl.pixels.frame_packer import FramePacker
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row
from tb.common.bench import Bench
from tb.common.framed import frame_by_frame
from tb.common.playback import Playback


class PackerBench(Bench):
    """The frame packer, with frames and a memory supplied by `frame_by_frame`."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"rows": pixel_row(config)}, {"writes": write_request(config)},
            {"width": 14, "height": 14, "frame_base": BEAT_BITS, "tile_count": frame_tiles(config).bit_length(), "frame": 8},
            {"pixels": COUNTER_BITS, "finished": 1, "busy": 1, "early": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = FramePacker(self.config)
        self.join(m, unit)
        frame_by_frame(m, self, unit)
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return PackerBench(config).playback(f"packer-{config.cores_x}-{config.cores_y}", "packer_bench")
