"""The projection unit: turns Gaussians into splats that may touch a tile of the frame."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling import eyes, near, projection
from rtl.culling.eyes import EyeCulls, EyePoints
from rtl.culling.frame import COUNTER_BITS, setting_ports
from rtl.culling.near import NearTest
from rtl.culling.projection import Projection
from rtl.culling.shared_datapath import DatapathSide
from rtl.shapes import layout
from rtl.stream import Skid
from spec.config import AcceleratorConfig
from spec.records import gaussian_point, projected_splat

COUNTS = eyes.COUNTS
"""What the unit counts in a frame."""


def settings(config: AcceleratorConfig) -> tuple[str, ...]:
    """The settings of the near test and of projection, and of what machines with joint frames have around them."""
    joint = ("joint", "shift", "position", "target_position") if config.joint else ()
    return tuple(dict.fromkeys((*near.settings(config), *projection.SETTINGS, *joint)))


class ProjectionUnit(wiring.Component):
    """The near test, then projection of the Gaussians that pass it, then the tests of their box against the frame and of their
    mean against the guard band (`spec.guard_band`).

    One pipeline, whose operators each serve `point_interval` operations, replaces `culling_units` units that take eight cycles
    per Gaussian. It does the same work with as many operators, but with fewer registers and multiplexers
    (`python -m rtl.culling.compare` prints both).

    In machines with joint frames `EyePoints` stands before it and `EyeCulls` behind it (`rtl.culling.eyes`), so that a Gaussian
    takes the time of two in frames of two eyes.

    Parameters:
        config: the machine.
        sides: the sides of the datapaths of near test and projection, where the unit shares these.

    Ports:
        sink: GaussianPoint items; a frame ends with an item with `end`.
        source: ProjectedSplat items, in order; a frame ends with an item with `end`, whose other fields are 0.
        position, rotation, turn, centre, limits, near, depth_scale, width, height: settings, constant from a frame's first
            Gaussian until its `end` leaves the source. near, width and height are positive, the lower of two limits comes
            first, and no float is a zero with a fraction or a sign.
        culled_near, culled_faint, culled_outside: the frame's culled Gaussians by reason; each counts for the first reason that
            holds. The counts are final when `end` leaves, and stay until the next frame's first Gaussian leaves the near test
            (for culled_outside and saturated_means, until the next frame's first survivor leaves projection).
        saturated_means: those of culled_outside whose box meets the frame.

    With joint frames (`EyeCulls`):
        joint, shift, target_position: settings, as well.
        rendering: the phase is the second one; changes only while the unit is empty.
        turns: with a warp unit, as in `EyePoints`.

    Throughput: one Gaussian every `point_interval` cycles, culled or not, while the source is taken. Latency: about 120 to
    150 cycles. Storage: the datapaths' output queues, with space for all Gaussians in the pipeline, and one splat.
    """

    def __init__(self, config: AcceleratorConfig, sides: tuple[DatapathSide, DatapathSide] | None = None) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        super().__init__({
            **setting_ports(config, settings(config)), **({"rendering": In(1)} if config.joint else {}),
            **({"turns": In(stream.Signature(eyes.turn_layout()))} if config.warps_joint else {}),
            "sink": In(stream.Signature(layout(gaussian_point(config)))),
            "source": Out(stream.Signature(layout(projected_splat(config)))),
            **{name: Out(COUNTER_BITS) for name in COUNTS}})
        near_side, side = sides or (None, None)
        self._config, self.near_test, self.projection = config, NearTest(config, near_side), Projection(config, side)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.near_test, m.submodules.projection = self.near_test, self.projection
        m.submodules.leaving = splats = Skid(self.source.payload.shape())  # the tile test's `ready` comes late
        wiring.connect(m, splats.source, wiring.flipped(self.source))
        for unit, names in ((self.near_test, near.settings(self._config)), (self.projection, projection.SETTINGS)):
            m.d.comb += [getattr(unit, name).eq(getattr(self, name)) for name in names]
        if self._config.joint:
            self._eyes(m, splats)
            return m
        wiring.connect(m, wiring.flipped(self.sink), self.near_test.sink)
        wiring.connect(m, self.near_test.source, self.projection.sink)
        wiring.connect(m, self.projection.source, splats.sink)
        m.d.comb += [
            self.culled_near.eq(self.near_test.culled_near), self.culled_faint.eq(self.near_test.culled_faint),
            self.culled_outside.eq(self.projection.culled_outside), self.saturated_means.eq(self.projection.saturated_means)]
        return m

    def _eyes(self, m: Module, splats: Skid) -> None:
        """Adds what machines with joint frames have around near test and projection, up to the splats that leave."""
        m.submodules.points = points = EyePoints(self._config)
        m.submodules.culls = culls = EyeCulls(self._config)
        wiring.connect(m, wiring.flipped(self.sink), points.points)
        wiring.connect(m, points.eyes, self.near_test.sink)
        wiring.connect(m, self.near_test.source, self.projection.sink)
        wiring.connect(m, self.projection.source, culls.judged)
        wiring.connect(m, culls.splats, splats.sink)
        for unit, names in ((points, ("joint", "position", "target_position")), (culls, ("joint", "shift", "rendering"))):
            m.d.comb += [getattr(unit, name).eq(getattr(self, name)) for name in names]
        if self._config.stereo:
            wiring.connect(m, wiring.flipped(self.turns), points.turns)
            m.d.comb += points.rendering.eq(self.rendering)
        m.d.comb += [getattr(self, name).eq(getattr(culls, name)) for name in COUNTS]
