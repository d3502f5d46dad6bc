"""The frame packer in a test bench that supplies what files of items cannot: the strobe that begins a frame, and a memory that
becomes idle."""

from __future__ import annotations

from functools import cache

from rtl.pixels.frame_packer import FramePacker
from spec.config import AcceleratorConfig
from tb.common.framed import FrameWriterBench
from tb.common.playback import Playback


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return FrameWriterBench(config, FramePacker(config), {}).playback(
        f"packer-{config.cores_x}-{config.cores_y}", "packer_bench")
