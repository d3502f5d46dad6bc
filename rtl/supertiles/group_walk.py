"""Walks through the columns that splats touch, sixteen at a time, and applies the foveation filter to their tiles."""

from __future__ import annotations

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.level_table import GROUP_PLACES
from rtl.stream import payload_register
from rtl.supertiles.box_steps import carried_step
from rtl.supertiles.level_table import ROW_PLACES, axis_bits, group_bits, levels_layout, row_bits
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_Y
from spec.queues import LEVEL_GROUP


def halves_layout() -> data.StructLayout:
    """Of a row of tiles in a machine with streams: whether the ellipse misses the left half of the first column, whether it
    misses the right half of the last one, and whether it reaches into the upper and into the lower half of the row."""
    return data.StructLayout({"no_left": 1, "no_right": 1, "upper": 1, "lower": 1})


def tested_step(config: AcceleratorConfig) -> data.StructLayout:
    """A step of a box with the result of the ellipse test: for each tile row first and last column, and whether the ellipse
    meets none of its pixels; with streams, `halves` as well."""
    columns = data.ArrayLayout(axis_bits(config), SUPER_Y)
    return data.StructLayout({
        "first": columns, "last": columns, "none": SUPER_Y, "carried": carried_step(config), **_halves(config)})


def _halves(config: AcceleratorConfig) -> dict[str, data.ArrayLayout]:
    return {"halves": data.ArrayLayout(halves_layout(), SUPER_Y)} if config.streams > 1 else {}


def tested_group(config: AcceleratorConfig) -> data.StructLayout:
    """A group of columns of a step: for each tile, by row and column, whether the splat touches it, and whether the filter
    passes this intersection; and the levels of those that pass. `row` is the super-row of the first tile row, and `astride`
    says that the second one lies in the next. `closes` marks the step's last group, `last` the splat's. With streams,
    `quarters` has the tiles of which the splat touches each quarter, if they pass. With a warp unit, `level` is that of each
    tile, because a sweep may leave out some. An item with `end` is no group."""
    tiles = data.ArrayLayout(LEVEL_GROUP, SUPER_Y)
    quarters = {"quarters": data.ArrayLayout(tiles, config.streams)} if config.streams > 1 else {}
    return data.StructLayout({
        "row": unsigned(row_bits(config)), "astride": 1, "group": unsigned(group_bits(config)), "touched": tiles,
        "passed": tiles, "levels": MAX_LEVELS, "closes": 1, "last": 1, "end": 1, **quarters,
        **({"level": data.ArrayLayout(data.ArrayLayout(2, LEVEL_GROUP), SUPER_Y)} if config.warps_joint else {})})


