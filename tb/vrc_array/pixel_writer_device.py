"""The pixel writer in a test bench that supplies what files of items cannot: the strobe that begins a frame, and a memory that
becomes idle."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.vrc_array.pixel_writer import PixelWriter
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row
from tb.common.framed import frame_by_frame
from tb.common.playback import Playback, Stream

_OBSERVED = (("pixels", COUNTER_BITS), ("finished", 1), ("busy", 1), ("early", 1))


def _settings(config: AcceleratorConfig) -> tuple[tuple[str, int], ...]:
    return (("width", 14), ("height", 14), ("display", 1), ("frame_base", BEAT_BITS),
            ("tile_count", frame_tiles(config).bit_length()))


class WriterBench(wiring.Component):
    """The pixel writer, with frames and a memory supplied by `frame_by_frame`."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            **{name: In(bits) for name, bits in _settings(config)},
            **{name: Out(bits) for name, bits in _OBSERVED},
            "frame": In(8),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.unit = unit = PixelWriter(self.config)
        frame_by_frame(m, self, unit)
        m.d.comb += [
            *(getattr(unit, name).eq(getattr(self, name)) for name, _ in _settings(self.config)),
            *(getattr(self, name).eq(getattr(unit, name)) for name in ("pixels", "finished", "busy")),
        ]
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return Playback(
        name=f"writer-{config.cores_x}", module="writer_bench", verilog=to_verilog(WriterBench(config), "writer_bench"),
        inputs=(Stream("rows", pixel_row(config)),), outputs=(Stream("writes", write_request(config)),),
        settings=(*_settings(config), ("frame", 8)), observed=_OBSERVED)
