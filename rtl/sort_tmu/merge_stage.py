"""One stage of the merge sorter: neighbouring sorted runs of up to N entries to sorted runs of up to 2 N.

Runs arrive in turn for side 0 and side 1, whatever chunk they belong to, and wait there in order. A pair is a run and the
next one of the same chunk; a chunk's odd last run goes through alone, and so does the only run of a short chunk. The second
run's entries need not be there when merging begins: from its first entry on the smaller head leaves, one a cycle, while
entries keep arriving::

    cycle          0    1    2    3    4    5    6    7    8    9        N = 2, one chunk 5 8 | 3 9 | 1 4
    sink         < 5 >< 8 >< 3 >< 9 >< 1 >< 4 >
    side           0    0    1    1    0    0
    source                       < 3 >< 5 >< 8 >< 9 >< 1 >< 4 >         3 leaves straight from the input; 1 4 alone

As one entry leaves while one arrives, no more than N + 1 ever wait on a side, and neither port pauses between pairs or chunks.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, enum, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.order import less


class Kind(enum.Enum, shape=unsigned(2)):
    """What a run is in its chunk; each of its items says it."""

    FIRST = 0
    """First of a pair, if a second follows."""
    SECOND = 1
    """Second of a pair."""
    WHOLE = 2
    """Known to be all of its chunk: need not wait for what follows."""
    EMPTY = 3
    """An empty chunk: one item, no entry."""


def item_layout(width: int) -> data.StructLayout:
    """What travels between stages: the entry as one number, the end of a chunk, the kind of the run."""
    return data.StructLayout({"word": width, "last": 1, "kind": Kind})


class _Side:
    """Runs that wait: the oldest item in `front` or, in the cycle after it was fetched, at the memory's output."""

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
        """The head is the last of its run."""
        return (self.place == self.run - 1) | self.head.last

    def elaborate(self, m: Module, item: data.View, fetched_item: data.View) -> None:
        """Adds the logic."""
        some, one = self.level != 0, self.level == 1
        m.d.comb += [
            self.there.eq(some | self.arrives),
            self.head.eq(Mux(some, Mux(self.fetched, fetched_item, self.front), item)),
        ]
        to_front = self.push & (~some | one & self.pop)  # of what leaves as it comes, nobody looks at the copy
        to_memory = self.push & some & ~(one & self.pop)
        fetch = self.pop & (self.level > 1)
        m.d.sync += self.fetched.eq(fetch)
        with m.If(self.push & ~self.pop):  # both sums are there before it is known who pops: heads are compared first
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
    """Sorted runs of `run` entries, or fewer at the end of a chunk, to sorted runs of twice as many.

    Parameters:
        width: bits of an entry; entries are ordered as unsigned numbers. All of an entry is its key: equal ones are the same.
        run: entries of a run at the input; a power of two.

    Ports:
        sink: runs, chunk after chunk.
        source: the runs of every chunk merged in pairs.

    Storage: 2 run items of width + 3 bits in one memory, where what is read and written at one address in a cycle does not
    count, and two items in registers. Throughput: one item a cycle. Latency: one cycle for the only run of a chunk, where that
    is known from its first entry on; otherwise an item waits for the first entry of the second run or for the end of the chunk.
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

    def elaborate(self, platform) -> Module:
        m = Module()
        sides = [_Side(number, self.layout, self.run) for number in range(2)]
        entering, leaving, moves = Signal(), Signal(), Signal()  # sides; an item leaves
        self._enter(m, sides, entering)
        self._store(m, sides, entering, leaving, moves)
        self._leave(m, sides, leaving, moves)
        return m

    def _enter(self, m: Module, sides: list[_Side], side: Signal) -> None:
        """Runs to their sides, in turn."""
        item, place = self.sink.payload, Signal(range(self.run))
        m.d.comb += self.sink.ready.eq(Mux(side, *(s.level != self.run + 1 for s in reversed(sides))))
        for s in sides:
            m.d.comb += [s.arrives.eq(self.sink.valid & (side == s.number)), s.push.eq(s.arrives & self.sink.ready)]
        with m.If(self.sink.valid & self.sink.ready):
            run_ends = (place == self.run - 1) | item.last
            m.d.sync += [place.eq(Mux(run_ends, 0, place + 1)), side.eq(side ^ run_ends)]

    def _store(self, m: Module, sides: list[_Side], entering: Signal, leaving: Signal, moves: Signal) -> None:
        """The memory of both sides: at most one of them is written in a cycle, and at most one read.

        Which side an item leaves is known late. So addresses follow the sides alone, what goes past an empty memory into
        `front` is written, too, where the next item will be, and something is read wherever an item leaves: only what was
        `fetched` counts.
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
        """The smaller head of a pair, or the next item of a run that has no second."""
        older = Signal()  # side of the pair's first run
        begun, gone, single, ended = Signal(), Signal(2), Signal(), Signal()  # of the pair that is being merged
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
        """Of a run that has not begun to leave: no second one follows.

        Its own kind says so, or the run after it, which is always on the other side, is not its second; or there is none yet
        and the newest item of all, which is then this run's, ends a chunk.
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
        """The output register. The pairs of a chunk are in turn the first and second run of the next stage's."""
        initial, odd = Signal(init=1), Signal()
        out = self.source.payload
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
