"""Finds the list of a pair: the first list of its super-tile, and a binary search among the bounds of its lists.

`Numbering` says how the lists of a frame are numbered. Super-tiles before `open` have a row each in a table, with their first
list and their number of bounds. `open` is the last one with bounds, and those after it have one list each, so neither needs a
row: a frame without bounds, whose numbering is 0 in all fields, needs no table at all.

The bound of a list, below which no key of its pairs lies, has the list's number as its address; the first list of a super-tile
has none. There is a copy of the bounds for every step of the search, because each step of another pair reads in every cycle::

    cycle      0       1       2       3       4       5       6       7       8    ...   16
    pairs   <  A  >
    table           < row >
    first                           <first>
    bounds                                          <+ 16 >         <+8, 24>
    hit                                                     <  ?  >         <  ?  >
    entries                                                                              <  A  >
"""

from __future__ import annotations

from amaranth.hdl import Const, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.shapes import layout, shape
from rtl.stream import Buffer
from spec.config import AcceleratorConfig
from spec.records import frame_supertiles, intersection_item, list_index
from spec.supertiles import BUCKETS, supertile_index, supertile_pair

MADE_BITS = (BUCKETS - 1).bit_length()
"""Bits of the number of a super-tile's bounds."""


def numbering_layout(config: AcceleratorConfig) -> data.StructLayout:
    """How the lists of a frame are numbered: the last super-tile with bounds, its number of bounds, and its last list."""
    return data.StructLayout({"open": supertile_index(config), "made": MADE_BITS, "at": shape(list_index(config))})


def row_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A super-tile before the last one with bounds: its first list and its number of bounds."""
    return data.StructLayout({"first": shape(list_index(config)), "made": MADE_BITS})


def row_write(config: AcceleratorConfig) -> data.StructLayout:
    """A row for the table."""
    return data.StructLayout({"en": 1, "supertile": supertile_index(config), "row": row_layout(config)})


def bound_write(config: AcceleratorConfig) -> data.StructLayout:
    """A bound for the copies of the bounds."""
    return data.StructLayout({"en": 1, "list": shape(list_index(config)), "key": shape(config.formats.depth_key)})


class BucketSearch(wiring.Component):
    """Turns pairs (SuperTilePair) into IntersectionItem items with the lists of the pairs.

    Parameters:
        config: the machine.

    Ports:
        pairs: SuperTilePair items, and `end`.
        entries: an IntersectionItem for each, in order.
        numbering: `numbering_layout`; stable from two cycles before a frame's first pair until its `end` has left.
        row, bound: what is written to the table and to the bounds; nothing may be, while pairs are inside.

    Storage: a row for each super-tile of the largest frame, and log2(BUCKETS) bounds for each list. Throughput: one pair per
    cycle. Latency: 16 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "pairs": In(stream.Signature(layout(supertile_pair(config)))),
            "entries": Out(stream.Signature(layout(intersection_item(config)))),
            "numbering": In(numbering_layout(config)), "row": In(row_write(config)), "bound": In(bound_write(config)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.out = out = Buffer(self.entries.payload.shape())
        wiring.connect(m, out.source, wiring.flipped(self.entries))
        pair, entry, advance = self.pairs.payload, out.sink.payload, out.sink.ready
        m.d.comb += self.pairs.ready.eq(advance)
        p = Pipeline(m, load=self.pairs.valid, advance=advance)
        index, key, end = p.data("index", pair.index), p.data("key", pair.depth_key), p.data("end", pair.end)
        first, made = self._first(m, p, advance)
        number = self._search(m, p, advance, key, first, made)
        leaves = number.stage
        m.d.comb += [
            out.sink.valid.eq(p.control("valid", self.pairs.valid).at(leaves)), entry.tile.eq(number.value),
            entry.index.eq(index.at(leaves)), entry.depth_key.eq(key.at(leaves)), entry.end.eq(end.at(leaves)),
        ]
        return m

    def _first(self, m: Module, p: Pipeline, advance: Value) -> tuple[Staged, Staged]:
        """The first list of the pair's super-tile, and its number of bounds."""
        rows, numbers = row_layout(self.config), self.numbering
        m.submodules.table = table = memory.Memory(shape=rows, depth=frame_supertiles(self.config), init=[])
        write, read = table.write_port(), table.read_port()
        number, opened = self.pairs.payload.supertile, Signal(len(numbers.at))  # the first list of `open`
        m.d.sync += opened.eq(numbers.at - numbers.made)
        m.d.comb += [
            read.addr.eq(number), read.en.eq(advance),
            write.addr.eq(self.row.supertile), write.data.eq(self.row.row), write.en.eq(self.row.en),
        ]
        supertile, row = p.data("supertile", number), Staged(p, "row", read.data, 1, False)
        beyond = p.reg("beyond", lambda s: s > numbers.open, supertile)
        within = p.reg("within", lambda s: s == numbers.open, supertile)
        over = p.reg("over", lambda s: s - numbers.open, supertile)
        tail = p.reg("tail", lambda over: (numbers.at + over)[: len(opened)], over)
        inner = p.reg("inner", lambda within, row: Mux(within, opened, row.first), within, row)
        made = p.reg("made", lambda beyond, within, row: Mux(beyond, 0, Mux(within, numbers.made, row.made)),
                     beyond, within, row)
        return p.reg("first", lambda beyond, tail, inner: Mux(beyond, tail, inner), beyond, tail, inner), made

    def _search(
        self, m: Module, p: Pipeline, advance: Value, key: Staged, first: Staged, made: Staged,
    ) -> Staged:
        """The list with the largest bound that is not above the pair's key; each step takes two cycles. The next step's address
        is found for both outcomes while the bound is read."""
        bits = len(first.value)
        base, size = first, BUCKETS // 2
        candidate = p.reg("candidate_0", lambda x, size=size: (x + size)[:bits], first)
        offset = p.data("offset_0", Const(0, MADE_BITS))  # number of `base` among its lists
        for step in range(MADE_BITS):
            bound = self._bounds(m, p, advance, step, candidate)
            more = p.reg(f"hit_{step}", lambda bound, key, offset, made, size=size: (
                (offset | size) <= made) & (bound <= key), bound, key, offset, made)
            stage = more.stage
            low = base.to(candidate.stage)
            base = Staged(p, f"base_{step}", Mux(more.value, candidate.at(stage), base.at(stage)), stage, False)
            if step == MADE_BITS - 1:
                break
            nexts = [p.reg(f"{name}_{step}", lambda x, size=size: (x + size // 2)[:bits], x)
                     for name, x in (("high", candidate), ("low", low))]
            candidate = Staged(p, f"candidate_{step + 1}", Mux(more.value, *(x.at(stage) for x in nexts)), stage, False)
            offset = Staged(p, f"offset_{step + 1}", offset.at(stage) | Mux(more.value, size, 0), stage, False)
            size //= 2
        return p.reg("list", lambda x: x, base)

    def _bounds(self, m: Module, p: Pipeline, advance: Value, step: int, candidate: Staged) -> Staged:
        """The candidate's bound, from the copy of this step."""
        copy = memory.Memory(shape=len(self.bound.key), depth=self.config.list_heads, init=[])
        m.submodules[f"bounds_{step}"] = copy
        write, read = copy.write_port(), copy.read_port()
        m.d.comb += [
            read.addr.eq(candidate.value), read.en.eq(advance),
            write.addr.eq(self.bound.list), write.data.eq(self.bound.key), write.en.eq(self.bound.en),
        ]
        return Staged(p, f"bound_{step}", read.data, candidate.stage + 1, False)
