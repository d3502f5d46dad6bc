"""Turns the tested groups of splats into pairs: one for every super-tile in which a splat has an intersection."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.group_walk import tested_group
from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, TILE
from spec.queues import LEVEL_GROUP
from spec.records import Record, projected_splat
from spec.supertiles import supertile_index, supertile_pair

_HALVES = LEVEL_GROUP // SUPER_X


def super_columns(config: AcceleratorConfig) -> int:
    """Columns of super-tiles of the widest frame."""
    return -(-config.row_width // (TILE * SUPER_X))


def sorted_record(config: AcceleratorConfig) -> Record:
    """The fields of a splat that its pairs have."""
    return Record("SortedSplat", sorted_record.__doc__, tuple(
        f for f in projected_splat(config).fields if f.name in ("index", "depth_key")))


class PairExpand(wiring.Component):
    """Collects the super-columns in which a splat has intersections, for one super-row after the other, and emits a pair for
    each of them.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        groups: `tested_group` items.
        splats: `sorted_record` items, one per splat; each is taken with its splat's last group.
        supers_x: columns of super-tiles of the frame.
        pairs: SuperTilePair items, splat by splat, for each splat by the super-tile's number; an item with `end`, whose other
            fields are 0, after the frame's last one.
        lives: strobe: the last group of a splat with a pair has been taken.
        busy: groups of a splat or pairs are inside that `pairs` does not offer yet.

    Throughput: one group and one pair a cycle: the pairs of a super-row leave while groups of the next one come. Latency: 2
    cycles from a super-row's last group to its first pair. The groups g0 to g3 of two super-rows, with two pairs each::

        groups      < g0 >< g1 >< g2 >< g3 >
        closes      _______~~~~~_______~~~~~
        columns           < g0 >      < g2 >
        rest                    < 2  >< 1  >< 2  >< 1  >
        pairs                         < p0 >< p1 >< p2 >< p3 >
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._columns = super_columns(config)
        super().__init__({
            "groups": In(stream.Signature(tested_group(config))),
            "splats": In(stream.Signature(layout(sorted_record(config)))),
            "supers_x": In(self._columns.bit_length()),
            "pairs": Out(stream.Signature(layout(supertile_pair(config)))),
            "lives": Out(1),
            "busy": Out(1),
        })
        self._base = unsigned(supertile_index(config))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        held = Signal(data.StructLayout({
            "splat": self.splats.payload.shape(), "base": self._base, "end": 1}), reset_less=True)
        rest, there, free = Signal(self._columns), Signal(), Signal()
        m.submodules.leaving = leaving = Buffer(self.pairs.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.pairs))
        self._collect(m, held, rest, there, free)
        lowest, column, out = Signal(self._columns), Signal(range(self._columns)), leaving.sink
        m.d.comb += [
            lowest.eq(Cat(rest[i] & ~rest[:i].any() for i in range(self._columns))),
            column.eq(Cat(
                Cat(lowest[i] for i in range(self._columns) if i >> k & 1).any() for k in range(len(column)))),
            out.valid.eq(there),
            out.payload.end.eq(held.end),
            free.eq(~there | out.ready & ~(rest & ~lowest).any()),
        ]
        with m.If(~held.end):
            m.d.comb += [out.payload.supertile.eq(held.base + column),
                         *(out.payload[name].eq(held.splat[name]) for name in ("index", "depth_key"))]
        with m.If(there & out.ready & ~free):
            m.d.sync += rest.eq(rest & ~lowest)
        return m

    def _collect(self, m: Module, held: data.View, rest: Signal, there: Signal, free: Signal) -> None:
        """Adds groups to the line of super-columns, and hands the line on with a super-row's last group."""
        item = self.groups.payload
        columns, line, found = Signal(self._columns), Signal(self._columns), Signal()
        taken, leaves, last = Signal(), Signal(), Signal()
        halves = [Cat(row[half * SUPER_X : (half + 1) * SUPER_X] for row in item.passed).any() for half in range(_HALVES)]
        for column in range(self._columns):
            m.d.comb += line[column].eq(columns[column] | (item.group == column // _HALVES) & halves[column % _HALVES])
        m.d.comb += [
            leaves.eq(item.end | item.closes & line.any()),
            self.groups.ready.eq((item.end | self.splats.valid) & (free | ~leaves)),
            taken.eq(self.groups.valid & self.groups.ready),
            last.eq(taken & item.last & ~item.end),
            self.splats.ready.eq(last),
            self.lives.eq(last & (found | line.any())),
            self.busy.eq(there | columns.any()),
        ]
        with m.If(free):
            m.d.sync += there.eq(0)
        with m.If(taken):
            m.d.sync += [columns.eq(Mux(item.closes, 0, line)), found.eq(~item.last & (found | line.any()))]
            with m.If(leaves):
                m.d.sync += [
                    there.eq(1), rest.eq(line), held.splat.eq(self.splats.payload), held.end.eq(item.end),
                    held.base.eq(item.row * self.supers_x)]
