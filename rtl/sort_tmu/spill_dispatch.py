"""Decides where sorted chunks go: directly to the output, or as runs into the ring of the spill region."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.merge_plan import part_layout, run_beats, run_bits
from rtl.sort_tmu.run_writer import written_entry
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES
from spec.records import chunk_item, intersection


def cut_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A chunk that is not a whole group.

    `number` counts chunks modulo more than the sorter can hold; `last` says that the group ends with this chunk.
    """
    return data.StructLayout({"number": (4 * config.sort_chunk - 1).bit_length(), "last": 1})


class SpillDispatch(wiring.Component):
    """Sends sorted chunks to the output or to memory.

    A chunk that is a whole group goes out as soon as no spilled group is ahead of it. Other chunks wait until the ring has free
    space for a run. A part is the unit that will be merged, normally all runs of a group. If the ring is filled by the open
    part alone, the part ends there and the group continues with another part. If the region has no space for even one run, the
    chunks of the group leave one by one. In both cases the group is not in order, but nothing is lost and nothing waits for
    ever.

    Ports:
        chunks: sorted chunks.
        cuts: the chunks that are not whole groups; a cut must arrive before its chunk.
        direct: intersections that go directly to the output.
        run_entries, run_begin: intersections for memory, and the first beat of the run whose first intersection is offered.
        parts: parts, offered when they end; the fence of a part's last run tells when it may be merged.
        ring_base, ring_runs: first beat of the ring and its size in runs.
        freed: strobe; a part has been merged and has left, and its `freed_runs` are free again from the second cycle after
            this.
        overflow: strobe; the ring is too small for a group.
        active: a part is open or has not left yet.

    Throughput: one intersection per cycle; both outputs are combinational. Chunks and parts keep their order.
    """

    def __init__(self, config: AcceleratorConfig):
        self._config = config
        bits, items = run_bits(config), stream.Signature(layout(chunk_item(config)))
        super().__init__({
            "chunks": In(items),
            "cuts": In(stream.Signature(cut_layout(config))),
            "direct": Out(items),
            "run_entries": Out(stream.Signature(written_entry(config))),
            "run_begin": Out(BEAT_BITS),
            "parts": Out(stream.Signature(part_layout(config))),
            "ring_base": In(BEAT_BITS), "ring_runs": In(bits),
            "freed": In(1), "freed_runs": In(bits),
            "overflow": Out(1), "active": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        bits, config = run_bits(self._config), self._config
        shift = run_beats(config).bit_length() - 1
        # `number` is that of the current chunk; `inside` says that its first intersection has been taken
        number, inside = Signal(cut_layout(config)["number"].shape), Signal()
        # In runs of the ring: how many are in use, the next one to use, the first of the open part, the length of the open
        # part.
        used, following, first, runs = (
            Signal(bits, name=name) for name in ("used", "following", "first", "runs"))
        # `parts` are closed parts that have not left; `count` intersections of the current run are taken.
        parts, count = Signal(4), Signal(range(config.sort_chunk))
        item, opened, taken = self.chunks.payload, runs != 0, self.chunks.valid & self.chunks.ready
        cut = self.cuts.valid & (self.cuts.payload.number == number)
        names = ("spills", "ends", "closes", "splits", "admitted")
        spills, ends, closes, splits, admitted = (Signal(name=name) for name in names)
        room, idle = used != self.ring_runs, parts == 0
        few, closed = ~parts.all(), Signal()  # `closed`: a part closed in the previous cycle
        freed, freed_runs = Signal(), Signal(bits)
        m.d.sync += [freed.eq(self.freed), freed_runs.eq(Mux(self.freed, self.freed_runs, 0))]
        more = self.parts.ready & ~closed & few  # the queue has free space for a part
        m.d.comb += [
            spills.eq(cut & (self.ring_runs != 0)),
            ends.eq(item.last & self.cuts.payload.last),
            splits.eq(self.chunks.valid & spills & ~inside & ~room & opened & idle),
            self.active.eq(opened | ~idle),
            self.overflow.eq(splits & more & self.run_entries.ready | taken & cut & ~spills),
            admitted.eq((inside | room) & (~ends | more)),
            self.run_begin.eq(self.ring_base + (following << shift)),
        ]
        self._out(m, cut, spills, admitted, splits, ends, more)
        m.d.comb += closes.eq(self.run_entries.valid & self.run_entries.ready & (ends | splits))
        self._close(m, closes, closed, splits, count, Mux(opened, first, following), runs)
        m.d.comb += self.cuts.ready.eq(taken & item.last & cut)
        with m.If(taken):
            m.d.sync += [inside.eq(~item.last), number.eq(number + item.last), count.eq(Mux(item.last, 0, count + 1))]
        begins = taken & spills & ~inside
        with m.If(begins):
            m.d.sync += [following.eq(Mux(following == self.ring_runs - 1, 0, following + 1)), runs.eq(runs + 1)]
            with m.If(~opened):
                m.d.sync += first.eq(following)
        with m.Elif(~self.active):
            m.d.sync += following.eq(0)  # the region may be changed while nothing is in it
        with m.If(closes):
            m.d.sync += runs.eq(0)
        m.d.sync += [
            used.eq(Mux(begins, used - freed_runs + 1, used - freed_runs)),  # both sums are computed before `begins` is known
            parts.eq(parts + closes - freed),
        ]
        return m

    def _out(
        self, m: Module, cut: Signal, spills: Signal, admitted: Signal, splits: Signal, ends: Signal, more: Value,
    ) -> None:
        """Drives the two outputs."""
        item, out, run = self.chunks.payload, self.direct.payload, self.run_entries.payload
        m.d.comb += [
            self.direct.valid.eq(self.chunks.valid & ~spills & ~self.active),
            out.eq(item),
            out.last.eq(item.last & (~cut | self.cuts.payload.last)),
            self.run_entries.valid.eq(Mux(splits, more, self.chunks.valid & spills & admitted)),
            run.last.eq(item.last | splits),
            run.fence.eq(ends | splits),
            run.nothing.eq(splits),
            run.word.eq(item.as_value()[: intersection(self._config).width]),
            self.chunks.ready.eq(Mux(
                spills, self.run_entries.ready & admitted & ~splits, self.direct.ready & ~self.active)),
        ]

    def _close(
        self, m: Module, closes: Signal, closed: Signal, splits: Signal, count: Signal, first: Value, runs: Signal,
    ) -> None:
        """Registers and offers a closed part. It ended in the previous cycle, with the item taken or, if split, before it."""
        part, shift, places = self.parts.payload, run_beats(self._config).bit_length() - 1, (BEAT_ENTRIES - 1).bit_length()
        offset, all_runs, length, split = (Signal.like(signal, name=name, reset_less=True) for name, signal in (
            ("offset", runs), ("all_runs", runs), ("length", count), ("split", splits)))
        m.d.sync += [
            closed.eq(closes), offset.eq(first), length.eq(count), split.eq(splits),
            # `runs` does not yet count a run whose first intersection closes the part
            all_runs.eq(Mux(splits | (count != 0), runs, runs + 1)),
        ]
        m.d.comb += [
            self.parts.valid.eq(closed),
            part.offset.eq(offset << shift),
            part.runs.eq(all_runs),
            part.beats.eq(Mux(split, all_runs << shift, ((all_runs - 1) << shift) + (length >> places) + 1)),
            part.tail.eq(Mux(split, BEAT_ENTRIES - 1, length[:places])),
            part.last.eq(~split),
        ]
