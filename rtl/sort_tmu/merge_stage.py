"""One stage of the merge sorter: merges pairs of neighbouring sorted runs of up to N items into sorted runs of up to 2 N.

Runs are stored alternately on side 0 and side 1, whatever chunk they belong to, and wait there in order. A pair is a run and
the next run of the same chunk. The last run of a chunk with an odd number of runs passes alone, and so does the only run of a
short chunk. Merging begins with the first item of the second run: from then on the smaller of the two heads leaves in every
cycle, while further items arrive::

    cycle          0    1    2    3    4    5    6    7    8    9        N = 2, one chunk 5 8 | 3 9 | 1 4
    sink         < 5 >< 8 >< 3 >< 9 >< 1 >< 4 >
    side           0    0    1    1    0    0
    source                       < 3 >< 5 >< 8 >< 9 >< 1 >< 4 >         3 leaves straight from the input; 1 4 passes alone

One item leaves for each item that arrives, so at most N + 1 items ever wait on a side, and neither port pauses between pairs or
chunks.
"""

from __future__ import annotations

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, enum, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.order import less
from rtl.stream import payload_register


class Kind(enum.Enum, shape=unsigned(2)):  # type: ignore[call-arg]
    """The role of a run in its chunk; every item of the run carries it."""

    FIRST = 0
    """The run is the first of a pair, if a second one follows."""
    SECOND = 1
    """The run is the second of a pair."""
    WHOLE = 2
    """The run is known to be its whole chunk, so it need not wait for what follows."""
    EMPTY = 3
    """The chunk is empty: a single item without an intersection."""


def item_layout(width: int) -> data.StructLayout:
    """The item between stages: the intersection's record as one number, the end of a chunk, and the kind of the run."""
    return data.StructLayout({"word": width, "last": 1, "kind": Kind})


class _Side:
    """The runs that wait on one side; the oldest item is in `front` or, right after its fetch, at the memory's output."""

    def __init__(self, number: int, layout: data.StructLayout, run: int):
        self.number, self.run = number, run
        self.level = Signal(range(run + 2), name=f"level_{number}")
        self.front = Signal(layout, name=f"front_{number}", reset_less=True)
        self.fetched = Signal(name=f"fetched_{number}")
        self.write, self.read = (Signal(range(run), name=f"{what}_{number}") for what in ("write", "read"))
        self.head, self.there = Signal(layout, name=f"head_{number}"), Signal(name=f"there_{number}")
        self.place = Signal(range(run), name=f"place_{number}")
        self.arrives, self.push, self.pop = (Signal(name=f"{what}_{number}") for what in ("arrives", "push", "pop"))

    @property
    def run_ends(self) -> Value:
        """Whether the head is the last item of its run."""
        return (self.place == self.run - 1) | self.head.last

    def elaborate(self, m: Module, item: data.View, fetched_item: data.View) -> None:
        """Adds the logic of this side to `m`."""
        some, one = self.level != 0, self.level == 1
        # what the memory gives comes late, so it passes one gate only
        heads = ((some & self.fetched, fetched_item), (some & ~self.fetched, self.front), (~some, item))
        m.d.comb += [
            self.there.eq(some | self.arrives),
            Value.cast(self.head).eq(reduce(or_, (
                chosen.replicate(len(Value.cast(value))) & Value.cast(value) for chosen, value in heads))),
        ]
        # An item that leaves in the cycle of its arrival is copied too, but the copy is never used
        to_front = self.push & (~some | one & self.pop)
        to_memory = self.push & some & ~(one & self.pop)
        fetch = self.pop & (self.level > 1)
        m.d.sync += self.fetched.eq(fetch)
        with m.If(self.push & ~self.pop):  # both sums are computed before the comparison of the heads decides which side pops
            m.d.sync += self.level.eq(self.level + 1)
        with m.Elif(self.pop & ~self.push):
            m.d.sync += self.level.eq(self.level - 1)
        with m.If(to_front):
            m.d.sync += self.front.eq(item)
        with m.Elif(self.fetched):
            m.d.sync += self.front.eq(fetched_item)
        with m.If(to_memory):
            m.d.sync += self.write.eq(self.write + 1)
        with m.If(fetch):
            m.d.sync += self.read.eq(self.read + 1)
        with m.If(self.pop):
            m.d.sync += self.place.eq(Mux(self.run_ends, 0, self.place + 1))


