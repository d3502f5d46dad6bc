"""Cuts the boxes of splats that are projected again to the super-tiles of their pairs."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import payload_register
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y
from spec.joint import EYES
from spec.records import COUNT_BITS, TILE_BITS, projected_splat
from spec.supertiles import check_supertiles, supertile

_PLACES = {"x": SUPER_X.bit_length() - 1, "y": SUPER_Y.bit_length() - 1}
"""Bits of a tile's column and row in its super-tile."""


def clip_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A super-tile as the clip of a machine with a warp unit takes it: where it lies, how many pairs it has, whether each of
    them has two splats, and which tiles of source and target the sweep renders."""
    return data.StructLayout({"x": TILE_BITS, "y": TILE_BITS, "pairs": COUNT_BITS, "both": 1,
                              "wanted": data.ArrayLayout(SUPER_TILES, EYES)})


class SuperTileClip(wiring.Component):
    """In the second phase, gives every splat the part of its box that lies in the super-tile of its pair. In the first phase
    splats pass unchanged.

    In machines with joint frames the columns of boxes are those of joint super-tiles. A splat of a joint frame need not touch
    the super-tile in both eyes: where its box lies beside it, or the splat has `none` already, the whole super-tile becomes its
    box, and `none` is set.

    Parameters:
        config: the machine, with super-tiles.

    Ports:
        splats: ProjectedSplat items; in the second phase those of pairs, super-tile by super-tile.
        supertiles: SuperTile items in the same order, of which only `x`, `y` and `pairs` matter. Each holds for as many splats
            as it has pairs, and is taken before the first of them. In joint frames the item of the source holds for twice as
            many, and that of the target is taken without effect.
        clipped: ProjectedSplat items, in order. A box always has a tile in its super-tile, because its splat has an
            intersection there.
        rendering: the phase is the second one; changes only while the unit is empty.
        busy: a splat is inside.
        joint: setting; only machines with joint frames have it.

    In machines with a warp unit (`spec.joint_warp`) `supertiles` has `clip_layout` items, one for each super-tile, which also
    say for how many splats it holds, and `clipped` gets the tiles that the sweep renders in the splat's eye.

    Throughput: one splat a cycle, also where the super-tile changes; a super-tile without pairs takes a cycle, in which no
    splat is taken. Latency: one cycle; and one cycle from a super-tile to its first splat where the unit had no pairs left.
    Here the super-tiles A, B and C have 2, 0 and 1 pairs::

        cycle               0     1     2     3     4     5
        supertiles        < A  >< B        >< C  >
        supertiles.ready  ~~~~~~______~~~~~~~~~~~~~~~~~~~~~~
        splats                  < a0 >< a1 >< c0       >
        splats.ready      ______~~~~~~~~~~~~______~~~~~~____
        clipped                       < a0 >< a1 >      < c0 >
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self._joint, self._warps = config.joint, config.warps_joint
        taken = clip_layout(config) if config.warps_joint else layout(supertile(config))
        splats = stream.Signature(layout(projected_splat(config)))
        super().__init__({
            "splats": In(splats), "supertiles": In(stream.Signature(taken)), "clipped": Out(splats),
            "rendering": In(1), "busy": Out(1), **({"joint": In(1)} if config.joint else {})})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        left, final, taken = Signal(COUNT_BITS + self._joint), Signal(), Signal()  # left: the super-tile's splats to come
        start = {axis: Signal(TILE_BITS, name=f"start_{axis}", reset_less=True) for axis in "xy"}
        out, item, tile = self.clipped, self.splats.payload, self.supertiles.payload
        clipped = payload_register(m, out)
        m.d.comb += [
            final.eq(left == 1),
            self.splats.ready.eq((~out.valid | out.ready) & (~self.rendering | left.any())),
            taken.eq(self.splats.valid & self.splats.ready),
            self.supertiles.ready.eq(self.rendering & (~left.any() | taken & final)),
            self.busy.eq(out.valid),
        ]
        with m.If(out.ready):
            m.d.sync += out.valid.eq(0)
        with m.If(taken):
            m.d.sync += [out.valid.eq(1), clipped.eq(item), left.eq(left - self.rendering)]
            for axis, places in _PLACES.items():
                first, last, begin = item[f"first_{axis}"], item[f"last_{axis}"], start[axis][places:]
                with m.If(self.rendering & (first[places:] != begin)):  # the box begins before the super-tile
                    m.d.sync += clipped[f"first_{axis}"].eq(begin << places)
                with m.If(self.rendering & (last[places:] != begin)):  # it ends behind it
                    m.d.sync += clipped[f"last_{axis}"].eq((begin << places) | ((1 << places) - 1))
        begins = self.supertiles.valid & self.supertiles.ready
        if self._joint:
            self._miss(m, item, clipped, taken, start)
        if self._warps:
            wanted = Signal(tile.wanted.shape(), reset_less=True)
            with m.If(taken):
                m.d.sync += clipped.wanted.eq(Mux(item.eye, wanted[1], wanted[0]))
            with m.If(begins):
                m.d.sync += wanted.eq(tile.wanted)
        elif self._joint:
            m.d.comb += self.supertiles.ready.eq(self.rendering & (tile.eye | ~left.any() | taken & final))
            begins &= ~tile.eye
        with m.If(begins):
            twice = tile.both if self._warps else self.joint if self._joint else None
            pairs = tile.pairs if twice is None else tile.pairs << twice
            m.d.sync += [left.eq(pairs), start["x"].eq(tile.x), start["y"].eq(tile.y)]
        return m

    def _miss(self, m: Module, item: data.View, clipped: data.View, taken: Value, start: dict[str, Signal]) -> None:
        """Gives splats without a tile in the super-tile a box there, and marks them."""
        places = {axis: (item[f"first_{axis}"][bits:], item[f"last_{axis}"][bits:], start[axis][bits:])
                  for axis, bits in _PLACES.items()}
        beside = Cat((first > begin) | (last < begin) for first, last, begin in places.values()).any()
        with m.If(taken & self.rendering & (item.none | beside)):
            m.d.sync += clipped.none.eq(1)
            for axis, bits in _PLACES.items():
                begin = places[axis][2] << bits
                m.d.sync += [clipped[f"first_{axis}"].eq(begin),
                             clipped[f"last_{axis}"].eq(begin | ((1 << bits) - 1))]
