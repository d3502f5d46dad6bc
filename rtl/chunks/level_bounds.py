"""The level bounds of a frame: for every quality bound, an octagon around the tiles that its splats can touch."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, TILE
from spec.records import TILE_BITS, tile_level

SIDES = ("x", "y", "sum", "difference")
"""What an octagon limits: a tile's column, its row, column + row, column - row."""


def place_bits(config: AcceleratorConfig) -> int:
    """Bits of a tile's column or row in the largest frame."""
    return max(1, (-(-config.row_width // TILE) - 1).bit_length())


def octagon_layout(config: AcceleratorConfig) -> data.StructLayout:
    """An octagon: whether a tile lies in it, and the smallest and the largest value of every side."""
    bits = place_bits(config)
    sides = data.StructLayout({
        "x": unsigned(bits), "y": unsigned(bits), "sum": unsigned(bits + 1), "difference": signed(bits + 1)})
    return data.StructLayout({"present": 1, "least": sides, "most": sides})


class LevelBounds(wiring.Component):
    """Watches the levels of a frame's tiles while they are loaded.

    Parameters:
        config: the machine; `row_width` and `stereo` matter here.

    Ports:
        item: the TileLevel item that passes; its field `tile` is ignored.
        taken: strobe: it passes in this cycle. Items come in the order of tiles, row-major.
        clear: strobe: the next item is the first of another pass. It must come two cycles or more after the last item.
        tiles_x: columns of tiles of the frame.
        other: with joint frames: the item belongs to the other eye, and is not watched.
        bounds: for every quality bound, the octagon around the rendered tiles whose level is at most the bound; without a tile
            only `present` has a meaning.

    Throughput: one item a cycle. Latency: an item is in `bounds` two cycles after it passed::

        cycle       0      1      2      3
        taken       ~~~~~~~_____________________
        item        <  A  >
        found              <  A  >                  x, y, x + y, x - y
        bounds                    <  with A
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self._octagon, self._bits, self._masked, self._joint = (
            octagon_layout(config), place_bits(config), config.two_passes, config.joint)
        super().__init__({
            "item": In(layout(tile_level(config))), "taken": In(1), "clear": In(1), "tiles_x": In(TILE_BITS + 1),
            "bounds": Out(data.ArrayLayout(self._octagon, MAX_LEVELS)), **({"other": In(1)} if config.joint else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        x, y = Signal(self._bits), Signal(self._bits)
        taken = self.taken & ~self.other if self._joint else self.taken
        with m.If(taken):
            m.d.sync += x.eq(x + 1)
            with m.If(x + 1 == self.tiles_x):
                m.d.sync += [x.eq(0), y.eq(y + 1)]
        with m.If(self.clear):
            m.d.sync += [x.eq(0), y.eq(0)]

        found, uses = Signal(self._octagon.members["least"], reset_less=True), Signal(MAX_LEVELS)
        counts = taken & (self.item.rendered if self._masked else 1)
        m.d.sync += [found.x.eq(x), found.y.eq(y), found.sum.eq(x + y), found.difference.eq(x - y)]
        m.d.sync += [uses[bound].eq(counts & (self.item.level <= bound)) for bound in range(MAX_LEVELS)]
        for bound in range(MAX_LEVELS):
            self._update(m, self.bounds[bound], found, uses[bound])
        return m

    def _update(self, m: Module, octagon: data.View, found: data.View, uses: Value) -> None:
        """Widens an octagon by a tile. Rows come in ascending order, so that only the first sets the smallest one."""
        with m.If(uses):
            m.d.sync += [octagon.present.eq(1), octagon.most.y.eq(found.y)]
            with m.If(~octagon.present):
                m.d.sync += octagon.least.y.eq(found.y)
            for side in SIDES:
                if side != "y":
                    least, most, value = octagon.least[side], octagon.most[side], found[side]
                    m.d.sync += [
                        least.eq(Mux(~octagon.present | (value < least), value, least)),
                        most.eq(Mux(~octagon.present | (value > most), value, most))]
        with m.If(self.clear):
            m.d.sync += octagon.present.eq(0)
