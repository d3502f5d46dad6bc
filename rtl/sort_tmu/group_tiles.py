"""Stage two of the tile merge unit: counts in tile order to groups of about beta entries.

With `total` the entries of the open group, c a tile's count and s = total + c, the rules are

    closes before   total != 0 and s >= beta: the group ends without this tile
    total           c if so, else s
    closes after    total >= beta, or the row of tiles ends; total is then 0

An empty tile closes nothing: an open group's total is below beta, and s with it. Not the total is kept but the room left,
beta - 1 - total: then the sign of one difference, room - c, is the comparison, and the difference is the next room. What
is left of a fresh group's room by the tile is known a cycle before.
That a tile is its group's last is known from itself or from the next tile: a tile waits for the next but at the end of a row.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.tile_counters import tile_count_layout
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, tile_group


class GroupTiles(wiring.Component):
    """Tiles and their counts to tiles and their groups.

    Parameters:
        config: the machine; `row_width` matters here.

    Ports:
        beta: merge threshold, 1 or more; stable from the cycle before a frame's first count to its last one.
        counts: every tile of a frame, in order.
        groups: TileGroup items, as many.
        busy: a tile is on its way.

    Throughput: one tile a cycle. Latency: 2 cycles from the following tile's transfer, 3 from the last's in a row.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "beta": In(COUNT_BITS),
            "counts": In(stream.Signature(tile_count_layout(config))),
            "groups": Out(stream.Signature(layout(tile_group(config)))),
            "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        source = self.groups
        # Three registers in a row: a tile as it comes; once it is known to be in the open group; with `last`, at the output.
        tile, tile_valid = Signal.like(self.counts.payload, reset_less=True), Signal()
        limit, fresh = Signal(COUNT_BITS), Signal(signed(COUNT_BITS + 1), reset_less=True)  # beta - 1; less the tile's count
        placed, placed_valid, closed = Signal.like(tile, reset_less=True), Signal(), Signal(reset_less=True)
        leaves, advances = Signal(), Signal()
        m.d.comb += [
            leaves.eq(placed_valid & (closed | tile_valid) & (~source.valid | source.ready)),
            advances.eq(tile_valid & (~placed_valid | leaves)),
            self.counts.ready.eq(~tile_valid | advances),
            self.busy.eq(tile_valid | placed_valid | source.valid),
        ]
        with m.If(self.counts.ready):
            count = self.counts.payload.count
            m.d.sync += tile_valid.eq(self.counts.valid)
            m.d.sync += [tile.eq(self.counts.payload), fresh.eq(limit - count)]
        m.d.sync += limit.eq(self.beta - 1)

        room, filled, opened = Signal(COUNT_BITS), Signal(), Signal(init=1)  # of the open group; `opened`: it has no tile yet
        less, left = Signal(signed(COUNT_BITS + 1)), Signal(signed(COUNT_BITS + 1))
        m.d.comb += [less.eq(room - tile.count), left.eq(Mux(opened, fresh, less))]
        before = filled & (left < 0)
        after = Mux(before, fresh < 0, left < 0) | tile.row_ends
        with m.If(advances):
            m.d.sync += [room.eq(Mux(before, fresh, left)), opened.eq(after)]
            m.d.sync += filled.eq(~after & (filled | (tile.count != 0)))
            m.d.sync += [placed.eq(tile), closed.eq(after)]
        with m.If(leaves | advances):
            m.d.sync += placed_valid.eq(advances)
        with m.If(~source.valid | source.ready):
            m.d.sync += source.valid.eq(leaves)
        group, out, last = Signal.like(source.payload.group, reset_less=False), source.payload, closed | before
        with m.If(leaves):
            m.d.sync += [out.tile.eq(placed.tile), out.count.eq(placed.count), out.group.eq(group), out.last.eq(last)]
            with m.If(last):  # which is known late: no carry waits for it
                m.d.sync += group.eq(Mux(placed.frame_ends, 0, group + 1))
        return m
