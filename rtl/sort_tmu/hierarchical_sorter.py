"""The hierarchical sorting unit: sorts groups of any length."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.merge_plan import MergePlan, merge_layout, part_layout, run_beats
from rtl.sort_tmu.merge_tree import MergeTree
from rtl.sort_tmu.run_reader import RunReader
from rtl.sort_tmu.run_writer import BeatPacker, RunWriter
from rtl.sort_tmu.spill_dispatch import SpillDispatch, cut_layout
from rtl.stream import Buffer
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request, write_request
from spec.queues import COUNTER_BITS, SORT_CUTS, SORT_MERGES, SORT_PARTS
from spec.records import chunk_item, intersection


class HierarchicalSorter(wiring.Component):
    """Sorts each group by (native tile, depth key, index); groups keep their order.

    A group of at most `sort_chunk` intersections is sorted by the chunk sorter and leaves. A larger group is cut into
    chunks as it arrives. Each chunk is sorted and written to memory as a run, and the runs are merged, `merge_ways` at a time,
    as they are read back::

        groups ─► cut ─► ChunkSorter ─► SpillDispatch ──────────────────────────► sorted
                                              │ parts                       ▲ out
                                              ▼                             │
                      writes ◄─ RunWriter ◄─ runs    MergePlan ─► RunReader ─► MergeTree ─┐
                                    ▲                              ▲ reads, data          │ back
                                    └─────────────────────────────────────────────────────┘

    The first half of the spill region is a ring, in which groups allocate runs in order and free them in order. The second half
    takes merged runs, of one group at a time. The oldest group needs only its own runs and the second half to finish, so it
    always finishes, whatever waits behind it. While it is merged, the following groups are sorted; those that are too large are
    written to the ring, and one that fits the chunk sorter waits inside it until it may leave.

    Parameters:
        config: the machine; `sort_buffer_bytes`, `merge_ways`, `row_width` and the format of the depth key are used.

    Ports:
        groups: ChunkItem items. A group ends with `last`; an empty group is a single item with `last` and `empty`.
        sorted: the same groups, each sorted.
        reads, data, writes, writes_idle: the memory ports; `writes_idle` goes low in the cycle after a write was taken and is
            high again when every write is in memory.
        spill_base, spill_beats: first beat and size of the spill region; they may change only while `busy` is low.
        clear: strobe that clears `spilled`, `overflow` and `error`; a reset clears them too.
        spilled: intersections written to memory, including those of merged runs; each of them is also read once.
        overflow: a group did not fit half of the region. It left as several sorted pieces, one after another; nothing was lost.
        error: memory answered a read with an error; the intersections of that group and their order are then undefined.
        busy: at least one item is inside or spilled.

    Storage: that of ChunkSorter, plus merge_ways * 33 beats that are read ahead (8.4 KB for 8 ways) and 32 beats to write.
    Throughput: one intersection per cycle while groups fit the chunk sorter. The same holds for a sequence of spilled groups of
    at most `merge_ways` chunks each if the ring can hold three of them. A group that fits waits for the merge of a spilled
    group ahead of it. The intersections of a still larger group pass the tree more than once: see MergePlan.
    Latency: that of ChunkSorter. The first intersection of a spilled group leaves about 26 + 2 * merge_ways cycles, plus the
    latencies of one write and one read, after the group's last intersection was sorted.
    """

    def __init__(self, config: AcceleratorConfig):
        self._sorter = ChunkSorter(config)
        self.config = config
        items = stream.Signature(layout(chunk_item(config)))
        super().__init__({
            "groups": In(items),
            "sorted": Out(items),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            "spill_base": In(BEAT_BITS),
            "spill_beats": In(BEAT_BITS),
            "clear": In(1),
            "spilled": Out(COUNTER_BITS),
            "overflow": Out(1),
            "error": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m, config = Module(), self.config
        width = intersection(config).width
        m.submodules.sorter = sorter = self._sorter
        m.submodules.dispatch = dispatch = SpillDispatch(config)
        m.submodules.chunk_packer = chunk_packer = BeatPacker(config)
        m.submodules.merged_packer = merged_packer = BeatPacker(config)
        m.submodules.writer = writer = RunWriter(config)
        m.submodules.plan = plan = MergePlan(config)
        m.submodules.reader = reader = RunReader(config)
        m.submodules.tree = tree = MergeTree(width, config.merge_ways)
        for source, sink in (
                (sorter.sorted, dispatch.chunks), (dispatch.run_entries, chunk_packer.sink), (plan.runs, reader.runs),
                (chunk_packer.source, writer.chunks), (merged_packer.source, writer.merged),
                (reader.reads, wiring.flipped(self.reads)), (wiring.flipped(self.data), reader.data),
                (writer.writes, wiring.flipped(self.writes))):
            wiring.connect(m, source, sink)
        for i, (run, sink) in enumerate(zip(reader.sources, tree.sinks, strict=True)):
            # What the tree takes depends on all of its nodes, and the reader's next address on that.
            m.submodules[f"head_{i}"] = head = Buffer(sink.payload.shape())
            wiring.connect(m, run, head.sink)
            wiring.connect(m, head.source, sink)
        m.d.comb += [
            writer.writes_idle.eq(self.writes_idle), chunk_packer.begin.eq(dispatch.run_begin),
            plan.written.eq(writer.merged_there), self.busy.eq(sorter.busy | dispatch.active),
        ]
        self._ring(m, dispatch, plan, (chunk_packer, merged_packer, reader))
        self._cut(m, sorter, dispatch)
        self._parts(m, dispatch, plan, writer.chunks_there)
        self._leave(m, dispatch, plan, tree, merged_packer)
        moved = Signal(2)
        for place, s in enumerate((dispatch.run_entries, merged_packer.sink)):
            m.d.sync += moved[place].eq(~self.clear & s.valid & s.ready & ~s.payload.nothing)
        m.d.sync += [
            self.spilled.eq(Mux(self.clear, 0, self.spilled + moved[0] + moved[1])),
            self.overflow.eq(~self.clear & (self.overflow | dispatch.overflow)),
            self.error.eq(~self.clear & (self.error | reader.error)),
        ]
        return m

    def _ring(self, m: Module, dispatch: SpillDispatch, plan: MergePlan, followers: tuple[wiring.Component, ...]) -> None:
        """Registers the bounds of the region's ring; each half of the region is a whole number of runs."""
        shift = run_beats(self.config).bit_length() - 1
        runs, base, beats, end, last = (Signal(width, name=f"ring_{name}") for name, width in (
            ("runs", len(dispatch.ring_runs)), ("base", BEAT_BITS), ("beats", BEAT_BITS), ("end", BEAT_BITS + 1),
            ("last", BEAT_BITS)))
        m.d.comb += [
            dispatch.ring_runs.eq(runs), dispatch.ring_base.eq(base),
            plan.ring_base.eq(base), plan.ring_beats.eq(beats), plan.ring_end.eq(end)]
        m.d.comb += [signal.eq(value) for f in followers for signal, value in ((f.ring_last, last), (f.ring_base, base))]
        m.d.sync += [
            runs.eq(self.spill_beats >> shift + 1), base.eq(self.spill_base), beats.eq(runs << shift), end.eq(base + beats),
            last.eq(end - 1)]

    def _cut(self, m: Module, sorter: ChunkSorter, dispatch: SpillDispatch) -> None:
        """Cuts groups into chunks; a FIFO beside the sorter says which chunks are not whole groups."""
        cut = cut_layout(self.config)
        # a cut reaches the dispatch before its chunk is sorted
        m.submodules.cuts = cuts = SyncFIFOBuffered(width=cut.size, depth=SORT_CUTS)
        place, number, more = Signal(range(sorter.capacity)), Signal(cut["number"].shape), Signal()
        item, chunk, put = self.groups.payload, sorter.chunks.payload, data.View(cut, cuts.w_data)
        taken = self.groups.valid & self.groups.ready
        m.d.comb += [
            chunk.eq(item),
            chunk.last.eq(item.last | (place == sorter.capacity - 1)),
            sorter.chunks.valid.eq(self.groups.valid & cuts.w_rdy),
            self.groups.ready.eq(sorter.chunks.ready & cuts.w_rdy),
            put.number.eq(number),
            put.last.eq(item.last),
            cuts.w_en.eq(taken & chunk.last & (more | ~item.last)),
            dispatch.cuts.valid.eq(cuts.r_rdy),
            dispatch.cuts.payload.eq(cuts.r_data),
            cuts.r_en.eq(dispatch.cuts.ready),
        ]
        with m.If(taken):
            m.d.sync += [place.eq(Mux(chunk.last, 0, place + 1)), number.eq(number + chunk.last)]
            with m.If(chunk.last):
                m.d.sync += more.eq(~item.last)

    def _parts(self, m: Module, dispatch: SpillDispatch, plan: MergePlan, there: Value) -> None:
        """Passes a part to the merge plan as soon as all of it is in memory."""
        m.submodules.parts = parts = SyncFIFOBuffered(width=part_layout(self.config).size, depth=SORT_PARTS)
        visible = Signal(range(16))
        gone = plan.parts.valid & plan.parts.ready
        m.d.comb += [
            parts.w_en.eq(dispatch.parts.valid),
            parts.w_data.eq(dispatch.parts.payload),
            dispatch.parts.ready.eq(parts.w_rdy),
            plan.parts.valid.eq(parts.r_rdy & visible.any()),
            plan.parts.payload.eq(parts.r_data),
            parts.r_en.eq(gone),
        ]
        m.d.sync += visible.eq(visible + there - gone)

    def _leave(
        self, m: Module, dispatch: SpillDispatch, plan: MergePlan, tree: MergeTree, packer: BeatPacker,
    ) -> None:
        """Sends merged intersections to the output or back to memory; sorted chunks leave directly if no merge is pending."""
        merge = merge_layout(self.config)
        m.submodules.merges = merges = SyncFIFOBuffered(width=merge.size, depth=SORT_MERGES)
        goal, head, out, back = data.View(merge, merges.r_data), tree.source.payload, self.sorted.payload, packer.sink.payload
        fields = [out[f.name] for f in intersection(self.config).fields]
        there, ready = tree.source.valid & merges.r_rdy, Mux(goal.back, packer.sink.ready, self.sorted.ready)
        ends = there & ready & head.last
        m.d.comb += [
            merges.w_en.eq(plan.merges.valid),
            merges.w_data.eq(plan.merges.payload),
            plan.merges.ready.eq(merges.w_rdy),
            merges.r_en.eq(ends),
            tree.source.ready.eq(merges.r_rdy & ready),
            packer.begin.eq(goal.beat),
            packer.sink.valid.eq(there & goal.back),
            back.word.eq(head.word),
            back.last.eq(head.last),
            back.fence.eq(head.last),
            dispatch.freed.eq(ends & ~goal.back),
            dispatch.freed_runs.eq(goal.runs),
        ]
        with m.If(dispatch.active):
            m.d.comb += [
                self.sorted.valid.eq(there & ~goal.back),
                Cat(fields).eq(head.word),
                out.last.eq(head.last & goal.last),
            ]
        with m.Else():
            m.d.comb += [
                self.sorted.valid.eq(dispatch.direct.valid), out.eq(dispatch.direct.payload),
                dispatch.direct.ready.eq(self.sorted.ready),
            ]
