r"""Which runs are merged when: the schedule of the merge tree.

A part is what lies in memory as sorted runs, one behind the other, all but the last of the same length. While a part has more
runs than the tree has ways, the oldest min(ways, runs - ways + 1) of them become one longer run; then all that are left
are merged on the way out. Longer runs are `ways` times as long, but for the last, so that addresses need no table::

    ways 4, 9 runs       0 1 2 3   4 5 6   7 8           in the ring
                         \_____/   \___/   |  |
                           0..3     4..6   |  |           in the scratch half
                             \________\___|__/
                                         out              2 of the 9 runs were not moved

Once every run of a length has been merged, the longer ones are the runs of a next round, which writes to where the runs
before them were: rounds alternate between the part's place in the ring and the scratch half.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.run_reader import way_run
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_ENTRIES


def part_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Runs of a group in memory.

    Its first beat in the ring, its runs and its beats; entries of its last beat less 1; whether the group ends with it.
    """
    return data.StructLayout({
        "offset": BEAT_BITS, "runs": run_bits(config), "beats": BEAT_BITS, "tail": range(BEAT_ENTRIES), "last": 1})


def merge_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Where a merge goes: back to memory, from `beat` on, or out, as the end of its group or not; runs that it frees then."""
    return data.StructLayout({"back": 1, "beat": BEAT_BITS, "last": 1, "runs": run_bits(config)})


def run_beats(config: AcceleratorConfig) -> int:
    """Beats of a sorted chunk."""
    return config.sort_chunk // BEAT_ENTRIES


def run_bits(config: AcceleratorConfig) -> int:
    """Bits of a number of runs."""
    return BEAT_BITS - (run_beats(config).bit_length() - 1)


class _Place(wiring.Component):
    """Where runs lie in memory, of where they lie in the part: two registers."""

    def __init__(self, config: AcceleratorConfig):
        self._shape = data.StructLayout({"run": way_run(config), "place": BEAT_BITS + 1, "odd": 1})
        super().__init__({
            "sink": In(stream.Signature(self._shape)), "source": Out(stream.Signature(way_run(config))),
            "ring_base": In(BEAT_BITS), "ring_beats": In(BEAT_BITS), "ring_end": In(BEAT_BITS + 1)})

    def elaborate(self, platform) -> Module:
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
    """A place counted from the ring's base, in the ring, which ends where it begins; of an odd round, in the scratch half."""
    return Mux(~odd & (place >= ring_beats), place - ring_beats, place)


def based(place: Value, odd: Value, ring_base: Value, ring_end: Value) -> Value:
    """The beat in memory of a place in the ring or, of an odd round, in the scratch half behind it."""
    return (Mux(odd, ring_end, ring_base) + place)[:BEAT_BITS]


class _Round:
    """A part while it is merged: runs of this round's length that are left, and of the next: begin and end, how many."""

    def __init__(self, config: AcceleratorConfig):
        self.part = Signal(part_layout(config))
        self.begin, self.end, self.longer_begin, self.longer_end = (
            Signal(BEAT_BITS, name=name) for name in ("begin", "end", "longer_begin", "longer_end"))
        self.runs, self.longer = (Signal(run_bits(config), name=name) for name in ("runs", "longer"))
        self.length, self.longer_length = (Signal(BEAT_BITS, name=name) for name in ("length", "longer_length"))
        self.odd = Signal()  # this round's runs lie in the scratch half
        self._first, self._shift = run_beats(config), config.merge_ways.bit_length() - 1

    def start(self, part: data.View) -> list:
        """The first round."""
        return [
            self.part.eq(part), self.begin.eq(0), self.end.eq(part.beats), self.runs.eq(part.runs), self.longer_begin.eq(0),
            self.longer_end.eq(0), self.longer.eq(0), self.odd.eq(0), self.length.eq(self._first),
            self.longer_length.eq(self._first << self._shift)]

    def turn(self) -> list:
        """The next one."""
        return [
            self.begin.eq(0), self.end.eq(self.longer_end), self.runs.eq(self.longer), self.longer_end.eq(0), self.longer.eq(0),
            self.odd.eq(~self.odd), self.length.eq(self.longer_length),
            self.longer_length.eq(self.longer_length << self._shift)]


class MergePlan(wiring.Component):
    """Parts to merges, in order.

    Ports:
        parts: what to merge; all of it is in memory.
        runs: to the reader: a run or a blank for every way.
        merges: to the writer and the output: where the result goes.
        written: strobe, a merge that went back is in memory.
        ring_base, ring_beats, ring_end: the ring's place, its size, its end; the scratch half of the same size follows.

    Two cycles a way, and four a merge; the next merge's runs are handed out while this one's entries leave. A run is offered
    three cycles after it was picked::

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

    def elaborate(self, platform) -> Module:
        m = Module()
        m.submodules.place = place = _Place(self._config)
        wiring.connect(m, place.source, wiring.flipped(self.runs))
        m.d.comb += [getattr(place, name).eq(getattr(self, name)) for name in ("ring_base", "ring_beats", "ring_end")]
        s, ways = _Round(self._config), self._config.merge_ways
        out, left, way = Signal(), Signal(range(ways + 1)), Signal(range(ways))  # of the merge
        longer = Signal()  # a longer run is next
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
                            with m.If(~out):  # what is merged back lies in one half where it lay in the other
                                m.d.sync += s.longer_end.eq(following)
                    m.d.sync += way.eq(way + 1)  # behind the last one 0 again
                    with m.If(way != ways - 1):
                        m.next = "PICK"
                    with m.Elif(out):
                        m.next = "PART"
                    with m.Else():
                        m.next = "COUNT"
        return m

    def _merge(self, m: Module, s: _Round, out: Signal, longer: Signal, left: Signal) -> None:
        """The states that say what is merged, how many runs of it, and where it goes."""
        ways, merge, goal = self._config.merge_ways, self.merges.payload, Signal(BEAT_BITS + 1)
        total, most, few = Signal(run_bits(self._config) + 1), Signal.like(left), Signal.like(left)
        pending = Signal(4)  # merges not yet in memory
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
        """The next way's run, in registers: on the way out the longer ones first, then this round's, then blanks.

        Its place, in the scratch half or, as if that went on, in the ring; beats from there to the last run's end; how long
        runs are; where it ends if nothing cuts it, and where if something does.
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
        """What has been picked, to its way; returns where it ends."""
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
