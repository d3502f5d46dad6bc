r"""The schedule of the merge tree: which runs are merged, and when.

A part is a piece of a group that lies in memory as sorted runs, one after another. All of these runs but the last have the same
length. While a part has more runs than the tree has ways, the oldest min(ways, runs - ways + 1) of them are merged into one
longer run and written back. When no more runs than ways are left, they are merged into the output. A longer run is `ways` times
as long as its sources, except for the last one, so that addresses need no table::

    ways 4, 9 runs       0 1 2 3   4 5 6   7 8           in the ring
                         \_____/   \___/   |  |
                           0..3     4..6   |  |           in the scratch half
                             \________\___|__/
                                         out              2 of the 9 runs were not moved

Once every run of one length has been merged, the longer runs are the input of the next round. That round writes to where the
shorter runs were, so that the rounds alternate between the part's place in the ring and the scratch half of the spill region.
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.run_reader import way_run
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES


def part_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A part: sorted runs of one group in memory.

    `offset` is its first beat, counted from the base of the ring; `runs` and `beats` are its size; `tail` is the number of
    intersections in its last beat less 1; `last` says that the group ends with this part.
    """
    return data.StructLayout({
        "offset": BEAT_BITS, "runs": run_bits(config), "beats": BEAT_BITS, "tail": range(BEAT_ENTRIES), "last": 1})


def merge_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Where the result of a merge goes.

    With `back` it goes back to memory, from `beat` on. Otherwise it goes to the output: `last` then says that its group ends
    with it, and `runs` how many runs of the ring are free afterwards.
    """
    return data.StructLayout({"back": 1, "beat": BEAT_BITS, "last": 1, "runs": run_bits(config)})


def run_beats(config: AcceleratorConfig) -> int:
    """Beats of the run that a full chunk makes."""
    return config.sort_chunk // BEAT_ENTRIES


def run_bits(config: AcceleratorConfig) -> int:
    """Width in bits of a number of runs."""
    return BEAT_BITS - (run_beats(config).bit_length() - 1)


class _Place(wiring.Component):
    """Turns the place of a run in its part into a place in memory; two pipeline registers."""

    def __init__(self, config: AcceleratorConfig):
        self._shape = data.StructLayout({"run": way_run(config), "place": BEAT_BITS + 1, "odd": 1})
        super().__init__({
            "sink": In(stream.Signature(self._shape)), "source": Out(stream.Signature(way_run(config))),
            "ring_base": In(BEAT_BITS), "ring_beats": In(BEAT_BITS), "ring_end": In(BEAT_BITS + 1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        given, turned = (Signal(self._shape, name=name, reset_less=True) for name in ("given", "turned"))
        given_valid, turned_valid, free = Signal(), Signal(), Signal()
        m.d.comb += [
            free.eq(~turned_valid | self.source.ready),
            self.sink.ready.eq(~given_valid | free),
            self.source.valid.eq(turned_valid),
            self.source.payload.eq(turned.run),
            self.source.payload.beat.eq(based(turned.place, turned.odd, self.ring_base, self.ring_end)),
        ]
        with m.If(self.sink.ready):
            m.d.sync += [given_valid.eq(self.sink.valid), given.eq(self.sink.payload)]
        with m.If(free):
            m.d.sync += [turned_valid.eq(given_valid), turned.eq(given)]
            m.d.sync += turned.place.eq(inside_ring(given.place, given.odd, self.ring_beats))
        return m


def inside_ring(place: Value, odd: Value, ring_beats: Value) -> Value:
    """Wraps `place`, counted in beats from the ring's base, at the end of the ring; in an odd round it stays as it is.

    In an odd round the runs lie in the scratch half, which does not wrap.
    """
    return Mux(~odd & (place >= ring_beats), place - ring_beats, place)


def based(place: Value, odd: Value, ring_base: Value, ring_end: Value) -> Value:
    """The beat in memory that belongs to `place`: in the ring or, in an odd round, in the scratch half behind it."""
    return (Mux(odd, ring_end, ring_base) + place)[:BEAT_BITS]


class _Round:
    """The part that is being merged.

    `begin`, `end` and `runs` describe the runs of this round that are left; `longer_begin`, `longer_end` and `longer` describe
    the merged runs, which the next round takes. All places are in beats from the start of the part.
    """

    def __init__(self, config: AcceleratorConfig):
        self.part = Signal(part_layout(config))
        self.begin, self.end, self.longer_begin, self.longer_end = (
            Signal(BEAT_BITS, name=name) for name in ("begin", "end", "longer_begin", "longer_end"))
        self.runs, self.longer = (Signal(run_bits(config), name=name) for name in ("runs", "longer"))
        self.length, self.longer_length = (Signal(BEAT_BITS, name=name) for name in ("length", "longer_length"))
        self.odd = Signal()  # this round's runs lie in the scratch half
        self._first, self._shift = run_beats(config), config.merge_ways.bit_length() - 1

    def start(self, part: data.View) -> list[Any]:
        """The assignments that begin a part's first round."""
        return [
            self.part.eq(part), self.begin.eq(0), self.end.eq(part.beats), self.runs.eq(part.runs), self.longer_begin.eq(0),
            self.longer_end.eq(0), self.longer.eq(0), self.odd.eq(0), self.length.eq(self._first),
            self.longer_length.eq(self._first << self._shift)]

    def turn(self) -> list[Any]:
        """The assignments that begin the next round."""
        return [
            self.begin.eq(0), self.end.eq(self.longer_end), self.runs.eq(self.longer), self.longer_end.eq(0), self.longer.eq(0),
            self.odd.eq(~self.odd), self.length.eq(self.longer_length),
            self.longer_length.eq(self.longer_length << self._shift)]


