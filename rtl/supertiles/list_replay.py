"""The second sweep over the lists of a frame with a warped target (`spec.joint_warp`)."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.joint_warp import check_sweeps
from spec.queues import COUNTER_BITS
from spec.records import COUNT_BITS, frame_lists, list_group
from spec.supertiles import supertile_index


class ListReplay(wiring.Component):
    """Passes on the lists of a frame, and gives them once more when it is told to: those of super-tiles with a hole tile as
    they were, each as a group of its own, and all others empty.

    Parameters:
        config: the machine, with a warp unit and joint frames.

    Ports:
        listed: ListGroup items of every list of a frame, in order.
        lists: the same, and those of the second sweep behind them.
        list_count: number of the frame's lists; stable from its first list on.
        again: strobe: the second sweep begins. All lists of the frame have passed.
        second: the second sweep has begun; low again with `clear`.
        number, holes: number of a super-tile, and in the next cycle whether its target has a hole tile.
        clear: strobe between frames.
        pairs_again, groups_again: pairs and groups of lists of the second sweep, since `clear`.

    Storage: a count and a bit for each list. Throughput: a list a cycle, in the second sweep one every two cycles. Latency:
    none, in the second sweep two cycles.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        check_sweeps(config)
        self._lists = frame_lists(config)
        items = stream.Signature(layout(list_group(config)))
        super().__init__({
            "listed": In(items), "lists": Out(items), "list_count": In(range(self._lists + 1)), "again": In(1),
            "second": Out(1), "number": Out(supertile_index(config)), "holes": In(1), "clear": In(1),
            "pairs_again": Out(COUNTER_BITS), "groups_again": Out(COUNTER_BITS)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        word = data.StructLayout({"count": COUNT_BITS, "ends": 1})
        m.submodules.words = words = memory.Memory(shape=word, depth=self._lists, init=[])
        write, read = words.write_port(), words.read_port()
        item, out, passes = self.listed.payload, self.lists.payload, Signal()
        at, number, gives, runs = (
            Signal(range(self._lists)), Signal.like(self.number), Signal(), Signal())
        taken, count, given = Signal(), Signal(COUNT_BITS), Signal(COUNT_BITS)
        m.d.comb += [
            passes.eq(self.listed.valid & self.listed.ready),
            write.en.eq(passes), write.addr.eq(item.tile), write.data.count.eq(item.count), write.data.ends.eq(item.ends),
            read.addr.eq(at), self.number.eq(number),
            count.eq(Mux(self.holes, read.data.count, 0)),
            self.lists.valid.eq(Mux(self.second, gives, self.listed.valid)),
            self.listed.ready.eq(self.lists.ready & ~self.second), taken.eq(gives & self.lists.ready),
            out.eq(item)]
        with m.If(self.second):
            m.d.comb += [out.tile.eq(at), out.count.eq(count), out.group.eq(at), out.last.eq(1), out.ends.eq(read.data.ends)]
        with m.If(runs):
            m.d.sync += gives.eq(~gives | ~self.lists.ready)  # a cycle for both memories, then the list
        m.d.sync += [  # a cycle late: the counts come from memories
            given.eq(Mux(taken, count, 0)), self.pairs_again.eq(self.pairs_again + given),
            self.groups_again.eq(self.groups_again + given.any())]
        with m.If(taken):
            m.d.sync += [at.eq(at + 1), number.eq(number + read.data.ends), runs.eq(at != self.list_count - 1)]
        with m.If(self.again):
            m.d.sync += [self.second.eq(1), runs.eq(1), at.eq(0), number.eq(0)]
        with m.If(self.clear):
            m.d.sync += [self.second.eq(0), runs.eq(0), gives.eq(0), self.pairs_again.eq(0), self.groups_again.eq(0)]
        return m
