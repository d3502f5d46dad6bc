"""Scans a strip of the target column by column: gives every pixel its neighbours, and finds the holes that they can fill.

Pixels are scanned down a column and then down the next, `warp_lanes` per step. They pass a chain of registers, in which the
neighbours of a pixel are always at the same distance: 1, 15, 16 and 17 pixels before and behind it. There are no neighbours
above the first row of a strip or below its last. Before its first column and behind its last one the chain holds groups
without valid pixels.

With `warp_fill` = "majority" a hole is filled if more than half of its existing neighbours were warped. How many exist follows
from which rows and columns around the hole exist. Of 8 it takes 5; of 5 it takes 3; of 3 it takes 2. In a frame of one row or
column it takes both of 2, or the one of 1.

The group in the middle of the chain leaves in one slot. If it has several holes to fill, it leaves in one slot for each, and
the chain waits::

    cycle            0      1      2      3      4      5      6      7
    middle       <  A  ><  B  ><  B  ><  B  ><  C  ><  D  >            B has three holes to fill, C has one
    hole                < B0  >< B1  >< B3  >< C2  >
    slots.last   ~~~~~~~______________~~~~~~~~~~~~~~~~~~~~~
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.warp_unit.bank import kept_layout
from rtl.warp_unit.queue import column_bits, sub_bits, sub_rows
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.stereo import FILL_NEIGHBOURS

NEIGHBOURS = tuple(TILE * dx + dy for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (dx, dy) != (0, 0))
"""Positions of a pixel's neighbours in the scan, relative to the pixel."""

RANK_BITS = 2
"""Bits of the median's rank; among at most 8 neighbours it is 0 to 3."""


def painted_layout() -> data.StructLayout:
    """A pixel of the target eye; `covered` if it is neither background nor a hole."""
    return data.StructLayout({"colour": data.ArrayLayout(8, 3), "covered": 1})


def group_members(config: AcceleratorConfig) -> dict[str, object]:
    """A group, which is `warp_lanes` pixels of a column, and the one hole that is filled: `lane`, if `fills`."""
    lanes = config.warp_lanes
    return {
        "pixels": data.ArrayLayout(painted_layout(), lanes), "holes": lanes, "fills": 1, "lane": range(lanes), "last": 1,
        "left": 1, "warped": range(lanes + 1)}


