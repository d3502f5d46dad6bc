"""Stage two of the tile merge unit: joins neighbouring tiles, in tile order, into groups of about beta intersections.

Let `total` be the number of intersections of the open group, c the count of the next tile, and s = total + c. The rules are

    closes before   total != 0 and s >= beta: the group ends without this tile
    total           becomes c if the group closed before this tile, else s
    closes after    total >= beta, or the row of tiles ends here; total is then 0

An empty tile closes no group, because the total of an open group is below beta and an empty tile leaves it there.

The registers do not hold the total but the free space of the group, beta - 1 - total. The sign of the single difference
free space - c is then the comparison s >= beta, and the difference itself is the next free space. The free space that a fresh
group would have after this tile, beta - 1 - c, is computed one cycle earlier.

Whether a tile is the last of its group may depend on the next tile. A tile therefore waits for its successor, unless the tile
itself closes the group.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.tile_counters import tile_count_layout
from rtl.stream import payload_register
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, tile_group


class GroupTiles(wiring.Component):
    """Gives every tile of a frame, in tile order, the group that it belongs to.

    Parameters:
        config: the machine; only `row_width` is used, or with lists by super-tile `list_heads`.

    Ports:
        beta: merge threshold, 1 or more; must be stable from the cycle before a frame's first count until its last one.
        counts: every tile of a frame with its count, in tile order.
        groups: TileGroup items, one for each tile, in the same order.
        busy: at least one tile is inside.

    Throughput: one tile per cycle. Latency: a tile leaves 2 cycles after the transfer of the following tile; the last tile of a
    row leaves 3 cycles after its own transfer.
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

    def elaborate(self, platform: object) -> Module:
        m = Module()
        source = self.groups
        # A tile passes three registers: as it arrives; once it is known to be in the open group; at the output, with `last`.
        tile, tile_valid = Signal.like(self.counts.payload, reset_less=True), Signal()
        limit, fresh = Signal(COUNT_BITS), Signal(signed(COUNT_BITS + 1), reset_less=True)  # beta - 1; beta - 1 - c
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

        # `room` is the free space of the open group, `filled` says that its total is not 0, `opened` that it has no tile yet.
        room, filled, opened = Signal(COUNT_BITS), Signal(), Signal(init=1)
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
        group, out, last = Signal(len(source.payload.group)), payload_register(m, source), closed | before
        with m.If(leaves):
            m.d.sync += [out.tile.eq(placed.tile), out.count.eq(placed.count), out.group.eq(group), out.last.eq(last)]
            # `last` is on the critical path, so it drives only a multiplexer and an enable, and no adder waits for it
            with m.If(last):
                m.d.sync += group.eq(Mux(placed.frame_ends, 0, group + 1))
        return m
