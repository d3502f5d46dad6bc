"""Stage one of the tile merge unit: how many entries each tile has.

One memory holds all counters. A hit reads its counter and writes it back, incremented, a cycle later; a hit on the same tile in
the very next cycle takes the sum from the register behind the adder, as what it reads is old. A full counter is not
written, so what is read of it is never old. The frame's sums follow two cycles behind the adder::

    cycle        0      1      2      3      4      5
    hits     < tile 7 >< tile 7 >< tile 7 >
    read               <  4   ><  4   ><  5   >     the memory's output; after a write of the same address, not used
    sum                <  5   ><  6   ><  7   >
    total       <  4                 ><  5   ><  6   ><  7   >

When all entries have come the counters are swept in tile order, one a cycle, and each is cleared behind the sweep: the next
frame finds zeros, no pass is spent on clearing, and there is one memory. A second one (or a second half) would let a frame
be counted while the one before is still swept, at twice the largest memory of this unit, for at most a cycle a tile where
counting takes hundreds; generation bits would not, as the old counts are still wanted, and would have to be cleared before
they repeat. Only a reset is followed by a pass of clearing, because it may have cut off a frame, or memory may hold anything.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, frame_tiles, tile_hit, tile_index


def tile_count_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A counter that is swept: its tile, and whether that is the last of its row and of the frame."""
    return data.StructLayout({"tile": shape(tile_index(config)), "count": COUNT_BITS, "row_ends": 1, "frame_ends": 1})


def total_bits(config: AcceleratorConfig) -> int:
    """Bits of the entries of a frame."""
    return COUNT_BITS + frame_tiles(config).bit_length()


class TileCounters(wiring.Component):
    """Entries of each tile of a frame.

    Parameters:
        config: the machine; `row_width` matters here.
        count_bits: bits of a counter.

    Ports:
        hits: TileHit items of a frame, then one with `end`.
        tiles_x, tile_count: tiles of a row and of the frame, 1 or more; stable from the first hit to the last count. The last
            row may be shorter.
        begin_sweep: the counts may come out; waited for when the frame has ended, high for a cycle or more.
        settled: the frame has ended, the sums below are final and the sweep waits.
        counts: every tile's counter, in tile order.
        total: sum of the frame's counters.
        filled: tiles with an entry.
        saturated: an entry met a full counter: it is not counted.
        outside: an entry's tile is not of the frame: it is not counted.
        busy: a frame has begun and its last count has not been taken, or memory is being cleared.

    `total`, `filled`, `saturated` and `outside` stay until the next frame's first item.

    Storage: a counter for every tile of the largest frame; for PAPER 14,400 x 24 bits. Throughput: one hit a cycle whatever the
    tiles; one count a cycle. After a reset one cycle a counter is spent on clearing.
    """

    def __init__(self, config: AcceleratorConfig, *, count_bits: int = COUNT_BITS):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(count_bits, int) or isinstance(count_bits, bool):
            raise TypeError(f"count_bits must be an integer, not {count_bits!r}")
        if not 1 <= count_bits <= COUNT_BITS:
            raise ValueError(f"count_bits must be in 1..{COUNT_BITS}, not {count_bits!r}")
        self.config, self.count_bits = config, count_bits
        tiles = frame_tiles(config)
        super().__init__({
            "hits": In(stream.Signature(layout(tile_hit(config)))),
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

    def elaborate(self, platform) -> Module:
        m = Module()
        depth = frame_tiles(self.config)
        m.submodules.counters = counters = memory.Memory(shape=self.count_bits, depth=depth, init=[])
        write, read = counters.write_port(), counters.read_port()
        clearing, counted = Signal(range(depth)), self._sum(m)
        with m.FSM():
            with m.State("CLEAR"):
                m.d.comb += [self.busy.eq(1), write.en.eq(1), write.addr.eq(clearing)]
                m.d.sync += clearing.eq(clearing + 1)
                with m.If(clearing == depth - 1):
                    m.next = "COUNT"
            with m.State("COUNT"):
                with m.If(self._count(m, write, read, counted)):
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

    def _sum(self, m: Module) -> data.View:
        """The frame's sums; returns what they are to take in, a bit each, the next cycle: a carry waits for no counter."""
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
        self, m: Module, write: wiring.PureInterface, read: wiring.PureInterface, counted: data.View,
    ) -> Value:
        """A hit a cycle; returns when the frame has ended. The hit before the end is written in the end's own cycle."""
        hit, begun = self.hits.payload, Signal()
        taken = self.hits.valid
        counts, within = taken & ~hit.end, hit.tile < self.tile_count
        update, again = Signal(), Signal()
        tile, summed = Signal(len(hit.tile), reset_less=True), Signal(self.count_bits, reset_less=True)
        m.d.comb += [self.busy.eq(begun), self.hits.ready.eq(1), read.en.eq(counts & within), read.addr.eq(hit.tile)]
        m.d.sync += [update.eq(counts & within), tile.eq(hit.tile)]

        count, after = Signal(self.count_bits), Signal(self.count_bits)  # one more, without a ripple: memory leaves little time
        m.d.comb += [
            count.eq(Mux(again, summed, read.data)),
            after.eq(Cat(~count[0], *(bit ^ count[:place].all() for place, bit in enumerate(count) if place))),
            write.en.eq(update & ~count.all()),
            write.addr.eq(tile),
            write.data.eq(after),
            counted.begins.eq(taken & ~begun),
            counted.more.eq(write.en),
            counted.first.eq(update & (count == 0)),
            counted.lost.eq(update & count.all()),
            counted.astray.eq(counts & ~within),
        ]
        m.d.sync += [summed.eq(after), again.eq(write.en & (tile == hit.tile))]
        with m.If(taken):
            m.d.sync += begun.eq(~hit.end)
        return taken & hit.end

    def _sweep(self, m: Module, write: wiring.PureInterface, read: wiring.PureInterface) -> Value:
        """A count a cycle, cleared in the cycle after it is read; returns when the last one is taken."""
        out = self.counts.payload
        tile, column = Signal.like(out.tile, reset_less=False), Signal.like(self.tiles_x)
        fetching, fetched = Signal(init=1), Signal()  # a counter is left to read; the one in `out` was read last cycle
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
