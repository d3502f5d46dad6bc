"""Writes sorted runs to memory: packs intersections into beats, queues the beats of both sources, and observes fences."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_BITS, BEAT_ENTRIES, WORDS, write_request
from spec.records import intersection

_ENTRY_BITS = 8 * ENTRY_BYTES


def written_entry(config: AcceleratorConfig) -> data.StructLayout:
    """An intersection to be written.

    `last` marks the end of its run. `fence` asks for a report when it and everything before it is in memory. With `nothing`
    there is no intersection, only the fence.
    """
    return data.StructLayout({"word": intersection(config).width, "last": 1, "fence": 1, "nothing": 1})


def written_beat() -> data.StructLayout:
    """A beat to be written; `fence` and `nothing` are those of its last intersection."""
    return data.StructLayout({"beat": BEAT_BITS, "words": _ENTRY_BITS * BEAT_ENTRIES, "fence": 1, "nothing": 1})


class BeatPacker(wiring.Component):
    """Packs the intersections of runs into beats. Each run begins with a new beat; unused words of its last beat are undefined.

    Ports:
        sink: intersections.
        begin: first beat of a run; sampled when the first intersection of the run is taken.
        ring_last, ring_base: a run that reaches beat ring_last continues at beat ring_base.
        source: beats.

    Throughput: one intersection per cycle. Latency: 1 cycle.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__({
            "sink": In(stream.Signature(written_entry(config))),
            "begin": In(BEAT_BITS),
            "ring_last": In(BEAT_BITS),
            "ring_base": In(BEAT_BITS),
            "source": Out(stream.Signature(written_beat())),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        item, out = self.sink.payload, self.source.payload
        taken, left = self.sink.valid & self.sink.ready, self.source.valid & self.source.ready
        words = [Signal(_ENTRY_BITS, name=f"word_{i}", reset_less=True) for i in range(BEAT_ENTRIES)]
        beat, place, first = Signal(BEAT_BITS, reset_less=True), Signal(range(BEAT_ENTRIES)), Signal(init=1)
        m.d.comb += [
            self.sink.ready.eq(~self.source.valid | self.source.ready),
            out.beat.eq(beat),
            *(out.words.word_select(i, _ENTRY_BITS).eq(word) for i, word in enumerate(words)),
        ]
        with m.If(left):
            m.d.sync += [self.source.valid.eq(0), beat.eq(Mux(beat == self.ring_last, self.ring_base, beat + 1))]
        with m.If(taken):
            full = (place == BEAT_ENTRIES - 1) | item.last | item.nothing
            m.d.sync += [
                self.source.valid.eq(full), place.eq(Mux(full, 0, place + 1)), first.eq(item.last | item.nothing),
                out.fence.eq(item.fence), out.nothing.eq(item.nothing),
            ]
            with m.If(first):
                m.d.sync += beat.eq(self.begin)
            for i, word in enumerate(words):
                with m.If(place == i):
                    m.d.sync += word.eq(item.word)
        return m


class RunWriter(wiring.Component):
    """Writes the beats of chunks' runs and of merged runs through one write port.

    After a beat with a fence nothing is written until memory reports that every write is complete; meanwhile the queue takes
    what arrives.

    Parameters:
        config: the machine.
        depth: beats of the queue; the chunk sorter takes 4 cycles to make each.

    Ports:
        chunks, merged: beats of the two sources; merged runs take precedence.
        writes, writes_idle: the memory's write port; `writes_idle` says that every write is complete.
        chunks_there, merged_there: strobes; a fence of this source has been passed.

    Storage: `depth` beats with their addresses. Throughput: one beat per cycle. Beats leave in the order in which the queue
    took them.
    """

    def __init__(self, config: AcceleratorConfig, *, depth: int = 32):
        if not isinstance(depth, int) or isinstance(depth, bool):
            raise TypeError(f"depth must be an integer, not {depth!r}")
        if depth < 2:
            raise ValueError(f"depth must be at least 2, not {depth!r}")
        self._depth = depth
        beats = stream.Signature(written_beat())
        super().__init__({
            "chunks": In(beats), "merged": In(beats),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            "chunks_there": Out(1), "merged_there": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        item = data.StructLayout({"request": written_beat(), "merged": 1})
        m.submodules.queue = queue = SyncFIFOBuffered(width=item.size, depth=self._depth)
        put, head = data.View(item, queue.w_data), data.View(item, queue.r_data)
        m.d.comb += [
            put.merged.eq(self.merged.valid),
            put.request.eq(Mux(self.merged.valid, self.merged.payload, self.chunks.payload)),
            queue.w_en.eq(self.merged.valid | self.chunks.valid),
            self.merged.ready.eq(queue.w_rdy),
            self.chunks.ready.eq(queue.w_rdy & ~self.merged.valid),
        ]
        written = Signal()  # the beat at the queue's head is written and waits for its fence
        needs, out = ~(written | head.request.nothing), self.writes.payload
        passed = Signal()
        m.d.comb += [
            self.writes.valid.eq(queue.r_rdy & needs),
            out.beat.eq(head.request.beat),
            *(out.word[i].eq(head.request.words.word_select(i, 32)) for i in range(WORDS)),
            out.strobe.eq(~0),
            passed.eq(queue.r_rdy & ~needs & self.writes_idle),
            queue.r_en.eq(Mux(needs, self.writes.ready & ~head.request.fence, passed)),
            self.chunks_there.eq(passed & ~head.merged),
            self.merged_there.eq(passed & head.merged),
        ]
        with m.If(queue.r_rdy & needs & self.writes.ready):
            m.d.sync += written.eq(head.request.fence)
        with m.Elif(passed):
            m.d.sync += written.eq(0)
        return m
