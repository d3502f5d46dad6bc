"""Makes the bounds of the next frame from the pairs that leave the sorter.

Every so many pairs of a super-tile there is a bound. Bounds wait in a queue, and a process at their other end numbers the lists
of the next frame: super-tile by super-tile up to that of the bound, one per cycle, and then the bound's own list. A bound comes
at most every `every` cycles, so the queue holds all that come while the process passes every super-tile of the frame.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, ResetInserter, Signal
from amaranth.lib import data, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.supertiles.bucket_search import bound_write, numbering_layout, row_write
from spec.config import AcceleratorConfig
from spec.records import chunk_item, frame_lists, frame_supertiles, list_index
from spec.supertiles import BUCKETS, supertile_index


def ends_write(config: AcceleratorConfig) -> data.StructLayout:
    """Whether a list of the next frame is the last one of its super-tile."""
    return data.StructLayout({"en": 1, "list": shape(list_index(config)), "ends": 1})


class BoundsMaker(wiring.Component):
    """Sees every pair that leaves the sorter, makes the bounds of the next frame, and numbers its lists.

    Parameters:
        config: the machine.
        every: pairs between two bounds, 2 or more.

    Ports:
        item, taken: the ChunkItem that leaves the sorter, and whether it does in this cycle.
        owner_list, owner: a list, and its super-tile a cycle later.
        clear: strobe: a frame begins; `limit` is the most bounds that it may make.
        forget: strobe: no bounds are made until the next `clear`.
        numbering, left: the next frame's numbering, and how many bounds it might have had more.
        row, bound, ends: what is written to the tables of the next frame.
        busy: a pair or a bound has not yet changed `numbering`.

    Storage: a few bounds. Throughput: one pair per cycle. Latency: a few cycles from a pair to its bound, and one more for each
    super-tile after that of the bound before.
    """

    def __init__(self, config: AcceleratorConfig, every: int):
        self.config, self._every = config, every
        lists = frame_lists(config)
        super().__init__({
            "item": In(layout(chunk_item(config))), "taken": In(1),
            "owner_list": Out(shape(list_index(config))), "owner": In(supertile_index(config)),
            "clear": In(1), "limit": In(range(lists + 1)), "forget": In(1),
            "numbering": Out(numbering_layout(config)), "left": Out(range(lists + 1)),
            "row": Out(row_write(config)), "bound": Out(bound_write(config)), "ends": Out(ends_write(config)),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        event = data.StructLayout({"supertile": len(self.owner), "key": shape(self.config.formats.depth_key)})
        queue = SyncFIFOBuffered(width=event.size, depth=frame_supertiles(self.config) // self._every + 4)
        m.submodules.queue = ResetInserter(self.clear | self.forget)(queue)
        seen = self._observe(m, event, queue)
        m.d.comb += self.busy.eq(seen | queue.level.any())
        self._number(m, event(queue.r_data), queue)
        return m

    def _observe(self, m: Module, event: data.StructLayout, queue: SyncFIFOBuffered) -> Signal:
        """Counts the pairs of each super-tile, and puts bounds into the queue. Returns whether a pair is inside."""
        observes, asked, told, known, seen = Signal(), Signal(), Signal(), Signal(), Signal()
        asked_key, bound = Signal(event.members["key"], reset_less=True), Signal(event, reset_less=True)
        last, number = Signal.like(self.owner, reset_less=True), Signal(range(self._every))
        same, turns = known & (bound.supertile == last), number == self._every - 1
        m.d.comb += [
            self.owner_list.eq(self.item.tile), seen.eq(asked | told),
            queue.w_data.eq(bound), queue.w_en.eq(told & same & turns),
        ]
        m.d.sync += [asked.eq(self.taken & ~self.item.empty & observes), asked_key.eq(self.item.depth_key)]
        m.d.sync += [told.eq(asked), bound.supertile.eq(self.owner), bound.key.eq(asked_key)]
        with m.If(told):
            m.d.sync += [known.eq(1), last.eq(bound.supertile), number.eq(Mux(same & ~turns, number + 1, 0))]
        with m.If(self.clear | self.forget):
            m.d.sync += [observes.eq(self.clear), known.eq(0), asked.eq(0), told.eq(0)]
        return seen

    def _number(self, m: Module, bound: data.View, queue: SyncFIFOBuffered) -> None:
        """Numbers the lists up to that of the queue's first bound."""
        now, here = self.numbering, Signal()
        m.d.comb += [
            here.eq(now.open == bound.supertile), queue.r_en.eq(here),
            self.row.en.eq(queue.r_rdy & ~here), self.row.supertile.eq(now.open),
            self.row.row.first.eq(now.at - now.made), self.row.row.made.eq(now.made),
            self.bound.en.eq(queue.r_rdy & here & (now.made != BUCKETS - 1) & self.left.any()),
            self.bound.list.eq(now.at + 1), self.bound.key.eq(bound.key),
            self.ends.en.eq(self.row.en | self.bound.en), self.ends.list.eq(now.at), self.ends.ends.eq(self.row.en),
        ]
        with m.If(self.row.en):
            m.d.sync += [now.open.eq(now.open + 1), now.at.eq(now.at + 1), now.made.eq(0)]
        with m.If(self.bound.en):
            m.d.sync += [now.at.eq(now.at + 1), now.made.eq(now.made + 1), self.left.eq(self.left - 1)]
        with m.If(self.clear | self.forget):
            m.d.sync += now.eq(0)
            m.d.sync += self.left.eq(self.limit)
