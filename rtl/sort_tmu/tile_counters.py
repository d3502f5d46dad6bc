"""Stage one of the tile merge unit: counts the intersections of each tile.

One memory holds all counters. An intersection reads its tile's counter in one cycle, increments it in the next, and writes it
back in the third, because the memory's output, an incrementer and the memory's input do not fit into one cycle. If one of the
next two intersections is in the same tile, the value it reads is old, and it takes the sum from a register instead. A full
counter is written back as it is. The sums over the frame follow two cycles behind the incrementer::

    cycle        0      1      2      3      4      5
    hits     < tile 7 >< tile 7 >< tile 7 >
    read               <  4   ><  4   ><  4   >     the memory's output; used only by the first of them
    sum                <  5   ><  6   ><  7   >
    written                    <  5   ><  6   ><  7   >
    total       <  4                 ><  5   ><  6   ><  7   >

When all intersections of the frame are counted, the counters are swept in tile order, one per cycle, and each is cleared right
after it is read. The next frame finds zeros, so no separate pass of clearing is needed between frames. There is only one
memory. A second one would let the next frame be counted during the sweep, but it would double the largest memory of this unit
and save at most one cycle per tile, where counting takes hundreds of cycles per tile. Generation bits would not help: the old
counts are still needed during the sweep, and the bits would have to be cleared before their values repeat. A pass of clearing
runs only after a reset, because a reset may interrupt a frame and the memory may hold anything.
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, frame_lists, intersection_tile, list_index


def tile_count_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The counter of one tile as the sweep delivers it, and whether the tile is the last of its row and of the frame."""
    return data.StructLayout({"tile": shape(list_index(config)), "count": COUNT_BITS, "row_ends": 1, "frame_ends": 1})


