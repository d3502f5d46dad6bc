"""Reads Gaussians from memory for projection."""

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
    """Reads every Gaussian of the model, in the order of the indices, and then emits an item with `end`.

    Parameters:
        config: the machine; the formats matter here. A GaussianGeometry must fit a beat.

    Ports:
        start: strobe; it must not come while `busy`. Settings are stable from then on.
        geometry_base, gaussians: the beat of the first Gaussian, and the number of Gaussians; 0 gives only the item with `end`.
        reads, data: read port of memory; one beat per Gaussian.
        points: GaussianPoint items.
        busy: high from the cycle after `start` until `end` is taken.
        error: memory answered with an error since `start`. The items of such beats are undefined, but are passed on.

    Throughput: one Gaussian per cycle, or as many as memory gives beats. Latency: none from a beat to its item, as beats are
    not stored here; the first request leaves in the cycle after `start`.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        width = gaussian_geometry(config).width
        if width > 8 * BEAT_BYTES:
            raise ValueError(f"formats must be so short that a GaussianGeometry fits {8 * BEAT_BYTES} bits, not {width!r}")
        self.config = config
        super().__init__({
            "start": In(1), "geometry_base": In(BEAT_BITS), "gaussians": In(INDEX_BITS),
            **read_port(config),
            "points": Out(stream.Signature(layout(gaussian_point(config)))),
            "busy": Out(1), "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.beats = beats = BeatRun(self.config, INDEX_BITS)
        wiring.connect(m, beats.reads, wiring.flipped(self.reads))
        record, point, words = gaussian_geometry(self.config), self.points.payload, self.data.payload
        index, end = Signal(INDEX_BITS), Signal()
        m.d.comb += [
            beats.start.eq(self.start), beats.base.eq(self.geometry_base), beats.count.eq(self.gaussians),
            end.eq(index == self.gaussians),
            Cat(point[f.name] for f in record.fields).eq(
                Mux(end, 0, words.word.as_value()[: record.width])),  # without a valid beat these words may change
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
