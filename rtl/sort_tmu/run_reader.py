"""Reads runs from memory ahead of their use and delivers them to the leaves of the merge tree."""

from __future__ import annotations

from collections.abc import Iterable

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.merge_tree import run_layout
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_BITS, BEAT_ENTRIES, read_data, read_request
from spec.records import intersection

_TAIL_BITS = (BEAT_ENTRIES - 1).bit_length()


def way_run(config: AcceleratorConfig) -> data.StructLayout:
    """The run of one way in the next merge.

    `beat` is its first beat and `beats` their number, 0 for a blank; `tail` is the number of intersections in its last beat
    less 1.
    """
    return data.StructLayout({
        "way": range(config.merge_ways), "beat": BEAT_BITS, "beats": BEAT_BITS, "tail": _TAIL_BITS})


class RunReader(wiring.Component):
    """One FIFO for each way; requests in turn keep all of them full.

    As soon as all beats of a way's run are requested, the way goes on to its run of the next merge, which is then there when
    the tree gets to it. A beat is requested only if its FIFO has free space for it, so that data from memory never wait.

    Parameters:
        config: the machine; only `merge_ways` and the format of an intersection are used.
        way_beats: beats that a way holds or has requested. Each beat lasts for 4 cycles of merging if all intersections come
            from one way.

    Ports:
        runs: for every merge a run, or a blank, for each way, in the order of the ways.
        reads, data: the memory's read port.
        ring_last, ring_base: a run that reaches beat ring_last continues at beat ring_base.
        sources: for each way the intersections of its runs.
        error: strobe; memory answered a read with an error.

    Storage: ways * (way_beats + 1) beats, one intersection per way, and a memory of ways * way_beats words that says which way
    each requested beat belongs to. Throughput: one beat per cycle from memory, one intersection per cycle at every source.
    Latency: the first intersection of a run leaves 4 cycles after its beat arrived.
    """

    def __init__(self, config: AcceleratorConfig, *, way_beats: int = 32):
        if not isinstance(way_beats, int) or isinstance(way_beats, bool):
            raise TypeError(f"way_beats must be an integer, not {way_beats!r}")
        if way_beats < 2:
            raise ValueError(f"way_beats must be at least 2, not {way_beats!r}")
        self._config, self._ways, self._way_beats = config, config.merge_ways, way_beats
        self._width = intersection(config).width
        super().__init__({
            "runs": In(stream.Signature(way_run(config))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "ring_last": In(BEAT_BITS),
            "ring_base": In(BEAT_BITS),
            "sources": Out(stream.Signature(run_layout(self._width))).array(self._ways),
            "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        self._fetched = data.StructLayout({
            "end": 1, "blank": 1, "tail": _TAIL_BITS, "way": range(self._ways)})
        m.submodules.fetched = fetched = SyncFIFOBuffered(width=self._fetched.size, depth=self._ways * self._way_beats)
        returned = Signal(self._ways)
        self._request(m, fetched, returned)
        self._deliver(m, fetched, returned)
        return m

    def _request(self, m: Module, fetched: SyncFIFOBuffered, returned: Value) -> None:
        """Requests the next beat of one way in every cycle; the ways take turns."""
        ways, run = self._ways, self.runs.payload
        wants, busy, later = Signal(ways), Signal(ways), Signal(ways)  # later: the ways after the one that was served last
        beats, lefts, tails = (
            [Signal(width, name=f"{what}_{i}", reset_less=True) for i in range(ways)]
            for what, width in (("beat", BEAT_BITS), ("left", BEAT_BITS), ("tail", _TAIL_BITS)))
        m.d.comb += self.runs.ready.eq(~Array(busy)[run.way])
        chosen, behind = Signal(ways), wants & later  # at most one bit is set
        m.d.comb += chosen.eq(Mux(behind.any(), _first(behind), _first(wants)))
        # decided for each way by itself, so that only single bits are selected once the turn is known
        blanks, finals = Signal(ways), Signal(ways)
        m.d.comb += finals.eq(Cat(left[1:] == 0 for left in lefts))
        blank, ends = (chosen & blanks).any(), (chosen & finals).any()
        item = data.View(self._fetched, fetched.w_data)
        free, grant = ~self.reads.valid | self.reads.ready, Signal()
        m.d.comb += [
            grant.eq(wants.any() & (free | blank)),
            fetched.w_en.eq(grant),
            item.way.eq(Cat(Cat(chosen[i] for i in range(ways) if i >> k & 1).any() for k in range(len(run.way)))),
            item.end.eq(ends),
            item.blank.eq(blank),
            item.tail.eq(Mux(blank, 0, Mux(ends, _chosen(chosen, tails), BEAT_ENTRIES - 1))),
        ]
        beat = Signal(BEAT_BITS, name="beat", reset_less=True)
        m.d.comb += self.reads.payload.beat.eq(beat)
        with m.If(free):
            m.d.sync += [self.reads.valid.eq(grant & ~blank), beat.eq(_chosen(chosen, beats))]
        with m.If(grant):
            m.d.sync += later.eq(Cat(chosen[:i].any() for i in range(ways)))
        for i in range(ways):
            following = Mux(beats[i] == self.ring_last, self.ring_base, beats[i] + 1)
            room = Signal(range(self._way_beats + 1), name=f"room_{i}", init=self._way_beats)
            some, mine = Signal(name=f"some_{i}", init=1), grant & chosen[i]  # some: there is free space
            m.d.comb += wants[i].eq(busy[i] & some)
            with m.If(mine & ~returned[i]):
                m.d.sync += [room.eq(room - 1), some.eq(room != 1)]
            with m.Elif(returned[i] & ~mine):
                m.d.sync += [room.eq(room + 1), some.eq(1)]
            with m.If(mine):
                m.d.sync += [beats[i].eq(following), lefts[i].eq(lefts[i] - 1), busy[i].eq(~finals[i])]
            with m.If(self.runs.valid & self.runs.ready & (run.way == i)):
                m.d.sync += blanks[i].eq(run.beats == 0)
                m.d.sync += [busy[i].eq(1), beats[i].eq(run.beat), lefts[i].eq(run.beats), tails[i].eq(run.tail)]

    def _deliver(self, m: Module, fetched: SyncFIFOBuffered, returned: Value) -> None:
        """Stores arriving beats in the FIFOs of their ways, and takes intersections out of these."""
        item = data.View(self._fetched, fetched.r_data)
        arrives, words = Signal(), Cat(self.data.payload.word)
        m.d.comb += [
            arrives.eq(fetched.r_rdy & (item.blank | self.data.valid)),
            fetched.r_en.eq(arrives),
            self.data.ready.eq(fetched.r_rdy & ~item.blank),
            self.error.eq(self.data.valid & self.data.ready & self.data.payload.error),
        ]
        kept = data.StructLayout({"words": len(words), "end": 1, "blank": 1, "tail": _TAIL_BITS})
        for i, source in enumerate(self.sources):
            fifo = SyncFIFOBuffered(width=kept.size, depth=self._way_beats + 1)  # one of its words is the output register
            m.submodules[f"way_{i}"] = fifo
            kept_in, kept_out = data.View(kept, fifo.w_data), data.View(kept, fifo.r_data)
            place, goes_on = Signal(_TAIL_BITS, name=f"place_{i}"), ~source.valid | source.ready
            beat_ends, moves = place == kept_out.tail, fifo.r_rdy & goes_on
            m.d.comb += [
                kept_in.words.eq(words),
                *(kept_in[name].eq(item[name]) for name in ("end", "blank", "tail")),
                fifo.w_en.eq(arrives & (item.way == i)),
                fifo.r_en.eq(goes_on & beat_ends),
            ]
            head = Signal(source.payload.shape(), name=f"head_{i}", reset_less=True)
            m.d.comb += source.payload.eq(head)
            m.d.sync += returned[i].eq(moves & beat_ends)
            with m.If(goes_on):
                m.d.sync += source.valid.eq(fifo.r_rdy)
                m.d.sync += [
                    head.word.eq(kept_out.words.word_select(place, 8 * ENTRY_BYTES)),
                    head.last.eq(kept_out.end & beat_ends),
                    head.blank.eq(kept_out.blank),
                ]
            with m.If(moves):
                m.d.sync += place.eq(Mux(beat_ends, 0, place + 1))


def _first(bits: Value) -> Value:
    """Only the lowest bit that is high."""
    return Cat(bits[i] & ~bits[:i].any() for i in range(len(bits)))


def _chosen(chosen: Value, values: Iterable[Value]) -> Value:
    """The value whose bit in `chosen` is high; at most one is."""
    found: Value = Const(0)
    for bit, value in zip(chosen, values, strict=True):
        found = found | value & bit.replicate(len(value))
    return found
