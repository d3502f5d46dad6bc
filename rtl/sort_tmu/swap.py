"""Lets reading, sorting and rendering take one group each and swap their buffers together: the paper's baseline."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.header_maker import waiting_tiles
from spec.config import AcceleratorConfig
from spec.queues import ARRAY_TILES, HEADERS
from spec.records import chunk_item, frame_tiles, tile_group

GATES = ("groups", "sorted", "shown")
"""Streams that the unit holds back: into the sorter, from it to the double buffer, and from that to the splat fetch."""


class SwapTogether(wiring.Component):
    """Holds intersections back so that no stage is more than one group ahead of the next, and all begin a group together.

    In a step, one group enters the sorter, the group before it leaves the sorter for the double buffer, and the group before
    that is rendered, its rows included. The next step begins when all three are done::

        step               0         1             2                3
        into the sorter    < group 0 >< group 1   >< group 2       ><...
        out of the sorter             < group 0   >< group 1       ><...
        rendered                                   < group 0 >      < group 1 ...

    This is how we read the text of the paper's section 7: double buffers between stages, one tile in each half. The text gives
    no rule for the swap. A group larger than the double buffer is rendered while its rest still leaves the sorter.

    Parameters:
        config: the machine.

    Ports:
        NAME_in, NAME_out: a stream of ChunkItem items for each of GATES, without latency.
        tile, tile_moves: an item of the tile merge unit and whether it is taken; tiles without intersections are counted, too.
        row_ends: strobe: the last row of a tile leaves the array; tiles leave in the order in which they came.
        clear: strobe: a frame begins.

    Storage: a bit for each tile between the merge unit and the array's output. A step begins two cycles after the last of
    its stages was done.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        items = stream.Signature(layout(chunk_item(config)))
        super().__init__({
            **{f"{name}_in": In(items) for name in GATES}, **{f"{name}_out": Out(items) for name in GATES},
            "tile": In(layout(tile_group(config))), "tile_moves": In(1), "row_ends": In(1), "clear": In(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        groups = range(frame_tiles(self.config) + 2)
        announced, finished = Signal(groups), Signal(groups)
        passed = {name: Signal(groups, name=f"{name}_passed") for name in GATES}
        limit = {name: Signal(groups, name=f"{name}_limit") for name in GATES}
        for name in GATES:
            source, sink, opened = getattr(self, f"{name}_in"), getattr(self, f"{name}_out"), Signal(name=f"{name}_opened")
            m.d.comb += [
                opened.eq(passed[name] != limit[name]), sink.payload.eq(source.payload),
                sink.valid.eq(source.valid & opened), source.ready.eq(sink.ready & opened)]
            with m.If(sink.valid & sink.ready & sink.payload.last):
                m.d.sync += passed[name].eq(passed[name] + 1)
        entered, left = passed["groups"], passed["sorted"]
        with m.If(((entered == limit["groups"]) | (entered == announced)) & (left == limit["sorted"])
                  & (finished == limit["shown"])):
            m.d.sync += [limit["groups"].eq(entered + 1), limit["sorted"].eq(entered), limit["shown"].eq(left)]
        with m.If(self.sorted_out.valid & ~self.sorted_out.ready & (finished == limit["shown"])):
            m.d.sync += limit["shown"].eq(left + 1)  # the double buffer is full of a group larger than itself
        self._follow(m, announced, finished)
        with m.If(self.clear):
            m.d.sync += [x.eq(0) for x in (announced, finished, *passed.values(), *limit.values())]
        return m

    def _follow(self, m: Module, announced: Signal, finished: Signal) -> None:
        """Counts the groups with intersections: those that the merge unit has announced, and those whose rows have left."""
        depth = waiting_tiles(self.config) + HEADERS + ARRAY_TILES + 8
        m.submodules.tiles = tiles = SyncFIFOBuffered(width=1, depth=depth)  # whether the tile ends a group with intersections
        begun, filled = Signal(), Signal()
        m.d.comb += [
            filled.eq(begun | (self.tile.count != 0)), tiles.w_en.eq(self.tile_moves),
            tiles.w_data.eq(self.tile.last & filled), tiles.r_en.eq(self.row_ends)]
        with m.If(self.tile_moves):
            m.d.sync += begun.eq(filled & ~self.tile.last)
            with m.If(self.tile.last & filled):
                m.d.sync += announced.eq(announced + 1)
        with m.If(self.row_ends & tiles.r_data):
            m.d.sync += finished.eq(finished + 1)