def slot_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A group of pixels in one of its slots; `last` marks the last slot.

    `holes` are the holes that are filled; `left`: there is a hole that is not; `warped`: the number of pixels that are no
    holes. For the hole that is filled in this slot: `lane`, its neighbours `around`, and the median's `rank` among them.
    """
    neighbour = data.StructLayout({"colour": data.ArrayLayout(8, 3), "valid": 1})
    return data.StructLayout({
        **group_members(config), "around": data.ArrayLayout(neighbour, len(NEIGHBOURS)), "rank": RANK_BITS})


class _Pixel(NamedTuple):
    """A pixel of the chain; the fields are those of `kept_layout`."""

    colour: Value
    valid: Value
    solid: Value


class Window(wiring.Component):
    """Gives the pixels of a strip their neighbours.

    Parameters:
        config: the machine; `row_width`, `warp_lanes` and `warp_fill` are used.

    Ports:
        start: strobe before a strip, after which `run` rises.
        run: stays high until all slots have left and the units behind this one are empty.
        last, rows: the frame's last column, and the rows of the strip that lie in the frame.
        which: the memory of the next place, the same in every lane.
        kept_valid, kept: that place in each lane.
        take: strobe; moves on to the next place.
        tile_ends: strobe, together with the last place of a tile.
        slots: the groups, down every column, columns from left to right.

    Storage: 38 pixels of 26 bits for 4 lanes. Throughput: one group per cycle if it has at most one hole to fill, otherwise one
    cycle per hole; the unit waits while a place is not available. Latency: one column and 2 cycles; at the end of a strip it
    runs empty for as many cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "start": In(1), "run": In(1), "rows": In(range(TILE + 1)),
            "last": In(column_bits(config)),
            "which": Out(1), "kept_valid": In(config.warp_lanes), "kept": In(kept_layout()).array(config.warp_lanes),
            "take": Out(1), "tile_ends": Out(1),
            "slots": Out(stream.Signature(slot_layout(config))),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        step, real = Signal(), Signal(sub_rows(self.config) + 2)
        more, there = self._places(m, step)
        with m.If(step):
            m.d.sync += real.eq(Cat(more, real))
        pixels = self._chain(m, step, more)
        sub, ends = Signal(range(sub_rows(self.config))), sub_rows(self.config) - 1
        first, top, bottom = Signal(), Signal(), Signal()  # `sub` is 0; `sub` is its last value
        with m.If(self.start):
            m.d.sync += [sub.eq(0), first.eq(1), top.eq(1), bottom.eq(ends == 0)]
        with m.Elif(step & real[-1]):
            m.d.sync += [sub.eq(sub + 1), top.eq(sub == ends), bottom.eq(sub == max(ends - 1, 0))]
            with m.If(bottom):
                m.d.sync += first.eq(0)
        columns = (~first, real[1])  # one column behind the middle, the group of the same rows has been read already
        last = self._slots(m, pixels, sub, (top, bottom), real[-1] & there, columns)
        m.d.comb += step.eq(self.run & there & (~real[-1] | self.slots.ready & last))
        return m

    def _places(self, m: Module, step: Signal) -> tuple[Signal, Signal]:
        """Takes the strip's places, one per step. Returns whether one is left, and whether it is there or none is needed."""
        sub, x, more, there = Signal(range(sub_rows(self.config))), Signal(column_bits(self.config)), Signal(), Signal()
        column_ends, ends = Signal(), Signal()
        m.d.comb += [
            column_ends.eq(sub == sub_rows(self.config) - 1), ends.eq(x == self.last),
            self.which.eq(x[0] ^ sub[0] if sub_bits(self.config) else x[0]),
            there.eq(~more | self.kept_valid.all()), self.take.eq(step & more),
            self.tile_ends.eq(self.take & column_ends & (x[: (TILE - 1).bit_length()].all() | ends))]
        with m.If(self.start):
            m.d.sync += [sub.eq(0), x.eq(0), more.eq(1)]
        with m.Elif(self.take):
            m.d.sync += sub.eq(sub + 1)
            with m.If(column_ends):
                m.d.sync += [x.eq(x + 1), more.eq(~ends)]
        return more, there

    def _chain(self, m: Module, step: Signal, more: Signal) -> dict[int, _Pixel]:
        """The pixels, keyed by their position in the scan relative to the first pixel of the group in the middle."""
        lanes, reach = self.config.warp_lanes, sub_rows(self.config) + 1
        before: list[_Pixel] = [_Pixel(kept.colour.as_value(), kept.valid & more, kept.solid) for kept in self.kept]
        pixels: dict[int, _Pixel] = {}
        for group in range(reach, -reach - 1, -1):
            now = []
            for lane, pixel in enumerate(before):
                at = group * lanes + lane
                name = f"pixel_{'before' if at < 0 else 'behind'}_{abs(at)}"
                pixels[at] = after = _Pixel(
                    Signal(24, name=f"{name}_colour", reset_less=True), Signal(name=f"{name}_valid"),
                    Signal(name=f"{name}_solid", reset_less=True))
                with m.If(step):
                    m.d.sync += [a.eq(b) for a, b in zip(after, pixel, strict=True)]
                now.append(after)
            before = now
        return pixels

    def _slots(
        self, m: Module, pixels: dict[int, _Pixel], sub: Signal, edges: tuple[Value, Value], real: Value,
        columns: tuple[Value, Value],
    ) -> Value:
        """Drives the slots of the group in the middle; returns whether the current slot is its last one.

        `edges`: the group has the first, the last rows of the strip. `columns`: the column before, the column behind exists.
        """
        lanes, slot = range(self.config.warp_lanes), self.slots.payload
        neighbours, counts = zip(*(self._around(m, pixels, lane, edges) for lane in lanes), strict=True)
        valid = Cat(pixels[lane].valid for lane in lanes)
        fillable, done, todo, pick = (Signal(len(lanes), name=name) for name in ("fillable", "done", "todo", "pick"))
        rows = Signal(TILE)  # rows of the strip that lie in the frame, registered long before the first slot of a strip
        m.d.sync += rows.eq(Cat(row < self.rows for row in range(TILE)))
        inside, next_inside = (bits.word_select(sub, len(lanes)) for bits in (rows, Cat(rows[1:], Const(0, 1))))
        enough = Cat(self._enough(count, (~edges[0] if lane == 0 else Const(1), next_inside[lane]), columns)
                     for lane, count in enumerate(counts))
        # by gates instead of a subtraction, because the whole chain waits for `last`
        before = [todo[:lane].any() for lane in lanes]
        last = ~Cat(todo[lane] & before[lane] for lane in lanes).any()
        m.d.comb += [
            todo.eq(fillable & ~done), pick.eq(Cat(todo[lane] & ~before[lane] for lane in lanes)),
            fillable.eq(~valid & inside & enough),
            self.slots.valid.eq(real & self.run),
            slot.holes.eq(fillable), slot.fills.eq(todo.any()), slot.last.eq(last),
            slot.left.eq((~valid & ~enough & inside).any()), slot.warped.eq(sum(valid)),
            slot.lane.eq(Cat(Cat(pick[lane] for lane in lanes if lane >> bit & 1).any()
                             for bit in range(len(lanes).bit_length() - 1))),
            slot.around.as_value().eq(picked(pick, [Cat(around) for around in neighbours])),
            slot.rank.eq(picked(pick, [((count - 1) >> 1)[:RANK_BITS] for count in counts])),
        ]
        for lane in lanes:
            pixel = pixels[lane]
            m.d.comb += [slot.pixels[lane].colour.as_value().eq(Mux(pixel.valid, pixel.colour, 0)),
                         slot.pixels[lane].covered.eq(pixel.valid & pixel.solid)]
        with m.If(self.slots.valid & self.slots.ready):
            m.d.sync += done.eq(Mux(last, 0, done | pick))
        return last

    def _enough(self, count: Value, rows: tuple[Value, Value], columns: tuple[Value, Value]) -> Value:
        """Whether `count` neighbours are enough to fill a hole, given which rows and columns around it exist."""
        if self.config.warp_fill == "interior":
            return count >= FILL_NEIGHBOURS
        both, either = zip(*((a & b, a | b) for a, b in (rows, columns)), strict=True)
        thin = ~either[0] | ~either[1]  # a frame of one row or column, with up to two neighbours
        three = (both[0] ^ both[1]) & ~thin
        return Mux(both[0] & both[1], count >= FILL_NEIGHBOURS, Mux(
            three, count >= 3, Mux(~thin | both[0] | both[1], count >= 2, count.any())))

    def _around(
        self, m: Module, pixels: dict[int, _Pixel], lane: int, edges: tuple[Value, Value],
    ) -> tuple[list[Value], Value]:
        """The neighbours of a lane's pixel within the strip, and their number."""
        above = ~edges[0] if lane == 0 else Const(1, 1)
        below = ~edges[1] if lane == self.config.warp_lanes - 1 else Const(1, 1)
        around, valid = [], []
        for offset in NEIGHBOURS:
            pixel, dy = pixels[lane + offset], (offset + 1) % TILE - 1
            valid.append(pixel.valid & {-1: above, 0: Const(1, 1), 1: below}[dy])
            around.append(Cat(pixel.colour, valid[-1]))
        count = Signal(range(len(NEIGHBOURS) + 1), name=f"count_{lane}")
        m.d.comb += count.eq(sum(valid))
        return around, count


def picked(pick: Value, values: list[Value]) -> Value:
    """The value whose bit of `pick` is set; 0 where none is."""
    return reduce(or_, (Mux(pick[i], value, 0) for i, value in enumerate(values)))