class MergeStage(wiring.Component):
    """Merges pairs of sorted runs into runs of twice the length; `run` items each, or fewer at the end of a chunk.

    Parameters:
        width: bits of an intersection's record. Records are compared as unsigned numbers; all of the record is the key, so that
            equal keys are equal records.
        run: items of a run at the input; a power of two.

    Ports:
        sink: runs, chunk after chunk.
        source: the runs of every chunk merged in pairs.

    Storage: 2 run items of width + 3 bits in one memory, whose output may be undefined when one address is read and written in
    the same cycle, and two items in registers. Throughput: one item per cycle. Latency: one cycle for the only run of a chunk
    if its first item already says so; otherwise an item waits for the first item of the second run or for the end of the chunk.
    """

    def __init__(self, width: int, run: int):
        for name, value in (("width", width), ("run", run)):
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{name} must be an integer, not {value!r}")
        if width < 1:
            raise ValueError(f"width must be at least 1, not {width!r}")
        if run < 1 or run & (run - 1):
            raise ValueError(f"run must be a power of two, not {run!r}")
        self.run, self.layout = run, item_layout(width)
        super().__init__({"sink": In(stream.Signature(self.layout)), "source": Out(stream.Signature(self.layout))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sides = [_Side(number, self.layout, self.run) for number in range(2)]
        # `entering` and `leaving` are sides; `moves` says that an item leaves
        entering, leaving, moves = Signal(), Signal(), Signal()
        self._enter(m, sides, entering)
        self._store(m, sides, entering, leaving, moves)
        self._leave(m, sides, leaving, moves)
        return m

    def _enter(self, m: Module, sides: list[_Side], side: Signal) -> None:
        """Stores runs on alternating sides."""
        item, place = self.sink.payload, Signal(range(self.run))
        m.d.comb += self.sink.ready.eq(Mux(side, *(s.level != self.run + 1 for s in reversed(sides))))
        for s in sides:
            m.d.comb += [s.arrives.eq(self.sink.valid & (side == s.number)), s.push.eq(s.arrives & self.sink.ready)]
        with m.If(self.sink.valid & self.sink.ready):
            run_ends = (place == self.run - 1) | item.last
            m.d.sync += [place.eq(Mux(run_ends, 0, place + 1)), side.eq(side ^ run_ends)]

    def _store(self, m: Module, sides: list[_Side], entering: Signal, leaving: Signal, moves: Signal) -> None:
        """Adds the memory that both sides share: in each cycle at most one side is written and at most one is read.

        The side from which an item leaves is on the critical path. The addresses therefore select between the pointers of the
        sides alone, and the enables are generous. An item that bypasses the memory into `front` may also be written, to the
        place that the next item will overwrite. A word may be read that is not needed; only a word marked `fetched` is used.
        """
        m.submodules.words = words = memory.Memory(shape=self.layout, depth=2 * self.run, init=[])
        write, read = words.write_port(), words.read_port()
        for s in sides:
            s.elaborate(m, self.sink.payload, read.data)
        m.d.comb += [
            write.data.eq(self.sink.payload),
            write.en.eq(Cat(s.push & (s.level != 0) for s in sides).any()),
            write.addr.eq(Cat(Mux(entering, sides[1].write, sides[0].write), entering)),
            read.en.eq(moves & Cat(s.level > 1 for s in sides).any()),
            read.addr.eq(Cat(Mux(leaving, sides[1].read, sides[0].read), leaving)),
        ]

    def _leave(self, m: Module, sides: list[_Side], side: Signal, moves: Signal) -> None:
        """Moves the smaller head of a pair, or the next item of a run that has no second, to the output."""
        older = Signal()  # the side of the pair's first run
        begun, gone, single, ended = Signal(), Signal(2), Signal(), Signal()  # state of the pair that is being merged
        heads, there = [s.head for s in sides], Cat(s.there for s in sides)
        alone = Signal()
        m.d.comb += alone.eq(Mux(begun, single, self._alone(m, sides, older)))
        absent = Mux(begun, gone, Cat(alone & older, alone & ~older))
        m.d.comb += side.eq(absent[0] | ~absent[1] & less(heads[1].word, heads[0].word))
        m.d.comb += moves.eq((absent | there).all() & (~self.source.valid | self.source.ready))
        for s in sides:
            m.d.comb += s.pop.eq(moves & (side == s.number))

        head = data.View(self.layout, Mux(side, heads[1], heads[0]))
        run_ends = Mux(side, *(s.run_ends for s in reversed(sides)))
        pair_ends, chunk_ends = run_ends & Mux(side, absent[0], absent[1]), head.last | begun & ended
        with m.If(moves):
            left = absent | Cat(~side & run_ends, side & run_ends)
            m.d.sync += [begun.eq(~pair_ends), gone.eq(left), single.eq(alone), ended.eq(chunk_ends)]
            m.d.sync += older.eq(older ^ (pair_ends & alone))
        self._emit(m, head, moves, pair_ends, pair_ends & chunk_ends, alone)

    def _alone(self, m: Module, sides: list[_Side], older: Signal) -> Value:
        """Whether no second run will follow the pair's first run; valid before that run begins to leave.

        The kind of the run may say so. Otherwise the run after it, which is always on the other side, decides: it may not be a
        second run. If no run has arrived after it, the newest item of all belongs to it, and that item may end a chunk.
        """
        closed = Signal()
        with m.If(self.sink.valid & self.sink.ready):
            m.d.sync += closed.eq(self.sink.payload.last)
        found = []
        for mine, other in (sides, sides[::-1]):
            known = (mine.head.kind == Kind.WHOLE) | (mine.head.kind == Kind.EMPTY)
            follows = Mux(other.there, other.head.kind != Kind.SECOND, closed & (mine.level != 0))
            found.append(known | follows)
        return Mux(older, found[1], found[0])

    def _emit(self, m: Module, head: data.View, moves: Value, pair_ends: Value, last: Value, alone: Value) -> None:
        """Drives the output register. The merged pairs of a chunk alternate as first and second runs of the next stage."""
        initial, odd = Signal(init=1), Signal()
        out = payload_register(m, self.source)
        with m.If(~self.source.valid | self.source.ready):
            m.d.sync += self.source.valid.eq(moves)
        with m.If(moves):
            m.d.sync += [out.word.eq(head.word), out.last.eq(last)]
            with m.If(head.kind == Kind.EMPTY):
                m.d.sync += out.kind.eq(Kind.EMPTY)
            with m.Elif(odd):
                m.d.sync += out.kind.eq(Kind.SECOND)
            with m.Else():
                m.d.sync += out.kind.eq(Mux(initial & alone, Kind.WHOLE, Kind.FIRST))
            with m.If(pair_ends):
                m.d.sync += [initial.eq(last), odd.eq(~last & ~odd)]