class MergePlan(wiring.Component):
    """Turns parts into merges, in order.

    Ports:
        parts: the parts to merge; all of a part is in memory when it is offered.
        runs: to the reader: for every way of a merge a run, or a blank where the merge has fewer runs.
        merges: to the writer and the output: where the result of the merge goes.
        written: strobe; a merge that went back to memory is completely there.
        ring_base, ring_beats, ring_end: first beat, size and end of the ring; the scratch half of the same size follows it.

    Throughput: two cycles for each way plus four for each merge; the runs of the next merge are handed out while the
    intersections of this one leave. Latency: a run is offered two cycles after the GIVE state that hands it on::

        cycle     0      1      2      3      4      5      6      7      8      9
        state     COUNT  SIZE   PLACE  MERGE  PICK   GIVE   PICK   GIVE   PICK   GIVE
        merges                         <goal>
        runs                                                       <0>           <1>
    """

    def __init__(self, config: AcceleratorConfig):
        self._config = config
        super().__init__({
            "parts": In(stream.Signature(part_layout(config))),
            "runs": Out(stream.Signature(way_run(config))),
            "merges": Out(stream.Signature(merge_layout(config))),
            "written": In(1),
            "ring_base": In(BEAT_BITS),
            "ring_beats": In(BEAT_BITS),
            "ring_end": In(BEAT_BITS + 1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.place = place = _Place(self._config)
        wiring.connect(m, place.source, wiring.flipped(self.runs))
        m.d.comb += [getattr(place, name).eq(getattr(self, name)) for name in ("ring_base", "ring_beats", "ring_end")]
        s, ways = _Round(self._config), self._config.merge_ways
        out, left, way = Signal(), Signal(range(ways + 1)), Signal(range(ways))  # all three belong to the current merge
        longer = Signal()  # the next run to pick is a longer one
        with m.FSM():
            with m.State("PART"):
                m.d.comb += self.parts.ready.eq(1)
                m.d.sync += s.start(self.parts.payload)
                with m.If(self.parts.valid):
                    m.next = "COUNT"
            self._merge(m, s, out, longer, left)
            with m.State("PICK"):
                picked = self._pick(m, s, longer)
                m.next = "GIVE"
            with m.State("GIVE"):
                m.d.comb += place.sink.valid.eq(1)
                following = self._give(m, s.part, picked, way, left, place.sink.payload)
                with m.If(place.sink.ready):
                    with m.If(left != 0):
                        m.d.sync += left.eq(left - 1)
                        with m.If(picked["longer"]):
                            m.d.sync += [s.longer_begin.eq(following), s.longer.eq(s.longer - 1), longer.eq(s.longer != 1)]
                        with m.Else():
                            m.d.sync += [s.begin.eq(following), s.runs.eq(s.runs - 1)]
                            # a run that is merged back has the same place in one half as its sources in the other
                            with m.If(~out):
                                m.d.sync += s.longer_end.eq(following)
                    m.d.sync += way.eq(way + 1)  # wraps to 0 after the last way
                    with m.If(way != ways - 1):
                        m.next = "PICK"
                    with m.Elif(out):
                        m.next = "PART"
                    with m.Else():
                        m.next = "COUNT"
        return m

    def _merge(self, m: Module, s: _Round, out: Signal, longer: Signal, left: Signal) -> None:
        """Adds the states that decide how many runs the next merge takes and where its result goes."""
        ways, merge, goal = self._config.merge_ways, self.merges.payload, Signal(BEAT_BITS + 1)
        total, most, few = Signal(run_bits(self._config) + 1), Signal.like(left), Signal.like(left)
        pending = Signal(4)  # merges whose result is not completely in memory yet
        m.d.sync += pending.eq(pending + (self.merges.valid & self.merges.ready & merge.back) - self.written)
        with m.State("COUNT"):
            m.d.sync += [total.eq(s.runs + s.longer), goal.eq(s.longer_end + Mux(s.odd, s.part.offset, 0))]
            with m.If(s.runs != 0):
                m.next = "SIZE"
            with m.Elif(pending == 0):
                m.d.sync += s.turn()
        with m.State("SIZE"):
            m.d.sync += [
                out.eq(total <= ways),
                most.eq(Mux(total < 2 * ways - 1, total - (ways - 1), ways)),
                few.eq(_least(s.runs, ways)),
                goal.eq(inside_ring(goal, ~s.odd, self.ring_beats)),
            ]
            m.next = "PLACE"
        with m.State("PLACE"):
            m.d.sync += [
                left.eq(Mux(out, total, _least(most, few))), goal.eq(based(goal, ~s.odd, self.ring_base, self.ring_end))]
            m.next = "MERGE"
        with m.State("MERGE"):
            m.d.comb += [
                merge.back.eq(~out), merge.beat.eq(goal), merge.last.eq(s.part.last), merge.runs.eq(s.part.runs),
                self.merges.valid.eq(Mux(out, pending == 0, pending != 15)),
            ]
            with m.If(self.merges.valid & self.merges.ready):
                m.d.sync += [s.longer.eq(s.longer + ~out), longer.eq(out & (s.longer != 0))]
                m.next = "PICK"

    def _pick(self, m: Module, s: _Round, longer: Signal) -> dict[str, Signal]:
        """Registers the next way's run. An output merge takes the longer runs first, then this round's, then blanks.

        Returns the registers by name. `place` is where the run lies in the scratch half, or in the ring as if the ring did not
        wrap; `rest` is the number of beats from there to the end of the last run, `length` the length of a run; `end` is where
        the run ends if it is the last one, `after` where it ends otherwise; `longer` and `odd` say which kind of run it is.
        """
        picked = {name: Signal(BEAT_BITS, name=f"picked_{name}") for name in ("rest", "length", "after", "end")}
        picked |= {"place": Signal(BEAT_BITS + 1, name="picked_place")}
        picked |= {name: Signal(name=f"picked_{name}") for name in ("longer", "odd")}
        begin, end, length = (
            Mux(longer, *pair) for pair in
            ((s.longer_begin, s.begin), (s.longer_end, s.end), (s.longer_length, s.length)))
        m.d.sync += [
            picked["place"].eq(begin + Mux(s.odd ^ longer, 0, s.part.offset)),
            picked["rest"].eq(end - begin),
            picked["length"].eq(length),
            picked["after"].eq(begin + length),
            picked["end"].eq(end),
            picked["longer"].eq(longer),
            picked["odd"].eq(s.odd ^ longer),
        ]
        return picked

    def _give(
        self, m: Module, part: data.View, picked: dict[str, Signal], way: Signal, left: Signal, given: data.View,
    ) -> Value:
        """Hands the picked run to its way; returns where the run ends."""
        cut = Signal()
        m.d.comb += [
            cut.eq(picked["rest"] <= picked["length"]),
            given.place.eq(picked["place"]),
            given.odd.eq(picked["odd"]),
            given.run.way.eq(way),
            given.run.beats.eq(Mux(left == 0, 0, Mux(cut, picked["rest"], picked["length"]))),
            given.run.tail.eq(Mux(cut & ~picked["longer"], part.tail, BEAT_ENTRIES - 1)),
        ]
        return Mux(cut, picked["end"], picked["after"])


def _least(a: Value, b: Value | int) -> Value:
    return Mux(a < b, a, b)
