"""Cuts the boxes of splats into runs of tiles: parts of a tile row in which all tiles have the same level and flags."""

from __future__ import annotations

from functools import reduce
from itertools import pairwise
from operator import or_

from amaranth.hdl import Cat, Module, Mux, ShapeLike, Signal, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.level_table import GROUP_PLACES, code_layout
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.queues import LEVEL_GROUP
from spec.records import TILE_BITS, Record, projected_splat, tile_index

PLACE = unsigned(GROUP_PLACES)
"""Shape of a tile's position in its group of LEVEL_GROUP tiles."""

_TESTED = ("bound", "mean2d", "conic", "log2_opacity")
"""The fields of a splat that the ellipse test and the foveation filter need."""


def run_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A run: its splat, the tiles `begin` to `stop` of group number `group` in tile row `row`, and the `code` of those tiles.

    `tile` is the number of the group's first tile. `last` marks the splat's last run. An item with `end` is no run; it follows
    the frame's last run.
    """
    return data.StructLayout({
        "splat": _tested(config), "row": unsigned(TILE_BITS), "group": unsigned(TILE_BITS - GROUP_PLACES),
        "tile": unsigned(tile_index(config).width), "begin": PLACE, "stop": PLACE, "code": code_layout(config),
        "last": 1, "end": 1})


def _tested(config: AcceleratorConfig) -> data.StructLayout:
    record = projected_splat(config)
    return layout(Record("Tested", "", tuple(f for f in record.fields if f.name in _TESTED)))


class _Stage:
    """A register between two stages: `payload`, `valid`, and `ready`, which is high when the next stage takes the payload."""

    def __init__(self, name: str, config: AcceleratorConfig, more: dict[str, ShapeLike]) -> None:
        item = data.StructLayout({
            "splat": _tested(config), "row": unsigned(TILE_BITS), "group": unsigned(TILE_BITS - GROUP_PLACES), "last": 1,
            "end": 1, **more})
        self.payload = Signal(item, name=name, reset_less=True)
        self.valid, self.ready = Signal(name=f"{name}_valid"), Signal(name=f"{name}_ready")


class TileRuns(wiring.Component):
    """Walks through the boxes of splats, row by row and one group of tiles at a time, and cuts the groups into runs.

    Parameters:
        config: the machine.

    Ports:
        splats: ProjectedSplat items.
        enable, row, group, codes, row_start: the read port of `LevelTable`.
        runs: `run_layout` items, for each splat row by row, then by column; and one item with `end` for each one at the input.

    Throughput: one run per cycle, without gaps between rows and splats. Latency: 4 cycles, one for each stage: the walk, which
    addresses the table; the answer of the table, from which follows where runs stop; the runs of a group one after the other;
    the output register::

        walk    < row 3, group 0 >< row 3, group 1 ><       row 4, group 0      >
        codes                     < 11112222        ><    1111   ><     ..
        runs                                         < 1111 ><  2222  >< 1111 ><
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "splats": In(stream.Signature(layout(projected_splat(config)))),
            "enable": Out(1),
            "row": Out(TILE_BITS),
            "group": Out(TILE_BITS - GROUP_PLACES),
            "codes": In(data.ArrayLayout(code_layout(config), LEVEL_GROUP)),
            "row_start": In(tile_index(config).width),
            "runs": Out(stream.Signature(run_layout(config))),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        walked = _Stage("walked", self.config, {"begin": PLACE, "stop": PLACE})
        cut = _Stage("cut", self.config, {
            "tile": self.row_start.shape(), "begin": PLACE, "stops": unsigned(LEVEL_GROUP),
            "codes": data.ArrayLayout(code_layout(self.config), LEVEL_GROUP)})
        self._walk(m, walked)
        self._cut(m, walked, cut)
        self._pick(m, cut)
        return m

    def _walk(self, m: Module, walked: _Stage) -> None:
        """The current splat and the current group in its box; loads the stage `walked`."""
        splat, present = Signal.like(self.splats.payload, name="splat", reset_less=True), Signal()
        row, group = Signal(TILE_BITS, reset_less=True), Signal(TILE_BITS - GROUP_PLACES, reset_less=True)
        first, final = splat.first_x[GROUP_PLACES:], splat.last_x[GROUP_PLACES:]
        row_ends, leaves, last = group == final, Signal(), Signal()
        m.d.comb += [
            last.eq(splat.end | (row_ends & (row == splat.last_y))),
            leaves.eq(present & (walked.ready | ~walked.valid)),
            self.splats.ready.eq(~present | (leaves & last)),
            self.enable.eq(leaves),
            self.row.eq(row),
            self.group.eq(group),
        ]
        with m.If(leaves):
            m.d.sync += [group.eq(Mux(row_ends, first, group + 1)), row.eq(row + row_ends), present.eq(~last)]
        with m.If(self.splats.ready & self.splats.valid):
            m.d.sync += [
                present.eq(1), splat.eq(self.splats.payload), row.eq(self.splats.payload.first_y),
                group.eq(self.splats.payload.first_x[GROUP_PLACES:])]
        out = walked.payload
        with m.If(leaves):
            m.d.sync += [walked.valid.eq(1), out.row.eq(row), out.group.eq(group), out.last.eq(last), out.end.eq(splat.end),
                         out.begin.eq(Mux(group == first, splat.first_x[:GROUP_PLACES], 0)),
                         out.stop.eq(Mux(row_ends, splat.last_x[:GROUP_PLACES], LEVEL_GROUP - 1)),
                         *(out.splat[name].eq(splat[name]) for name in _TESTED)]
        with m.Elif(walked.ready):
            m.d.sync += walked.valid.eq(0)

    def _cut(self, m: Module, walked: _Stage, cut: _Stage) -> None:
        """Finds where the group's runs stop: at the end of the box, and where the next tile has another code."""
        item, out, codes = walked.payload, cut.payload, [Value.cast(code) for code in self.codes]
        changes = Cat(a != b for a, b in pairwise(codes))
        within = Cat((item.begin <= i) & (i < item.stop) for i in range(LEVEL_GROUP - 1))
        stops = (changes & within) | (1 << item.stop)
        m.d.comb += walked.ready.eq(cut.ready | ~cut.valid)
        passed_on = ("splat", "row", "group", "last", "end", "begin")
        with m.If(walked.ready):
            m.d.sync += cut.valid.eq(walked.valid)
            with m.If(walked.valid):
                m.d.sync += [*(out[name].eq(item[name]) for name in passed_on), out.codes.eq(self.codes),
                             out.stops.eq(Mux(item.end, 1, stops)),
                             out.tile.eq(self.row_start + (item.group << GROUP_PLACES))]

    def _pick(self, m: Module, cut: _Stage) -> None:
        """Emits one run after the other; each stops at the lowest of the remaining stops."""
        item, runs, free = cut.payload, self.runs, Signal()
        rest, lowest = Signal(LEVEL_GROUP), Signal(LEVEL_GROUP)
        passed_on = ("splat", "row", "group", "tile", "begin", "end")
        place = Cat(Cat(lowest[i] for i in range(LEVEL_GROUP) if i >> k & 1).any() for k in range(GROUP_PLACES))
        code = reduce(or_, (Mux(lowest[i], Value.cast(item.codes[i]), 0) for i in range(LEVEL_GROUP)))
        m.d.comb += [
            lowest.eq(Cat(item.stops[i] & ~item.stops[:i].any() for i in range(LEVEL_GROUP))),  # trees, no borrow chain
            rest.eq(item.stops & ~lowest),
            free.eq(runs.ready | ~runs.valid),
            cut.ready.eq(free & (rest == 0)),
        ]
        with m.If(free):
            m.d.sync += runs.valid.eq(cut.valid)
            with m.If(cut.valid):
                m.d.sync += [*(runs.payload[name].eq(item[name]) for name in passed_on),
                             runs.payload.stop.eq(place), Value.cast(runs.payload.code).eq(code),
                             runs.payload.last.eq(item.last & (rest == 0))]
        with m.If(free & cut.valid & (rest != 0)):
            m.d.sync += [item.stops.eq(rest), item.begin.eq(place + 1)]
