"""The first half of culling and conversion: points to splats that may touch a tile of the frame."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling import near, projection
from rtl.culling.frame import COUNTER_BITS, setting_ports
from rtl.culling.near import NearTest
from rtl.culling.projection import Projection
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.records import gaussian_point, projected_splat

SETTINGS = tuple(dict.fromkeys((*near.SETTINGS, *projection.SETTINGS)))


class ProjectionUnit(wiring.Component):
    """Near test, then projection of what passed it, then the box test.

    One pipeline whose operators each serve `point_interval` operations stands for `culling_units` units of eight cycles a
    point: as many operators do the same work, but values wait in fewer registers and behind fewer multiplexers
    (`python -m rtl.culling.compare` prints both).

    Parameters:
        config: the machine.

    Ports:
        sink: GaussianPoint; a frame ends with an item with `end`.
        source: ProjectedSplat, in order; a frame ends with an item with `end`, all zero beside it.
        position, rotation, turn, centre, limits, near, depth_scale, width, height: settings, constant from a frame's first
            point to its `end` at the source. near, width and height are positive, limits in order, and no float is a zero with
            a fraction or a sign.
        culled_near, culled_faint, culled_outside: counts of the frame by reason, the first that holds; final when `end` leaves,
            until the next frame's first point leaves the near test (its first survivor, for culled_outside).

    Throughput: a point every `point_interval` cycles, whatever becomes of it, while the source is taken. Latency: about 120 to
    150 cycles. Storage: the datapaths' queues, with room for the points that are under way.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        super().__init__({
            **setting_ports(config, SETTINGS),
            "sink": In(stream.Signature(layout(gaussian_point(config)))),
            "source": Out(stream.Signature(layout(projected_splat(config)))),
            **{name: Out(COUNTER_BITS) for name in ("culled_near", "culled_faint", "culled_outside")}})
        self.near_test, self.projection = NearTest(config), Projection(config)

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.near_test, m.submodules.projection = self.near_test, self.projection
        for unit, names in ((self.near_test, near.SETTINGS), (self.projection, projection.SETTINGS)):
            m.d.comb += [getattr(unit, name).eq(getattr(self, name)) for name in names]
        wiring.connect(m, wiring.flipped(self.sink), self.near_test.sink)
        wiring.connect(m, self.near_test.source, self.projection.sink)
        wiring.connect(m, self.projection.source, wiring.flipped(self.source))
        m.d.comb += [
            self.culled_near.eq(self.near_test.culled_near), self.culled_faint.eq(self.near_test.culled_faint),
            self.culled_outside.eq(self.projection.culled_outside)]
        return m