def total_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of intersections of a frame."""
    return COUNT_BITS + frame_lists(config).bit_length()


class _Late(NamedTuple):
    """A count on its way into the memory."""

    valid: Signal
    payload: data.View


class TileCounters(wiring.Component):
    """Counts the intersections of each tile of a frame.

    Parameters:
        config: the machine; only `row_width` is used, or with lists by super-tile `list_heads`.
        count_bits: bits of a counter.

    Ports:
        hits: IntersectionTile items of a frame, one per intersection in any order, then one with `end`.
        tiles_x, tile_count: tiles of a row and of the frame, 1 or more; must be stable from the first hit to the last count.
            The last row may be shorter.
        begin_sweep: starts the sweep once the frame has ended; must be high for at least one cycle while `settled` is.
        settled: the frame has ended, the sums below are final, and the sweep waits for `begin_sweep`.
        counts: the counter of every tile, in tile order.
        total: sum of the frame's counters.
        filled: number of tiles with at least one intersection.
        saturated: an intersection met a full counter and was not counted.
        outside: an intersection's tile is not in the frame; it was not counted.
        busy: a frame has begun and its last count has not been taken, or the memory is being cleared.

    `total`, `filled`, `saturated` and `outside` keep their values until the first item of the next frame.

    Storage: one counter for each tile of the largest frame; 14,400 x 24 bits for PAPER. Throughput: one intersection per cycle,
    whatever the tiles; one count per cycle. Clearing after a reset takes one cycle per counter.
    """

    def __init__(self, config: AcceleratorConfig, *, count_bits: int = COUNT_BITS):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(count_bits, int) or isinstance(count_bits, bool):
            raise TypeError(f"count_bits must be an integer, not {count_bits!r}")
        if not 1 <= count_bits <= COUNT_BITS:
            raise ValueError(f"count_bits must be in 1..{COUNT_BITS}, not {count_bits!r}")
        self.config, self.count_bits = config, count_bits
        tiles = frame_lists(config)
        super().__init__({
            "hits": In(stream.Signature(layout(intersection_tile(config)))),
            "tiles_x": In(range(tiles + 1)),
            "tile_count": In(range(tiles + 1)),
            "begin_sweep": In(1),
            "settled": Out(1),
            "counts": Out(stream.Signature(tile_count_layout(config))),
            "total": Out(total_bits(config)),
            "filled": Out(range(tiles + 1)),
            "saturated": Out(1),
            "outside": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        depth = frame_lists(self.config)
        m.submodules.counters = counters = memory.Memory(shape=self.count_bits, depth=depth, init=[])
        write, read = counters.write_port(), counters.read_port()
        clearing, counted, late = Signal(range(depth)), self._sum(m), self._late()
        m.d.sync += late.valid.eq(0)
        m.d.comb += [write.en.eq(late.valid), write.addr.eq(late.payload.tile), write.data.eq(late.payload.count)]
        with m.FSM():
            with m.State("CLEAR"):
                m.d.comb += [self.busy.eq(1), write.en.eq(1), write.addr.eq(clearing), write.data.eq(0)]
                m.d.sync += clearing.eq(clearing + 1)
                with m.If(clearing == depth - 1):
                    m.next = "COUNT"
            with m.State("COUNT"):
                with m.If(self._count(m, read, counted, late)):
                    m.next = "SETTLING"
            with m.State("SETTLING"):
                m.d.comb += self.busy.eq(1)
                m.next = "SETTLED"
            with m.State("SETTLED"):
                m.d.comb += [self.busy.eq(1), self.settled.eq(1)]
                with m.If(self.begin_sweep):
                    m.next = "SWEEP"
            with m.State("SWEEP"):
                m.d.comb += self.busy.eq(1)
                with m.If(self._sweep(m, write, read)):
                    m.next = "COUNT"
        return m

    def _late(self) -> _Late:
        """The count that is written back in this cycle."""
        written = data.StructLayout({"tile": shape(list_index(self.config)), "count": self.count_bits})
        return _Late(Signal(name="late"), Signal(written, name="written", reset_less=True))

    def _sum(self, m: Module) -> data.View:
        """Adds up the frame's sums from the one-bit events returned, which are registered: the memory leaves little time."""
        kinds = ("begins", "more", "first", "lost", "astray")
        counted = Signal(data.StructLayout(dict.fromkeys(kinds, 1)))
        held = Signal.like(counted)
        m.d.sync += held.eq(counted)
        with m.If(counted.begins):
            m.d.sync += [self.total.eq(0), self.filled.eq(0), self.saturated.eq(0), self.outside.eq(0)]
        with m.Else():
            m.d.sync += [
                self.total.eq(self.total + held.more),
                self.filled.eq(self.filled + held.first),
                self.saturated.eq(self.saturated | held.lost),
                self.outside.eq(self.outside | held.astray),
            ]
        return counted

    def _count(
        self, m: Module, read: wiring.PureInterface, counted: data.View, late: _Late,
    ) -> Value:
        """Counts one intersection per cycle; returns whether the frame ends. The last one is written at the latest in the cycle
        after `end`."""
        hit, begun = self.hits.payload, Signal()
        taken = self.hits.valid
        counts, within = taken & ~hit.end, hit.tile < self.tile_count
        update, tile = Signal(), Signal(len(hit.tile), reset_less=True)
        known, sure = Signal(), Signal(self.count_bits, reset_less=True)  # the count of `tile`, if the memory lacks it
        m.d.comb += [self.busy.eq(begun), self.hits.ready.eq(1), read.en.eq(counts & within), read.addr.eq(hit.tile)]
        m.d.sync += [update.eq(counts & within), tile.eq(hit.tile)]

        # `after` is count + 1 without a carry chain, because the read of the memory leaves little time in the cycle.
        count, after = Signal(self.count_bits), Signal(self.count_bits)
        full = count.all()
        m.d.comb += [
            count.eq(Mux(known, sure, read.data)),
            after.eq(Cat(~count[0], *(bit ^ count[:place].all() for place, bit in enumerate(count) if place))
                     | full.replicate(self.count_bits)),
            counted.begins.eq(taken & ~begun),
            counted.more.eq(update & ~full),
            counted.first.eq(update & (count == 0)),
            counted.lost.eq(update & full),
            counted.astray.eq(counts & ~within),
        ]
        again = update & (tile == hit.tile)
        m.d.sync += [late.valid.eq(update), late.payload.tile.eq(tile), late.payload.count.eq(after)]
        m.d.sync += [sure.eq(Mux(again, after, late.payload.count)),
                     known.eq(again | late.valid & (late.payload.tile == hit.tile))]
        with m.If(taken):
            m.d.sync += begun.eq(~hit.end)
        return taken & hit.end

    def _sweep(self, m: Module, write: wiring.PureInterface, read: wiring.PureInterface) -> Value:
        """Delivers one count per cycle and clears it in the cycle after its read; returns whether the last one is taken."""
        out = self.counts.payload
        tile, column = Signal.like(out.tile, reset_less=False), Signal.like(self.tiles_x)
        # A counter is left to read; the counter of `out` was read in the last cycle
        fetching, fetched = Signal(init=1), Signal()
        frame_ends = tile == self.tile_count - 1
        row_ends = (column == self.tiles_x - 1) | frame_ends
        moves = ~self.counts.valid | self.counts.ready
        m.d.comb += [
            read.en.eq(moves & fetching),
            read.addr.eq(tile),
            out.count.eq(read.data),
            write.en.eq(fetched),
            write.addr.eq(out.tile),
            write.data.eq(0),
        ]
        m.d.sync += fetched.eq(moves & fetching)
        with m.If(moves):
            m.d.sync += self.counts.valid.eq(fetching)
            with m.If(fetching):
                m.d.sync += [out.tile.eq(tile), out.row_ends.eq(row_ends), out.frame_ends.eq(frame_ends)]
                m.d.sync += [tile.eq(tile + 1), column.eq(Mux(row_ends, 0, column + 1)), fetching.eq(~frame_ends)]
        done = self.counts.valid & self.counts.ready & out.frame_ends
        with m.If(done):
            m.d.sync += [tile.eq(0), fetching.eq(1)]
        return done