class GroupWalk(wiring.Component):
    """Cuts the columns that a splat touches in a step into groups, and reads the levels of their tiles.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        steps: `tested_step` items.
        groups: `tested_group` items, for each step by column, at least one for each.
        enable, row, group, levels: the read port of `SuperLevelTable`.
        obb: all tiles of a box are touched, whatever the ellipse test found.
        eye: with joint frames, of whose tiles the levels are read; the columns of steps are those of joint super-tiles.

    Throughput: one group a cycle, without gaps between steps; a step in which the splat touches no tile takes a cycle, too.
    Latency: 4 cycles, one for each stage: the columns, cut to the box; the walk, which addresses the table; the answer of the
    table; the output register.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._config = config
        super().__init__({
            "steps": In(stream.Signature(tested_step(config))),
            "groups": Out(stream.Signature(tested_group(config))),
            "enable": Out(1),
            "row": Out(axis_bits(config)),
            "group": Out(group_bits(config)),
            "levels": In(levels_layout()),
            "obb": In(1),
            **({"eye": Out(1)} if config.joint else {}),
        })
        columns = data.ArrayLayout(axis_bits(config), SUPER_Y)
        self._cut_layout = data.StructLayout({
            "first": columns, "last": columns, "met": SUPER_Y, "row": axis_bits(config), "bound": 2, "last_step": 1, "end": 1,
            **_halves(config), **({"eye": 1} if config.joint else {})})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        cut, walked = (Signal(self._cut_layout, name=name, reset_less=True) for name in ("cut", "walked"))
        cut_valid, walked_valid, cut_leaves, leaves, free = (
            Signal(name=name) for name in ("cut_valid", "walked_valid", "cut_leaves", "leaves", "free"))
        group, final = Signal(group_bits(self._config), reset_less=True), Signal(group_bits(self._config), reset_less=True)
        with m.If(self.steps.ready):
            m.d.sync += cut_valid.eq(self.steps.valid)
            with m.If(self.steps.valid):
                self._cut(m, cut)
        begin, end = self._groups(cut)
        ends = group == final
        m.d.comb += [
            self.steps.ready.eq(~cut_valid | cut_leaves),
            cut_leaves.eq(cut_valid & (~walked_valid | leaves & ends)),
            leaves.eq(walked_valid & free),
            self.enable.eq(leaves), self.row.eq(walked.row), self.group.eq(group),
        ]
        if self._config.joint:
            m.d.comb += self.eye.eq(walked.eye)
        with m.If(leaves):
            m.d.sync += [group.eq(group + 1), walked_valid.eq(~ends)]
        with m.If(cut_leaves):
            m.d.sync += [walked.eq(cut), walked_valid.eq(1), group.eq(begin), final.eq(end)]
        self._test(m, walked, group, ends, leaves, free)
        return m

    def _cut(self, m: Module, cut: data.View) -> None:
        """The columns of each tile row that lie in the box as well."""
        step, box = self.steps.payload, self.steps.payload.carried
        m.d.sync += [cut.row.eq(box.row), cut.bound.eq(box.bound), cut.last_step.eq(box.last), cut.end.eq(box.end)]
        nothing = box.end
        if self._config.joint:
            m.d.sync += cut.eye.eq(box.eye)
            nothing = box.end | box.none
        for i in range(SUPER_Y):
            first, last = Signal.like(box.first_x, name=f"first_{i}"), Signal.like(box.last_x, name=f"last_{i}")
            m.d.comb += [first.eq(Mux(~self.obb & (step.first[i] > box.first_x), step.first[i], box.first_x)),
                         last.eq(Mux(~self.obb & (step.last[i] < box.last_x), step.last[i], box.last_x))]
            m.d.sync += [cut.first[i].eq(first), cut.last[i].eq(last),
                         cut.met[i].eq(box.inside[i] & ~nothing & (self.obb | ~step.none[i] & (first <= last)))]
            if self._config.streams > 1:
                halves = step.halves[i]
                m.d.sync += [  # columns that the box cuts off have halves that are not looked at
                    cut.halves[i].no_left.eq(halves.no_left & ~self.obb & (step.first[i] >= box.first_x)),
                    cut.halves[i].no_right.eq(halves.no_right & ~self.obb & (step.last[i] <= box.last_x)),
                    cut.halves[i].upper.eq(halves.upper | self.obb), cut.halves[i].lower.eq(halves.lower | self.obb)]

    def _groups(self, cut: data.View) -> tuple[Value, Value]:
        """The first and the last group of a step; any one group where no tile is touched."""
        assert SUPER_Y == 2
        low = [cut.first[i][GROUP_PLACES:] for i in range(SUPER_Y)]
        high = [cut.last[i][GROUP_PLACES:] for i in range(SUPER_Y)]
        begin = Mux(cut.met[0] & (~cut.met[1] | (low[0] < low[1])), low[0], low[1])
        end = Mux(cut.met[0] & (~cut.met[1] | (high[0] > high[1])), high[0], high[1])
        return begin, Mux(cut.met.any(), end, begin)

    def _test(self, m: Module, walked: data.View, group: Signal, ends: Value, leaves: Signal, free: Signal) -> None:
        """The tiles of a group, then their levels, and what passes."""
        out, tiles = self.groups, data.ArrayLayout(LEVEL_GROUP, SUPER_Y)
        read, valid = Signal(data.StructLayout({
            "row": out.payload.row.shape(), "astride": 1, "group": group.shape(), "touched": tiles, "bound": 2, "closes": 1,
            "last": 1, "end": 1,
            **({"left": tiles, "right": tiles, **_halves(self._config)} if self._config.streams > 1 else {}),
        }), reset_less=True), Signal()
        moves, found = Signal(), payload_register(m, out)
        m.d.comb += [moves.eq(~out.valid | out.ready), free.eq(~valid | moves)]
        with m.If(free):
            m.d.sync += valid.eq(leaves)
        with m.If(leaves):
            m.d.sync += [
                read.row.eq(walked.row[ROW_PLACES:]), read.astride.eq(walked.row[:ROW_PLACES].any()), read.group.eq(group),
                read.bound.eq(walked.bound), read.closes.eq(ends), read.last.eq(ends & walked.last_step),
                read.end.eq(walked.end),
                *(read.touched[i].eq(_between(walked.first[i], walked.last[i], group) & walked.met[i].replicate(LEVEL_GROUP))
                  for i in range(SUPER_Y))]
            if self._config.streams > 1:
                m.d.sync += read.halves.eq(walked.halves)
                m.d.sync += [side[i].eq(~(_at(columns[i], group) & halves.replicate(LEVEL_GROUP)))
                             for i in range(SUPER_Y) for side, columns, halves in (
                                 (read.left, walked.first, walked.halves[i].no_left),
                                 (read.right, walked.last, walked.halves[i].no_right))]
        passed = [Cat(read.touched[i][k] & (self.levels[i][k] <= read.bound) for k in range(LEVEL_GROUP))
                  for i in range(SUPER_Y)]
        levels = (reduce(or_, (passed[i][k] & (self.levels[i][k] == level)
                               for i in range(SUPER_Y) for k in range(LEVEL_GROUP))) for level in range(MAX_LEVELS))
        with m.If(moves):
            m.d.sync += out.valid.eq(valid)
        with m.If(moves & valid):
            m.d.sync += [
                *(found[name].eq(read[name]) for name in (
                    "row", "astride", "group", "touched", "closes", "last", "end")),
                *(found.passed[i].eq(passed[i]) for i in range(SUPER_Y)), found.levels.eq(Cat(*levels))]
            if self._config.warps_joint:
                m.d.sync += [found.level[i][k].eq(self.levels[i][k]) for i in range(SUPER_Y) for k in range(LEVEL_GROUP)]
            for q in range(self._config.streams if self._config.streams > 1 else 0):
                for i in range(SUPER_Y):
                    rows, columns = read.halves[i]["lower" if q >> 1 else "upper"], read["right" if q & 1 else "left"][i]
                    m.d.sync += found.quarters[q][i].eq(passed[i] & columns & rows.replicate(LEVEL_GROUP))


def _between(first: Value, last: Value, group: Value) -> Value:
    """A bit for each column of a group: whether it lies from `first` to `last`."""
    begin, end = first[:GROUP_PLACES], last[:GROUP_PLACES]
    before, after = first[GROUP_PLACES:] < group, last[GROUP_PLACES:] > group
    starts, stops = first[GROUP_PLACES:] == group, last[GROUP_PLACES:] == group
    return Cat((before | starts & (begin <= k)) & (after | stops & (end >= k)) for k in range(LEVEL_GROUP))


def _at(column: Value, group: Value) -> Value:
    """A bit for each column of a group: whether it is this one."""
    here = column[GROUP_PLACES:] == group
    return Cat(here & (column[:GROUP_PLACES] == k) for k in range(LEVEL_GROUP))
