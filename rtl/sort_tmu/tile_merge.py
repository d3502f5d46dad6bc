"""The tile merge unit: counts intersections by tile and merges neighbouring tiles (paper section 6.2, "Tile Merging")."""

from __future__ import annotations

from amaranth.hdl import Module, Mux
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.auto_beta import AutoBeta
from rtl.sort_tmu.group_tiles import GroupTiles
from rtl.sort_tmu.tile_counters import TileCounters
from spec.config import AcceleratorConfig
from spec.records import COUNT_BITS, frame_lists, intersection_tile, tile_group


class TileMergeUnit(wiring.Component):
    """A pipeline of two stages, `TileCounters` and `GroupTiles`; `AutoBeta` runs between them, before the sweep of the
    counters. In machines with lists by super-tile, lists take the place of tiles, and a frame is one row.

    Parameters:
        config: the machine; `row_width` (frames of up to that many pixels squared) and `sort_buffer_bytes` are used, and with
            lists by super-tile `list_heads` instead of `row_width`.
        count_bits: bits of a tile's counter; a full counter stays full and raises `saturated`.

    Ports:
        hits: IntersectionTile items, one per intersection in any order, then one with `end`. Frames follow each other.
        groups: a TileGroup item for every tile, in tile order.
        tiles_x, tile_count: tiles of a row and of the frame, 1 or more.
        beta: merge threshold in intersections; 0 means 1.
        auto: use `AutoBeta` instead of `beta`: twice the frame's mean count over non-empty tiles, capped by half the sort
            buffer.
        beta_used: the threshold of the frame that was counted last; groups of the frame before it may still be leaving.
        saturated, outside: an intersection of the frame was not counted, because the counter of its tile was full or because
            there is no such tile. Both keep their value until the first item of the next frame.
        busy: high from the first item of a frame until its last group is taken, and while the counters are cleared after a
            reset. Settings may change only while it is low.

    Storage: that of `TileCounters`. Throughput: one intersection per cycle, one tile per cycle. Latency: the first group leaves
    9 cycles after `end`, plus the cycles of `AutoBeta` if `auto` is set. Items of the next frame are taken from the cycle on in
    which the last count is read.
    """

    def __init__(self, config: AcceleratorConfig, *, count_bits: int = COUNT_BITS):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config, self._counters = config, TileCounters(config, count_bits=count_bits)
        tiles = frame_lists(config)
        super().__init__({
            "hits": In(stream.Signature(layout(intersection_tile(config)))),
            "groups": Out(stream.Signature(layout(tile_group(config)))),
            "tiles_x": In(range(tiles + 1)),
            "tile_count": In(range(tiles + 1)),
            "beta": In(COUNT_BITS),
            "auto": In(1),
            "beta_used": Out(COUNT_BITS),
            "saturated": Out(1),
            "outside": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.counters = counters = self._counters
        m.submodules.auto_beta = auto_beta = AutoBeta(self.config)
        m.submodules.group_tiles = group_tiles = GroupTiles(self.config)
        wiring.connect(m, wiring.flipped(self.hits), counters.hits)
        wiring.connect(m, counters.counts, group_tiles.counts)
        wiring.connect(m, group_tiles.groups, wiring.flipped(self.groups))
        m.d.comb += [
            counters.tiles_x.eq(self.tiles_x),
            counters.tile_count.eq(self.tile_count),
            auto_beta.total.eq(counters.total),
            auto_beta.filled.eq(counters.filled),
            group_tiles.beta.eq(self.beta_used),
            self.saturated.eq(counters.saturated),
            self.outside.eq(counters.outside),
            self.busy.eq(counters.busy | group_tiles.busy),
        ]
        with m.FSM():
            with m.State("COUNTING"):
                with m.If(counters.settled):
                    m.d.comb += auto_beta.start.eq(self.auto)
                    m.next = "CHOOSING"
            with m.State("CHOOSING"):
                with m.If(auto_beta.done):
                    m.d.sync += self.beta_used.eq(Mux(self.auto, auto_beta.beta, Mux(self.beta == 0, 1, self.beta)))
                    m.next = "SWEEPING"
            with m.State("SWEEPING"):
                m.d.comb += counters.begin_sweep.eq(1)
                m.next = "COUNTING"
        return m
