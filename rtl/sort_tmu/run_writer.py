"""Sorted runs to memory: entries packed into beats, a queue for both sources of runs, and fences."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_BITS, BEAT_ENTRIES, WORDS, write_request
from spec.records import tile_entry

_ENTRY_BITS = 8 * ENTRY_BYTES


def written_entry(config: AcceleratorConfig) -> data.StructLayout:
    """An entry for memory, or with `nothing` none; `last` of its run; `fence`: tell when it and all before it are in memory."""
    return data.StructLayout({"word": tile_entry(config).width, "last": 1, "fence": 1, "nothing": 1})


def written_beat() -> data.StructLayout:
    """The same for whole beats."""
    return data.StructLayout({"beat": BEAT_BITS, "words": _ENTRY_BITS * BEAT_ENTRIES, "fence": 1, "nothing": 1})


class BeatPacker(wiring.Component):
    """Entries of runs to beats; a run begins with a new one, and what its last beat lacks is left as it was before.

    Ports:
        sink: entries.
        begin: beat of the run whose first entry is taken.
        ring_last, ring_base: behind beat ring_last a run continues at ring_base.
        source: beats.

    Throughput: an entry a cycle. Latency: 1.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__({
            "sink": In(stream.Signature(written_entry(config))),
            "begin": In(BEAT_BITS),
            "ring_last": In(BEAT_BITS),
            "ring_base": In(BEAT_BITS),
            "source": Out(stream.Signature(written_beat())),
        })

    def elaborate(self, platform) -> Module:
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
    """Beats of chunks' runs and of merged runs to the write port.

    Behind a beat with a fence nothing is written until memory says that all is there; the queue takes what comes meanwhile.

    Parameters:
        config: the machine.
        depth: beats of the queue: 4 cycles of the chunk sorter each.

    Ports:
        chunks, merged: beats; merged ones go first.
        writes, writes_idle: memory.
        chunks_there, merged_there: strobes, a fence of this source is passed.

    Storage: `depth` beats with their addresses. Throughput: a beat a cycle.
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

    def elaborate(self, platform) -> Module:
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
        written = Signal()  # the head is, and waits for its fence
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
