"""Turns the tested groups of splats into pairs: one for every super-tile in which a splat has an intersection."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.group_walk import tested_group
from spec.config import AcceleratorConfig
from spec.constants import SUPER_X, TILE
from spec.queues import LEVEL_GROUP, LINES_AHEAD
from spec.records import Record, projected_splat
from spec.supertiles import supertile_index, supertile_pair

_HALVES = LEVEL_GROUP // SUPER_X


def super_columns(config: AcceleratorConfig) -> int:
    """Columns of super-tiles of the widest frame; a joint frame may have one more."""
    return -(-config.row_width // (TILE * SUPER_X)) + config.joint


def sorted_record(config: AcceleratorConfig) -> Record:
    """The fields of a splat that its pairs have."""
    return Record("SortedSplat", sorted_record.__doc__, tuple(
        f for f in projected_splat(config).fields if f.name in ("index", "depth_key", "eye")))


class PairExpand(wiring.Component):
    """Collects the super-columns in which a splat has intersections, for one super-row after the other, and emits a pair for
    each of them.

    A step may reach over two super-rows. What it finds in the second one is kept until the splat's next step, which begins
    there, or leaves with what the last step finds in the first. The lines of super-columns wait in a queue, because splats of
    many pairs come in bursts, while most steps have one pair or none.

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

    Throughput: one group and one pair a cycle, together, while the queue has not the lines of LINES_AHEAD steps. Latency:
    4 cycles from a step's last group to its first pair. Storage: the queue. The groups g0 to g3 of two steps of two pairs
    each::

        groups      < g0 >< g1 >< g2 >< g3 >
        closes      _______~~~~~_______~~~~~
        queue                         < 1  >      < 3  >
        line                                < 2  >< 1  >< 2  >< 1  >
        pairs                                     < p0 >< p1 >< p2 >< p3 >
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
        self._item = data.StructLayout({
            "upper": self._columns, "lower": self._columns, "row": self.groups.payload.row.shape(),
            "splat": self.splats.payload.shape(), "end": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.leaving = leaving = Buffer(self.pairs.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.pairs))
        m.submodules.lines = lines = SyncFIFOBuffered(width=self._item.size, depth=LINES_AHEAD)
        collecting = self._collect(m, lines)
        leaves = self._emit(m, lines, leaving.sink)
        m.d.comb += self.busy.eq(collecting | lines.level.any() | leaves)
        return m

    def _collect(self, m: Module, lines: SyncFIFOBuffered) -> Value:
        """Adds groups to the lines of both super-rows that a step may meet, and hands them on with its last group; returns
        whether there is anything of a splat."""
        item, queued = self.groups.payload, data.View(self._item, lines.w_data)
        upper, lower, upper_line, lower_line = (
            Signal(self._columns, name=name) for name in ("upper", "lower", "upper_line", "lower_line"))
        found, taken, last, meets, leaves = Signal(), Signal(), Signal(), Signal(), Signal()
        halves = [[row[half * SUPER_X : (half + 1) * SUPER_X].any() for half in range(_HALVES)] for row in item.passed]
        for column in range(self._columns):
            here, (first, second) = item.group == column // _HALVES, (row[column % _HALVES] for row in halves)
            m.d.comb += [upper_line[column].eq(upper[column] | here & (first | second & ~item.astride)),
                         lower_line[column].eq(lower[column] | here & second & item.astride)]
        m.d.comb += [
            queued.upper.eq(upper_line), queued.lower.eq(Mux(item.last, lower_line, 0)), queued.row.eq(item.row),
            queued.splat.eq(self.splats.payload), queued.end.eq(item.end),
            meets.eq(upper_line.any() | lower_line.any()),
            leaves.eq(item.end | item.closes & (upper_line.any() | item.last & lower_line.any())),
            self.groups.ready.eq((item.end | self.splats.valid) & lines.w_rdy),  # any group waits: `leaves` comes late
            taken.eq(self.groups.valid & self.groups.ready), lines.w_en.eq(taken & leaves),
            last.eq(taken & item.last & ~item.end),
            self.splats.ready.eq(last),
            self.lives.eq(last & (found | meets)),
        ]
        with m.If(taken):
            m.d.sync += [upper.eq(upper_line), lower.eq(lower_line), found.eq(~item.last & (found | meets))]
            with m.If(item.closes):
                m.d.sync += [upper.eq(Mux(item.last, 0, lower_line)), lower.eq(0)]
        return upper.any() | lower.any()

    def _emit(self, m: Module, lines: SyncFIFOBuffered, out: stream.Interface) -> Value:
        """Emits the pairs of a step, those of the upper super-row first; returns whether there are any."""
        comes = data.View(self._item, lines.r_data)
        held = Signal(data.StructLayout({
            "splat": self.splats.payload.shape(), "upper_base": self._base, "lower_base": self._base, "end": 1}),
            reset_less=True)
        upper, lower, line, lowest, rest = (
            Signal(self._columns, name=name) for name in ("upper_left", "lower_left", "line", "lowest", "rest"))
        there, above, free, column = Signal(), Signal(), Signal(), Signal(range(self._columns))
        m.d.comb += [
            above.eq(upper.any()), line.eq(Mux(above, upper, lower)),
            lowest.eq(Cat(line[i] & ~line[:i].any() for i in range(self._columns))), rest.eq(line & ~lowest),
            column.eq(Cat(
                Cat(lowest[i] for i in range(self._columns) if i >> k & 1).any() for k in range(len(column)))),
            out.valid.eq(there),
            out.payload.end.eq(held.end),
            free.eq(~there | out.ready & ~rest.any() & ~(above & lower.any())),
            lines.r_en.eq(free),
        ]
        with m.If(~held.end):
            m.d.comb += [out.payload.supertile.eq(Mux(above, held.upper_base, held.lower_base) + column),
                         *(out.payload[name].eq(held.splat[name]) for name in held.splat.shape().members)]
        with m.If(free):
            m.d.sync += [there.eq(lines.r_rdy), upper.eq(comes.upper), lower.eq(comes.lower), held.splat.eq(comes.splat),
                         held.upper_base.eq(comes.row * self.supers_x),
                         held.lower_base.eq((comes.row + 1) * self.supers_x), held.end.eq(comes.end)]
        with m.Elif(out.ready):
            with m.If(above):
                m.d.sync += upper.eq(rest)
            with m.Else():
                m.d.sync += lower.eq(rest)
        return there
