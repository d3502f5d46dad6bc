"""The tile test of one phase, in machines whose phases overlap."""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Const, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.shared_datapath import DatapathSide, SharedDatapath
from rtl.culling.tile_columns import row_columns
from rtl.supertiles.box_steps import BoxSteps, carried_step
from rtl.supertiles.group_walk import GroupWalk
from rtl.supertiles.level_table import axis_bits, group_bits, levels_layout
from rtl.supertiles.mask_expand import MaskExpand
from rtl.supertiles.pair_expand import PairExpand
from rtl.supertiles.tile_test import SuperTileTest
from spec.config import AcceleratorConfig
from spec.constants import SUPER_Y


def level_ports(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The read port of a `SuperLevelTable` as its reader has it, and whether the table is full."""
    return {"filled": In(1), "enable": Out(1), "row": Out(axis_bits(config)), "group": Out(group_bits(config)),
            "levels": In(levels_layout()), **({"eye": Out(1)} if config.joint else {})}


def ellipse_shared(config: AcceleratorConfig) -> SharedDatapath:
    """The datapath of the ellipse tests of both phases."""
    return SharedDatapath(row_columns(config, SUPER_Y), interval=config.point_interval, carried=carried_step(config))


class PhaseTileTest(SuperTileTest):
    """`SuperTileTest` with the parts of one phase alone. The levels of tiles are in a table elsewhere, and the datapath of the
    ellipse test is shared with that of the other phase.

    Parameters:
        config: the machine, with overlapped phases.
        second: whether it serves the second phase.
        side: its side of `ellipse_shared`.

    Ports:
        splats, width, height, obb, busy, clear: as in `SuperTileTest`.
        pairs, touched, filtered, entries, survivors_count: only for the first phase. survivors: only for the second.
        enable, row, group, levels, filled: `level_ports`.
        joint, shift: with joint frames, as in `SuperTileTest`. ready, eye: with joint frames, for the first phase as there,
            and as in `level_ports`.

    Throughput and latency: those of `SuperTileTest`.
    """

    def __init__(self, config: AcceleratorConfig, *, second: bool, side: DatapathSide) -> None:
        self._second = second
        super().__init__(config, side)
        if not config.overlap:
            raise ValueError(f"overlap must be True, not {config.overlap!r}")

    def _members(self, config: AcceleratorConfig) -> dict[str, wiring.Member]:
        members = super()._members(config)
        kept = ("splats", "width", "height", "obb", "busy", "clear", *(("joint", "shift") if config.joint else ()), *(
            ("survivors",) if self._second else ("pairs", "touched", "filtered", "entries", "survivors_count",
                                                 *(("ready",) if config.joint else ()))))
        return {**{name: members[name] for name in kept}, **level_ports(config)}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.steps = steps = BoxSteps(self.config)
        self._inside = Signal(name="inside")
        ellipse: Any = self._ellipse
        m.submodules.walk = walk = GroupWalk(self.config)
        m.d.comb += [
            self.enable.eq(walk.enable), self.row.eq(walk.row), self.group.eq(walk.group), walk.levels.eq(self.levels),
            walk.obb.eq(self.obb), ellipse.width.eq(self.width), ellipse.height.eq(self.height)]
        if self.config.joint:
            m.d.comb += self.eye.eq(walk.eye)
        self._test(m, steps, walk)
        if self._second:
            m.submodules.masks = masks = MaskExpand(self.config)
            self._enter(m, steps, walk, Const(1), (masks,), (self.survivors.valid,))
            wiring.connect(m, walk.groups, masks.groups)
            wiring.connect(m, masks.survivors, wiring.flipped(self.survivors))
            if self.config.joint:
                m.d.comb += self.busy.eq(self._inside)
            return m
        m.submodules.expand = expand = PairExpand(self.config)
        self._enter(m, steps, walk, Const(0), (expand,), (expand.busy, self.pairs.valid))
        self._sizes(m, None, expand)
        wiring.connect(m, walk.groups, expand.groups)
        if self.config.joint:
            self._unite(m, expand)
        else:
            wiring.connect(m, expand.pairs, wiring.flipped(self.pairs))
        self._tally(m, walk.groups.payload, expand.groups.valid & expand.groups.ready, expand)
        return m
