"""Tells the units of the second phase, in machines with a warp unit, for which eyes the pairs of a super-tile are projected
(`spec.joint_warp`)."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.eyes import turn_layout
from rtl.shapes import layout
from rtl.supertiles.clip import clip_layout
from spec.config import AcceleratorConfig
from spec.joint_warp import check_sweeps
from spec.queues import SUPERTILES_TURNING
from spec.supertiles import supertile


class SweepTurns(wiring.Component):
    """Makes of the SuperTile items of source and target one item for the points of both eyes, and one for the clip, which stand
    at both ends of projection. Both wait in queues, so that the next super-tile's pairs follow at once.

    Parameters:
        config: the machine, with a warp unit and joint frames.

    Ports:
        supertiles: SuperTile items, in joint frames that of the target behind that of the source.
        turns: `turn_layout` items, one for each super-tile. clipped: `clip_layout` items, the same.
        joint, stereo, shared: the frame is a joint one; its target is warped; and both eyes have colours of one direction.
        second: the items are those of the second sweep.

    Throughput: an item of the input a cycle. Latency: two cycles. Storage: SUPERTILES_TURNING super-tiles in each queue.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        check_sweeps(config)
        self._clipped = clip_layout(config)
        super().__init__({
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "turns": Out(stream.Signature(turn_layout())), "clipped": Out(stream.Signature(self._clipped)),
            "joint": In(1), "stereo": In(1), "shared": In(1), "second": In(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        item, source = self.supertiles.payload, Signal(len(self.supertiles.payload.inside), name="source", reset_less=True)
        last, both, clip, turn = Signal(), Signal(), Signal(self._clipped), Signal(turn_layout())
        queues = [self._queue(m, name, sink, value) for name, sink, value in (
            ("turns", self.turns, turn), ("clipped", self.clipped, clip))]
        room: Value = Cat(queue.w_rdy for queue in queues).all()
        moves = self.supertiles.valid & self.supertiles.ready
        m.d.comb += [
            last.eq(~self.joint | item.eye), self.supertiles.ready.eq(~last | room),
            both.eq(self.joint & Mux(self.second, self.shared, ~self.stereo | item.inside.any())),
            turn.pairs.eq(item.pairs), turn.both.eq(both), turn.target.eq(self.second & ~both),
            *(clip[name].eq(item[name]) for name in ("x", "y", "pairs")), clip.both.eq(both),
            clip.wanted[0].eq(Mux(self.joint, source, item.inside)), clip.wanted[1].eq(item.inside),
            *(queue.w_en.eq(moves & last) for queue in queues)]
        with m.If(moves & ~last):
            m.d.sync += source.eq(item.inside)
        return m

    def _queue(self, m: Module, name: str, sink: stream.Interface, value: data.View) -> SyncFIFOBuffered:
        """A queue of values before a stream."""
        m.submodules[name] = queue = SyncFIFOBuffered(width=value.shape().size, depth=SUPERTILES_TURNING)
        m.d.comb += [
            queue.w_data.eq(value), Value.cast(sink.payload).eq(queue.r_data), sink.valid.eq(queue.r_rdy),
            queue.r_en.eq(sink.ready)]
        return queue
