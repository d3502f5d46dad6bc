"""What surrounds projection in machines with joint frames (`spec.joint`): every Gaussian is projected for one eye after the
other."""

from __future__ import annotations

from amaranth.hdl import Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.frame import COUNTER_BITS, count_items, setting_ports
from rtl.shapes import layout
from rtl.stream import Buffer, payload_register
from rtl.supertiles.eyes import origin_of
from spec.config import AcceleratorConfig
from spec.joint import eye_point
from spec.records import COUNT_BITS, gaussian_point, projected_splat

COUNTS = ("culled_near", "culled_faint", "culled_outside", "saturated_means")
"""What `EyeCulls` counts in a frame."""


def turn_layout() -> data.StructLayout:
    """The pairs of a super-tile in the second phase of machines with a warp unit: how many there are, whether they are
    projected for both eyes, and if not, whether for the target."""
    return data.StructLayout({"pairs": COUNT_BITS, "both": 1, "target": 1})


class EyePoints(wiring.Component):
    """Sends every Gaussian to projection once for each eye of the frame, with the eye's position.

    Parameters:
        config: the machine, with joint frames.

    Ports:
        points: GaussianPoint items; an item with `end` ends a phase.
        eyes: EyePoint items: each Gaussian for the source and, in joint frames, at once behind it for the target. An item with
            `end` comes once, with `eye` 0.
        joint, position, target_position: settings.

    In machines with a warp unit (`spec.joint_warp`) a pair of the second phase may have an item for a single eye:
        rendering: the phase is the second one; changes only while the unit is empty.
        turns: in the second phase an item for each super-tile, in order: how many pairs it has, and for which eyes they are
            projected. No pair of it is taken before.

    Throughput: an item at `eyes` a cycle. Latency: one cycle. In a joint frame::

        cycle         0      1      2      3
        points     <  A  ><  B         ><  C
        ready      ~~~~~~~_______~~~~~~~____
        eyes              < A, 0>< A, 1>< B, 0>
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._warps = config.warps_joint
        super().__init__({
            **setting_ports(config, ("joint", "position", "target_position")), **(
                {"rendering": In(1), "turns": In(stream.Signature(turn_layout()))} if config.warps_joint else {}),
            "points": In(stream.Signature(layout(gaussian_point(config)))),
            "eyes": Out(stream.Signature(layout(eye_point(config))))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        point, out, again, held = self.points.payload, self.eyes, Signal(), payload_register(m, self.eyes)
        free, both, second = ~out.valid | out.ready & ~again, self.joint & ~point.end, Const(0)
        taken = self.points.valid & self.points.ready
        if self._warps:
            turn, left = self._turn(m, taken)
            both = Mux(self.rendering, turn.both, both)
            second, free = self.rendering & turn.target, free & (~self.rendering | left)
            with m.If(taken):
                m.d.sync += held.alone.eq(self.rendering & self.joint & ~turn.both)
        m.d.comb += self.points.ready.eq(free)
        with m.If(out.ready):
            m.d.sync += [out.valid.eq(again), again.eq(0), held.eye.eq(1), held.position.eq(self.target_position)]
        with m.If(taken):
            m.d.sync += [
                out.valid.eq(1), again.eq(both), held.eye.eq(second),
                held.position.eq(Mux(second, self.target_position, self.position) if self._warps else self.position),
                *(held[name].eq(point[name]) for name in point.shape().members)]
        return m

    def _turn(self, m: Module, taken: Value) -> tuple[data.View, Value]:
        """For which eyes the pairs of the super-tile are projected, and whether it has any left."""
        turn, left = Signal(self.turns.payload.shape(), reset_less=True), Signal(COUNT_BITS)
        last = (left == 1) & taken
        m.d.comb += self.turns.ready.eq(self.rendering & (~left.any() | last))
        with m.If(taken & self.rendering):
            m.d.sync += left.eq(left - 1)
        with m.If(self.turns.valid & self.turns.ready):
            m.d.sync += [turn.eq(self.turns.payload), left.eq(self.turns.payload.pairs)]
        return turn, left.any()


def judged_splat(config: AcceleratorConfig) -> data.StructLayout:
    """What projection finds of a Gaussian in one eye: the splat, whose `none` means nothing; whether the Gaussian lies at or
    before the eye's near plane, and whether it is too faint; whether its box lies outside the eye's frame, and whether its mean
    lies beyond the guard band. In an item with `end` all other fields are 0."""
    return data.StructLayout({
        "splat": layout(projected_splat(config)), "behind": 1, "faint": 1, "unboxed": 1, "beyond": 1})


class EyeCulls(wiring.Component):
    """Culls the splats of both eyes as `spec.joint` says, and moves their boxes into the columns of joint super-tiles.

    The target takes over the depth key of the source, and what the source's near test culls. In the first phase culled items
    are dropped; in the second each is passed on with `none`, because a pair has an item for each eye.

    Parameters:
        config: the machine, with joint frames.

    Ports:
        judged: `judged_splat` items, in joint frames two for each Gaussian, source first; an item with `end` ends the first
            phase.
        splats: ProjectedSplat items, in order.
        joint, shift: settings.
        rendering: the phase is the second one; changes only while the unit is empty.
        culled_near, culled_faint, culled_outside: Gaussians of the first phase culled in all eyes of the frame; each counts for
            the first reason that holds, and for the near test where the source lies behind the near plane. The counts stay
            until the next frame's first item leaves.
        saturated_means: items of the first phase that are culled because of their mean alone.

    Throughput: one item a cycle. Latency: one cycle.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._warps = config.warps_joint
        super().__init__({
            **setting_ports(config, ("joint", "shift")), "rendering": In(1),
            "judged": In(stream.Signature(judged_splat(config))),
            "splats": Out(stream.Signature(layout(projected_splat(config)))),
            **{name: Out(COUNTER_BITS) for name in COUNTS}})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.leaving = leaving = Buffer(self.splats.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.splats))
        item, found, out = self.judged.payload, self.judged.payload.splat, leaving.sink.payload
        key, behind, seen = Signal.like(found.depth_key, name="source_key", reset_less=True), Signal(), Signal()  # the source's
        second, culled, visible, passes, taken, counts = Signal(), Signal(), Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            second.eq(found.eye & ~found.alone if self._warps else found.eye),
            culled.eq(item.faint | Mux(second, behind, item.behind)),
            visible.eq(~(culled | item.behind | item.unboxed | item.beyond)),
            passes.eq(found.end | visible | self.rendering),
            out.eq(found), out.none.eq(~visible & ~found.end),
            leaving.sink.valid.eq(self.judged.valid & passes), self.judged.ready.eq(leaving.sink.ready | ~passes),
            taken.eq(self.judged.valid & self.judged.ready), counts.eq(taken & ~self.rendering)]
        with m.If(second):
            m.d.comb += out.depth_key.eq(key)
        with m.If(taken & ~second):
            m.d.sync += [key.eq(found.depth_key), behind.eq(item.behind), seen.eq(visible)]
        self._move(m, found, out)
        last = ~self.joint | second  # the last item of a Gaussian
        count_items(
            m, counts, found.end, (self.culled_near, ~second & item.behind),
            (self.culled_faint, ~second & item.faint & ~item.behind),
            (self.culled_outside, last & ~culled & ~visible & ~(second & seen)),
            (self.saturated_means, ~culled & ~item.behind & ~item.unboxed & item.beyond))
        return m

    def _move(self, m: Module, found: data.View, out: data.View) -> None:
        """Adds the eye's O to the columns of the box."""
        origin: Value = origin_of(m, self.joint, self.shift)(found.eye)
        with m.If(~found.end):
            m.d.comb += [out[name].eq(found[name] + origin) for name in ("first_x", "last_x")]
