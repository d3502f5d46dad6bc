"""Gaussians from memory to culling."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import BeatRun, check_config, read_port
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES
from spec.records import INDEX_BITS, gaussian_geometry, gaussian_point


class GeometryReader(wiring.Component):
    """Every Gaussian of the model, in the order of their indices, then `end`.

    Parameters:
        config: the machine; the formats matter here. A GaussianGeometry must fit a beat.

    Ports:
        start: strobe, not while `busy`; settings are stable from it on.
        geometry_base, gaussians: the first one's beat, and how many there are; 0 gives `end` alone.
        reads, data: memory; one beat a Gaussian.
        points: GaussianPoint items.
        busy: high from the cycle after `start` until `end` is taken.
        error: memory answered with an error since `start`; the points of such beats mean nothing but go their way.

    Throughput: one point a cycle as fast as memory gives beats. Latency: none, a point is its beat, whose words are not stored
    here; the first request leaves in the cycle after `start`.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        width = gaussian_geometry(config).width
        if width > 8 * BEAT_BYTES:
            raise ValueError(f"formats must leave a GaussianGeometry {8 * BEAT_BYTES} bits, not {width!r}")
        self.config = config
        super().__init__({
            "start": In(1), "geometry_base": In(BEAT_BITS), "gaussians": In(INDEX_BITS),
            **read_port(config),
            "points": Out(stream.Signature(layout(gaussian_point(config)))),
            "busy": Out(1), "error": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.beats = beats = BeatRun(self.config, INDEX_BITS)
        wiring.connect(m, beats.reads, wiring.flipped(self.reads))
        record, point, words = gaussian_geometry(self.config), self.points.payload, self.data.payload
        index, end = Signal(INDEX_BITS), Signal()
        m.d.comb += [
            beats.start.eq(self.start), beats.base.eq(self.geometry_base), beats.count.eq(self.gaussians),
            end.eq(index == self.gaussians),
            Cat(point[f.name] for f in record.fields).eq(
                Mux(end, 0, words.word.as_value()[: record.width])),  # what is no longer valid may change
            point.index.eq(index), point.end.eq(end),
            self.points.valid.eq(self.busy & (end | self.data.valid)),
            self.data.ready.eq(self.busy & ~end & self.points.ready),
        ]
        with m.If(self.points.valid & self.points.ready):
            m.d.sync += [index.eq(index + 1), self.busy.eq(~end)]
        with m.If(self.start):
            m.d.sync += [index.eq(0), self.busy.eq(1), self.error.eq(0)]
        with m.Elif(self.data.valid & self.data.ready):
            m.d.sync += self.error.eq(self.error | words.error)
        return m
