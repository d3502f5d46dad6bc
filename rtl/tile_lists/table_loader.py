"""Loads the levels of all tiles from the host's table in memory into the tile test's table."""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import BeatRun, check_config, read_port
from rtl.tile_lists.tile_settings import BEAT_TILES, TileSettings, connect_mask, mask_port
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS
from spec.records import frame_tiles, tile_level


class TableLoader(wiring.Component):
    """Reads a frame's TileSettings once and passes them on as TileLevel items in tile order. In joint frames those of the
    target follow those of the source.

    Parameters:
        config: the machine; `row_width` matters here.

    Ports:
        start: strobe; it must not come while `busy`. Settings are stable from then on.
        tiles_base, tile_count: the table's first beat, and the number of the frame's tiles, 1 or more.
        reads, data: read port of memory; a beat holds four tiles.
        levels: TileLevel items, one per tile.
        busy: high from the cycle after `start` until the last item is taken.
        done: strobe, in the cycle after the last item was taken.
        error: memory answered with an error since `start`. The items of such beats are undefined, but are passed on.

    With stereo:
        target, mask_tile, mask: see `mask_port`.
        rendered_tiles: number of rendered tiles among the items that were taken since `start`.

    With joint frames:
        joint, target_tiles_base: settings, as well; `tile_count` is that of each eye.

    With joint frames and stereo there is neither target nor mask, and:
        stereo: setting: the target's tiles with `warp` are not rendered (in the first sweep of `spec.joint_warp`).

    Throughput: one tile per cycle. Latency: one cycle from a beat to its first item.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        self.config = config
        super().__init__({
            "start": In(1), "tiles_base": In(BEAT_BITS), "tile_count": In(range(frame_tiles(config) + 1)),
            **read_port(config),
            "levels": Out(stream.Signature(layout(tile_level(config)))),
            "busy": Out(1), "done": Out(1), "error": Out(1),
            **(mask_port(config) if config.two_passes else {}), **({"stereo": In(1)} if config.warps_joint else {}),
            **({"rendered_tiles": Out(range((frame_tiles(config) << config.joint) + 1))} if config.stereo else {}),
            **({"joint": In(1), "target_tiles_base": In(BEAT_BITS)} if config.joint else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.beats = beats = BeatRun(self.config, len(self.tile_count))
        m.submodules.table = table = TileSettings(self.config)
        wiring.connect(m, beats.reads, wiring.flipped(self.reads))
        wiring.connect(m, wiring.flipped(self.data), table.data)
        item, setting = self.levels.payload, table.settings.payload
        # `last`: the offered tile is the frame's last one; `before`: the number of the one before that. Both are registers,
        # because the beats' queue is read in the same cycle.
        tile, last = Signal.like(item.tile, reset_less=True), Signal(reset_less=True)
        before = Signal.like(self.tile_count, reset_less=True)
        m.d.sync += before.eq(self.tile_count - 2)
        m.d.comb += [
            beats.start.eq(self.start),
            beats.base.eq(self.tiles_base),
            beats.count.eq((self.tile_count + (BEAT_TILES - 1)) // BEAT_TILES),
            self.levels.valid.eq(table.settings.valid),
            table.settings.ready.eq(self.levels.ready),
            table.last.eq(last),
            item.tile.eq(tile), item.level.eq(setting.level), item.blend.eq(setting.blend),
        ]
        taken = self.levels.valid & self.levels.ready
        m.d.sync += self.done.eq(taken & table.last)
        with m.If(taken):
            m.d.sync += [tile.eq(tile + 1), last.eq(tile == before), self.busy.eq(~table.last)]
        with m.If(self.start):
            m.d.sync += [tile.eq(0), last.eq(self.tile_count == 1), self.busy.eq(1), self.error.eq(0)]
        with m.Elif(table.failed):
            m.d.sync += self.error.eq(1)
        if self.config.stereo:
            if self.config.two_passes:
                connect_mask(m, self, table)
            m.d.comb += item.rendered.eq(table.rendered)
            with m.If(self.start):
                m.d.sync += self.rendered_tiles.eq(0)
            with m.Elif(taken & table.rendered):
                m.d.sync += self.rendered_tiles.eq(self.rendered_tiles + 1)
        if self.config.joint:
            target = self._add_target(m, beats, taken & table.last, [tile.eq(0), last.eq(self.tile_count == 1)])
            if self.config.stereo:
                m.d.comb += table.target.eq(target & self.stereo)
        return m

    def _add_target(self, m: Module, beats: BeatRun, whole: Value, begin: list[Any]) -> Signal:
        """Reads the target's table when the source's is through, and begins with its first tile by `begin`; returns whether the
        items are the target's."""
        again, target = Signal(), Signal()
        m.d.comb += [
            self.levels.payload.eye.eq(target), beats.start.eq(self.start | again),
            beats.base.eq(Mux(target, self.target_tiles_base, self.tiles_base))]
        m.d.sync += again.eq(0)
        with m.If(whole):
            m.d.sync += target.eq(0)
            with m.If(self.joint & ~target):
                m.d.sync += [*begin, target.eq(1), again.eq(1), self.busy.eq(1), self.done.eq(0)]
        return target
