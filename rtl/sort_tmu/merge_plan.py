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

from rtl.sort_tmu.chunk_sorter import chunk_capacity
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
    return chunk_capacity(config) // BEAT_ENTRIES


def run_bits(config: AcceleratorConfig) -> int:
    """Bits of a number of runs."""
    return BEAT_BITS - (run_beats(config).bit_length() - 1)


class MergePlan(wiring.Component):
    """Parts to merges, in order.

    Ports:
        parts: what to merge; all of it is in memory.
        runs: to the reader: a run or a blank for every way.
        merges: to the writer and the output: where the result goes.
        written: strobe, a merge that went back is in memory.
        ring_base, ring_beats: the ring's place; the scratch half of the same size follows.

    Two cycles a way, and a few a merge; the next merge's runs are handed out while this one's entries leave.
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
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        config, ways = self._config, self._config.merge_ways
        shift = ways.bit_length() - 1
        part = Signal(part_layout(config))
        # Runs of this round's length that are left: where they begin and end, how many. Those of the next: the end, how many.
        begin, end, runs, longer_end, longer = (Signal(width, name=name) for name, width in (
            ("begin", BEAT_BITS), ("end", BEAT_BITS), ("runs", run_bits(config)), ("longer_end", BEAT_BITS),
            ("longer", run_bits(config))))
        length, odd, pending = Signal(BEAT_BITS), Signal(), Signal(4)  # a run's; the round; merges not yet in memory
        total, out, size = Signal(run_bits(config) + 1), Signal(), Signal(range(ways + 1))
        surplus = total - ways + 1
        m.d.comb += [
            total.eq(runs + longer),
            out.eq(total <= ways),
            size.eq(Mux(out, total, _least(_least(surplus, ways), runs))),
        ]
        way, left, from_longer = Signal(range(ways)), Signal(range(ways + 1)), Signal()
        longer_begin, going_out = Signal(BEAT_BITS), Signal()
        launched = self.merges.valid & self.merges.ready & self.merges.payload.back
        m.d.sync += pending.eq(pending + launched - self.written)
        merge, run = self.merges.payload, self.runs.payload

        with m.FSM():
            with m.State("PART"):
                m.d.comb += self.parts.ready.eq(1)
                m.d.sync += [
                    part.eq(self.parts.payload), begin.eq(0), end.eq(self.parts.payload.beats),
                    runs.eq(self.parts.payload.runs), longer_end.eq(0), longer.eq(0), longer_begin.eq(0),
                    length.eq(run_beats(config)), odd.eq(0),
                ]
                with m.If(self.parts.valid):
                    m.next = "MERGE"
            with m.State("MERGE"):
                m.d.comb += [
                    merge.back.eq(~out),
                    merge.beat.eq(self._place(part, longer_end, ~odd)),
                    merge.last.eq(part.last),
                    merge.runs.eq(part.runs),
                ]
                m.d.sync += [left.eq(size), going_out.eq(out), way.eq(0)]
                with m.If(runs == 0):
                    with m.If(pending == 0):
                        m.d.sync += [
                            begin.eq(0), end.eq(longer_end), runs.eq(longer), longer_end.eq(0), longer.eq(0),
                            length.eq(length << shift), odd.eq(~odd),
                        ]
                with m.Else():
                    m.d.comb += self.merges.valid.eq(Mux(out, pending == 0, pending != 15))
                    with m.If(self.merges.valid & self.merges.ready):
                        m.d.sync += longer.eq(longer + ~out)
                        m.next = "PICK"
            with m.State("PICK"):
                m.d.comb += from_longer.eq(going_out & (longer != 0))
                picked = self._pick(m, from_longer, {
                    "begin": begin, "end": end, "longer_begin": longer_begin, "longer_end": longer_end, "length": length,
                    "odd": odd}, part, shift)
                m.d.sync += run.way.eq(way)
                m.next = "GIVE"
            with m.State("GIVE"):
                m.d.comb += self.runs.valid.eq(1)
                beats = self._give(m, run, picked, left, part)
                with m.If(self.runs.ready):
                    with m.If(left != 0):
                        m.d.sync += left.eq(left - 1)
                        with m.If(picked["longer"]):
                            m.d.sync += [longer_begin.eq(picked["begin"] + beats), longer.eq(longer - 1)]
                        with m.Else():
                            m.d.sync += [begin.eq(picked["begin"] + beats), runs.eq(runs - 1)]
                            with m.If(~going_out):
                                m.d.sync += longer_end.eq(longer_end + beats)
                    m.d.sync += way.eq(way + 1)
                    with m.If(way != ways - 1):
                        m.next = "PICK"
                    with m.Elif(going_out):
                        m.next = "PART"
                    with m.Else():
                        m.next = "MERGE"
        return m

    def _pick(
        self, m: Module, from_longer: Signal, s: dict[str, Signal], part: data.View, shift: int,
    ) -> dict[str, Signal]:
        """The next way's run, in registers: the longer ones first, then this round's, then blanks.

        Where it begins, in the part and from the ring's base; its beats if nothing cuts it; how long runs are.
        """
        picked = {name: Signal(BEAT_BITS + (name == "inside"), name=f"picked_{name}")
                  for name in ("begin", "inside", "rest", "length")}
        picked |= {name: Signal(name=f"picked_{name}") for name in ("longer", "odd")}
        begin = Mux(from_longer, s["longer_begin"], s["begin"])
        m.d.sync += [
            picked["begin"].eq(begin),
            picked["inside"].eq(part.offset + begin),
            picked["rest"].eq(Mux(from_longer, s["longer_end"], s["end"]) - begin),
            picked["length"].eq(Mux(from_longer, s["length"] << shift, s["length"])),
            picked["longer"].eq(from_longer),
            picked["odd"].eq(s["odd"] ^ from_longer),
        ]
        return picked

    def _give(self, m: Module, run: data.View, picked: dict[str, Signal], left: Signal, part: data.View) -> Signal:
        """What has been picked; returns its beats."""
        beats, rest, length = Signal(BEAT_BITS, name="given_beats"), picked["rest"], picked["length"]
        m.d.comb += [
            beats.eq(Mux(left == 0, 0, _least(rest, length))),
            run.beat.eq(self._from(picked["inside"], picked["begin"], picked["odd"])),
            run.beats.eq(beats),
            run.tail.eq(Mux(~picked["longer"] & (rest <= length), part.tail, BEAT_ENTRIES - 1)),
        ]
        return beats

    def _place(self, part: data.View, offset: Value, odd: Value) -> Value:
        """The beat in memory of a place in the part: in the ring, which ends where it begins, or in the scratch half."""
        return self._from(part.offset + offset, offset, odd)

    def _from(self, inside: Value, offset: Value, odd: Value) -> Value:
        """The same, of a place in the ring, counted from its base."""
        turned = Mux(inside >= self.ring_beats, inside - self.ring_beats, inside)
        return (self.ring_base + Mux(odd, self.ring_beats + offset, turned))[:BEAT_BITS]


def _least(a: Value, b: Value | int) -> Value:
    return Mux(a < b, a, b)
