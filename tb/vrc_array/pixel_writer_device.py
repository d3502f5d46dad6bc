"""The pixel writer in a test bench that supplies what files of items cannot: the strobe that begins a frame, and a memory that
becomes idle."""

from __future__ import annotations

from functools import cache

from rtl.vrc_array.pixel_writer import PixelWriter
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS
from tb.common.framed import FrameWriterBench
from tb.common.playback import Playback


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    joint = {"joint": 1, "target_frame_base": BEAT_BITS} if config.joint else {}
    return FrameWriterBench(config, PixelWriter(config), {"display": 1, **joint}).playback(
        f"writer-{config.cores_x}{'-joint' * config.joint}", "writer_bench")
