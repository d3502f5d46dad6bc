"""A tree of two-way comparators that merges the sorted runs at its leaves into one sorted run, one intersection per cycle.

Every leaf delivers one run for each merge, in the order of the merges; a leaf that has no run for a merge delivers a blank. The
tree tells merges apart only by the ends of runs, so that merges follow each other without a pause::

    cycle         0    1    2    3    4    5    6                one node
    sink 0     < 2 >< 7.>< 1 ....                                a dot marks the last item of a run
    sink 1     < 5 >< 5 >< 5 >< 9.><  blank  >< 3 ....
    source          < 2 >< 5 >< 7 >< 9.>     < 1 >               the blank takes a cycle
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.sort_tmu.order import less
from rtl.stream import payload_register


def run_layout(width: int) -> data.StructLayout:
    """One item of a run: the intersection as one number, the end of the run, or a blank, which is an empty run of one item."""
    return data.StructLayout({"word": width, "last": 1, "blank": 1})


class MergeNode(wiring.Component):
    """Merges two runs into one.

    Parameters:
        width: bits of an intersection's record; records are compared as unsigned numbers.

    Ports:
        sinks: runs; the node takes one run from each sink for every run at the source.
        source: merged runs; a blank if both runs are blank.

    Storage: one item. Throughput: one intersection per cycle, and one more cycle for a merge in which just one of the two runs
    is blank. Latency: 1 cycle.
    """

    def __init__(self, width: int):
        self._layout = run_layout(width)
        items = stream.Signature(self._layout)
        super().__init__({"sinks": In(items).array(2), "source": Out(items)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # gone[i]: the run of side i has ended, the other has not
        heads, gone = [sink.payload for sink in self.sinks], Signal(2)
        free, moves, side, merged = Signal(), Signal(), Signal(), payload_register(m, self.source)
        here = [gone[i] | sink.valid & ~sink.payload.blank for i, sink in enumerate(self.sinks)]
        head = data.View(self._layout, Mux(side, heads[1], heads[0]))
        # only two blanks set both bits; otherwise the merged run ends with the run that ends second
        blank, ends = gone.all(), Signal()
        m.d.comb += [
            free.eq(~self.source.valid | self.source.ready),
            moves.eq(here[0] & here[1] & free),
            side.eq(gone[0] | ~gone[1] & less(heads[1].word, heads[0].word)),
            ends.eq(blank | head.last & gone.any()),
        ]
        for i, sink in enumerate(self.sinks):
            skips = sink.valid & sink.payload.blank & ~gone[i]
            m.d.comb += sink.ready.eq(skips | moves & ~blank & (side == i))
            with m.If(moves & ends):
                m.d.sync += gone[i].eq(0)
            with m.Elif(skips | moves & head.last & (side == i)):
                m.d.sync += gone[i].eq(1)
        with m.If(free):
            m.d.sync += self.source.valid.eq(moves)
        with m.If(moves):
            m.d.sync += [merged.word.eq(head.word), merged.last.eq(ends), merged.blank.eq(blank)]
        return m


class MergeTree(wiring.Component):
    """Merges one run from each of `ways` leaves into one run.

    Parameters:
        width: bits of an intersection's record.
        ways: number of leaves; a power of two, at least 2.

    Ports:
        sinks: for every merge a run, or a blank, from each leaf.
        source: merged runs.

    Storage: ways - 1 items. Throughput: one intersection per cycle. Latency: log2(ways) cycles, and up to as many again at the
    start of a merge in which leaves are blank.
    """

    def __init__(self, width: int, ways: int):
        if not isinstance(ways, int) or isinstance(ways, bool):
            raise TypeError(f"ways must be an integer, not {ways!r}")
        if ways < 2 or ways & (ways - 1):
            raise ValueError(f"ways must be a power of two from 2 on, not {ways!r}")
        self._width, self._ways = width, ways
        items = stream.Signature(run_layout(width))
        super().__init__({"sinks": In(items).array(ways), "source": Out(items)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        runs = [wiring.flipped(sink) for sink in self.sinks]
        while len(runs) > 1:
            merged = []
            for i in range(0, len(runs), 2):
                m.submodules[f"node_{len(runs)}_{i // 2}"] = node = MergeNode(self._width)
                wiring.connect(m, runs[i], node.sinks[0])
                wiring.connect(m, runs[i + 1], node.sinks[1])
                merged.append(node.source)
            runs = merged
        wiring.connect(m, runs[0], wiring.flipped(self.source))
        return m
