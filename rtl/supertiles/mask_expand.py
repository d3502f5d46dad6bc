"""Gives splats that lie in one super-tile each the mask of its tiles, with streams one for each of their quarters."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import Any

from amaranth.hdl import Cat, Module, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.tile_expand import kept_record
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.group_walk import tested_group
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_X, SUPER_Y
from spec.queues import LEVEL_GROUP
from spec.records import surviving_splat


class MaskExpand(wiring.Component):
    """Makes survivors of splats whose boxes lie in one super-tile, and so in one group, each.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        groups: `tested_group` items, one per splat. None has `end`.
        splats: `kept_record` items, one per splat; each is taken with its group.
        survivors: SurvivingSplat items, one per splat, in order. In machines with a warp unit they have the tiles that the
            splat's `wanted` has, too, and the levels among these.

    Throughput: one splat a cycle. Latency: one cycle.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._config = config
        super().__init__({
            "groups": In(stream.Signature(tested_group(config))),
            "splats": In(stream.Signature(layout(kept_record(config)))),
            "survivors": Out(stream.Signature(layout(surviving_splat(config)))),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.leaving = leaving = Buffer(self.survivors.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.survivors))
        item, kept, survivor = self.groups.payload, self.splats.payload, leaving.sink.payload
        m.d.comb += [
            self.groups.ready.eq(self.splats.valid & leaving.sink.ready),
            self.splats.ready.eq(self.groups.valid & leaving.sink.ready),
            leaving.sink.valid.eq(self.groups.valid & self.splats.valid),
            *self._masks(item, kept, survivor),
            survivor.levels.eq(self._levels(item, kept)),
            *(survivor[name].eq(kept[name]) for name in kept.shape().members if name in survivor.shape().members),
        ]
        return m

    def _masks(self, item: data.View, kept: data.View, survivor: data.View) -> list[Any]:
        """The masks of the super-tile's tiles, one for each stream."""
        wanted = Value.cast(kept.wanted) if self._config.warps_joint else None
        if self._config.streams == 1:
            return [survivor.mask.eq(_kept(Cat(_either(row) for row in item.passed), wanted))]
        return [survivor.mask[q].eq(_kept(Cat(_either(row) for row in item.quarters[q]), wanted))
                for q in range(self._config.streams)]

    def _levels(self, item: data.View, kept: data.View) -> Value:
        """The levels among these tiles."""
        if not self._config.warps_joint:
            return item.levels
        here = [[item.passed[i][k] & kept.wanted[SUPER_X * i + k % SUPER_X] for k in range(LEVEL_GROUP)]
                for i in range(SUPER_Y)]
        return Cat(reduce(or_, (here[i][k] & (item.level[i][k] == level) for i in range(SUPER_Y) for k in range(LEVEL_GROUP)))
                   for level in range(MAX_LEVELS))


def _kept(mask: Value, wanted: Value | None) -> Value:
    """The tiles of a mask that are wanted, where some are not."""
    return mask if wanted is None else mask & wanted


def _either(row: Value) -> Value:
    """The tiles of a group's super-columns, of which only one has any."""
    return reduce(or_, (row[begin : begin + SUPER_X] for begin in range(0, LEVEL_GROUP, SUPER_X)))
