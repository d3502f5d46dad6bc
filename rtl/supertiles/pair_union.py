"""Drops the pairs of the target eye that the source eye has, too."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from spec.config import AcceleratorConfig
from spec.records import INDEX_BITS, frame_supertiles
from spec.supertiles import supertile_pair


class PairUnion(wiring.Component):
    """Passes on every pair of a Gaussian and a super-tile once, whichever eyes it has intersections in (`spec.joint`, "Pairs").

    A memory holds for every super-tile the index of the last Gaussian of which the source had a pair in it. The target's pairs
    of a Gaussian come behind the source's.

    Parameters:
        config: the machine, with joint frames.

    Ports:
        pairs: SuperTilePair items, for each Gaussian first those of the source, then those of the target; a phase ends with an
            item with `end`.
        union: those that are passed on, in order.
        clear: strobe: the next pair is the first of another frame.
        ready: the memory is cleared; until then no pair is taken. busy: a pair is inside.

    Throughput: one pair a cycle. Latency: two cycles. Storage: an index for each super-tile of the largest frame, and whether
    there is one; `clear` takes a cycle for each of them.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.joint:
            raise ValueError(f"config must be a machine with joint frames, not {config.name!r}")
        self._depth = frame_supertiles(config)
        pairs = stream.Signature(layout(supertile_pair(config)))
        super().__init__({"pairs": In(pairs), "union": Out(pairs), "clear": In(1), "ready": Out(1), "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.words = words = memory.Memory(shape=INDEX_BITS + 1, depth=self._depth, init=[])  # 0, or 1 and an index
        m.submodules.leaving = leaving = Buffer(self.union.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.union))
        write, read, item = words.write_port(), words.read_port(), self.pairs.payload
        held, present, clearing = Signal.like(item, reset_less=True), Signal(), Signal(init=1)
        at, taken, passes, leaves = Signal(range(self._depth)), Signal(), Signal(), Signal()
        m.d.comb += [
            passes.eq(~held.eye | held.end | ~read.data[0] | (read.data[1:] != held.index)),
            leaves.eq(leaving.sink.ready | ~passes),
            self.pairs.ready.eq(~clearing & (~present | leaves)), taken.eq(self.pairs.valid & self.pairs.ready),
            leaving.sink.payload.eq(held), leaving.sink.valid.eq(present & passes),
            read.addr.eq(item.supertile), read.en.eq(taken),
            write.addr.eq(at), write.en.eq(clearing), write.data.eq(0),
            self.ready.eq(~clearing), self.busy.eq(present | leaving.source.valid)]
        with m.If(~clearing):
            m.d.comb += [write.addr.eq(item.supertile), write.data.eq((item.index << 1) | 1),
                         write.en.eq(taken & ~item.eye & ~item.end)]
        with m.If(present & leaves):
            m.d.sync += present.eq(0)
        with m.If(taken):
            m.d.sync += [present.eq(1), held.eq(item)]
        with m.If(clearing):
            m.d.sync += [at.eq(at + 1), clearing.eq(at != self._depth - 1)]
        with m.If(self.clear):
            m.d.sync += [at.eq(0), clearing.eq(1)]
        return m
