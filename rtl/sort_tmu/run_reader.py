"""Runs from memory to the leaves of the merge tree, read ahead."""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.merge_tree import run_layout
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES, read_data, read_request
from spec.records import ENTRY_BYTES, tile_entry

_TAIL_BITS = (BEAT_ENTRIES - 1).bit_length()


def way_run(config: AcceleratorConfig) -> data.StructLayout:
    """A way's run in the next merge: its place in memory, and entries of its last beat less 1; blank without beats."""
    return data.StructLayout({
        "way": range(config.merge_ways), "beat": BEAT_BITS, "beats": BEAT_BITS, "tail": _TAIL_BITS})


class RunReader(wiring.Component):
    """One FIFO a way, kept full by requests in turn.

    A way goes on to its run of the next merge as soon as all of this one's beats are requested: what follows is there when
    the tree gets to it. A request is made only where its beat has room, so that data never wait.

    Parameters:
        config: the machine; `merge_ways` and the entry's format matter here.
        way_beats: beats a way holds or has requested: 4 cycles of merging each, should all entries come from one way.

    Ports:
        runs: runs of the ways, ways in order, merge after merge; blanks where a merge has fewer.
        reads, data: memory.
        ring_end, ring_base: behind beat ring_end - 1 a run continues at ring_base.
        sources: entries of each way's runs.
        error: strobe, memory answered with an error.

    Storage: ways * (way_beats + 1) beats, and a memory of ways * way_beats words that says whose the beats on their way are.
    Throughput: a beat a cycle from memory, an entry a cycle at every source. Latency: a run's first entry leaves 3 cycles after
    its beat has come.
    """

    def __init__(self, config: AcceleratorConfig, *, way_beats: int = 32):
        if not isinstance(way_beats, int) or isinstance(way_beats, bool):
            raise TypeError(f"way_beats must be an integer, not {way_beats!r}")
        if way_beats < 2:
            raise ValueError(f"way_beats must be at least 2, not {way_beats!r}")
        self._config, self._ways, self._way_beats = config, config.merge_ways, way_beats
        self._width = tile_entry(config).width
        super().__init__({
            "runs": In(stream.Signature(way_run(config))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "ring_end": In(BEAT_BITS + 1),
            "ring_base": In(BEAT_BITS),
            "sources": Out(stream.Signature(run_layout(self._width))).array(self._ways),
            "error": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        self._fetched = data.StructLayout({
            "end": 1, "blank": 1, "tail": _TAIL_BITS, "way": range(self._ways)})
        m.submodules.fetched = fetched = SyncFIFOBuffered(width=self._fetched.size, depth=self._ways * self._way_beats)
        returned = Signal(self._ways)
        self._request(m, fetched, returned)
        self._deliver(m, fetched, returned)
        return m

    def _request(self, m: Module, fetched: SyncFIFOBuffered, returned: Value) -> None:
        """One way's next beat a cycle, in turn."""
        ways, run = self._ways, self.runs.payload
        wants, busy, turn, way, some = Signal(ways), Signal(ways), Signal(range(ways)), Signal(range(ways)), Signal()
        beats, lefts, tails = (
            [Signal(width, name=f"{what}_{i}", reset_less=True) for i in range(ways)]
            for what, width in (("beat", BEAT_BITS), ("left", BEAT_BITS), ("tail", _TAIL_BITS)))
        m.d.comb += [self.runs.ready.eq(~Array(busy)[run.way]), some.eq(wants.any())]
        later = wants & ~((2 << turn) - 1)[:ways]
        for i in reversed(range(ways)):
            with m.If(wants[i]):
                m.d.comb += way.eq(i)
        for i in reversed(range(ways)):
            with m.If(later[i]):
                m.d.comb += way.eq(i)
        blanks, finals = Signal(ways), Signal(ways)  # every way's own, so that only bits of it wait for the turn
        m.d.comb += [blanks.eq(Cat(left == 0 for left in lefts)), finals.eq(Cat(left[1:] == 0 for left in lefts))]
        blank, ends = blanks.bit_select(way, 1), finals.bit_select(way, 1)
        item = data.View(self._fetched, fetched.w_data)
        free, grant = ~self.reads.valid | self.reads.ready, Signal()
        m.d.comb += [
            grant.eq(some & (free | blank)),
            fetched.w_en.eq(grant),
            item.way.eq(way),
            item.end.eq(ends),
            item.blank.eq(blank),
            item.tail.eq(Mux(blank, 0, Mux(ends, Array(tails)[way], BEAT_ENTRIES - 1))),
        ]
        with m.If(free):
            m.d.sync += self.reads.valid.eq(grant & ~blank)
        with m.If(grant & ~blank):
            m.d.sync += self.reads.payload.beat.eq(Array(beats)[way])
        with m.If(grant):
            m.d.sync += turn.eq(way)
        final_beat = self.ring_end - 1
        for i in range(ways):
            following = Mux(beats[i] == final_beat, self.ring_base, beats[i] + 1)
            room, mine = Signal(range(self._way_beats + 1), name=f"room_{i}", init=self._way_beats), grant & (way == i)
            m.d.comb += wants[i].eq(busy[i] & room.any())
            m.d.sync += room.eq(room - mine + returned[i])
            with m.If(mine):
                m.d.sync += [beats[i].eq(following), lefts[i].eq(lefts[i] - 1), busy[i].eq(~finals[i])]
            with m.If(self.runs.valid & self.runs.ready & (run.way == i)):
                m.d.sync += [busy[i].eq(1), beats[i].eq(run.beat), lefts[i].eq(run.beats), tails[i].eq(run.tail)]

    def _deliver(self, m: Module, fetched: SyncFIFOBuffered, returned: Value) -> None:
        """Beats to the FIFOs of their ways, entries out of those."""
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
            fifo = SyncFIFOBuffered(width=kept.size, depth=self._way_beats + 1)  # its last word is a register
            m.submodules[f"way_{i}"] = fifo
            kept_in, kept_out = data.View(kept, fifo.w_data), data.View(kept, fifo.r_data)
            place = Signal(_TAIL_BITS, name=f"place_{i}")
            beat_ends, taken = place == kept_out.tail, source.valid & source.ready
            m.d.comb += [
                kept_in.words.eq(words),
                *(kept_in[name].eq(item[name]) for name in ("end", "blank", "tail")),
                fifo.w_en.eq(arrives & (item.way == i)),
                source.valid.eq(fifo.r_rdy),
                source.payload.word.eq(kept_out.words.word_select(place, 8 * ENTRY_BYTES)),
                source.payload.last.eq(kept_out.end & beat_ends),
                source.payload.blank.eq(kept_out.blank),
                fifo.r_en.eq(taken & beat_ends),
                returned[i].eq(taken & beat_ends),
            ]
            with m.If(taken):
                m.d.sync += place.eq(Mux(beat_ends, 0, place + 1))
