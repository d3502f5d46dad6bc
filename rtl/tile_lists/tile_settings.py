"""Unpacks beats of the host's table of tiles into one tile per cycle."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import check_config
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES, TILE_SETTING_BYTES, check_memory, read_data, tile_setting
from spec.records import tile_index

BEAT_TILES = BEAT_BYTES // TILE_SETTING_BYTES
"""Tiles in a beat of the table."""


def mask_port(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The ports by which units with TileSettings learn which tiles are rendered; only machines with stereo have them.

    target: this is the pass of the target eye. mask_tile: number of a tile. mask: the tile has holes that were not filled; it
    is valid a cycle after `mask_tile`.
    """
    return {"target": In(1), "mask_tile": Out(tile_index(config).width), "mask": In(1)} if config.stereo else {}


class TileSettings(wiring.Component):
    """Unpacks beats of the table into TileSetting items, in order. The last beat of a frame may be used only in part.

    Parameters:
        config: the machine; the plane's format matters here.

    Ports:
        data: beats of the table, in order.
        settings: TileSetting items.
        last: the item taken in this cycle is the last one of its frame, so the rest of its beat is dropped.
        failed: strobe: the beat taken in this cycle is an error. Its items are undefined, but are passed on.

    With stereo:
        target, mask_tile, mask: see `mask_port`.
        rendered: the tile of the offered item is rendered. All tiles are, except tiles of the target eye that may be warped and
            have no holes left.

    Storage: one beat. Throughput: one item per cycle, without gaps between beats. Latency: one cycle.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        check_memory(config)
        self.config = config
        super().__init__({
            "data": In(stream.Signature(layout(read_data(config)))),
            "settings": Out(stream.Signature(layout(tile_setting(config)))),
            "last": In(1), "failed": Out(1),
            **mask_port(config), **({"rendered": Out(1)} if config.stereo else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        width, size = tile_setting(self.config).width, 8 * TILE_SETTING_BYTES
        items = Signal(data.ArrayLayout(width, BEAT_TILES), reset_less=True)
        left, valid = Signal(range(BEAT_TILES)), Signal()
        beat = self.data.payload.word.as_value()
        uses_up = ~left.any() | self.last
        m.d.comb += [
            self.settings.valid.eq(valid),
            self.settings.payload.as_value().eq(items[0]),
            self.data.ready.eq(~valid | self.settings.ready & uses_up),
            self.failed.eq(self.data.valid & self.data.ready & self.data.payload.error),
        ]
        with m.If(self.data.ready):
            m.d.sync += [valid.eq(self.data.valid), left.eq(BEAT_TILES - 1)]
            m.d.sync += items.eq(Cat(beat[size * i : size * i + width] for i in range(BEAT_TILES)))
        with m.Elif(self.settings.ready):
            m.d.sync += [items.as_value().eq(items.as_value() >> width), left.eq(left - 1)]
        if self.config.stereo:
            self._look_up(m)
        return m

    def _look_up(self, m: Module) -> None:
        """Addresses the mask with the tile that is offered in the next cycle, so that the answer comes with the item."""
        tile = Signal.like(self.mask_tile)
        with m.If(self.settings.valid & self.settings.ready):
            m.d.comb += self.mask_tile.eq(Mux(self.last, 0, tile + 1))
        with m.Else():
            m.d.comb += self.mask_tile.eq(tile)
        m.d.sync += tile.eq(self.mask_tile)
        m.d.comb += self.rendered.eq(~self.target | ~self.settings.payload.warp | self.mask)


def connect_mask(m: Module, unit: wiring.Component, table: TileSettings) -> None:
    """Connects the `mask_port` of a unit to that of its TileSettings."""
    m.d.comb += [table.target.eq(unit.target), table.mask.eq(unit.mask), unit.mask_tile.eq(table.mask_tile)]
