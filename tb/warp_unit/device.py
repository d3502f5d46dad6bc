"""The warp unit in a test bench that supplies what files of items cannot: the strobe that begins a frame, and a memory that
becomes idle. The bench also reads the tiles one by one when the frame is finished."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal

from rtl.warp_unit.warp_unit import EVENTS, WarpUnit
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.queues import COUNTER_BITS
from spec.records import Field, Record, frame_tiles, pixel_row, tile_index, uint
from spec.stereo import DISPARITY_SCALE_BITS
from tb.common.bench import Bench
from tb.common.framed import frame_by_frame
from tb.common.playback import Playback


def warped_tile(config: AcceleratorConfig) -> Record:
    """Whether a tile of the target eye's frame has holes, as the bench reads it off the unit; one per tile, in tile order."""
    return Record("WarpedTile", warped_tile.__doc__ or "", (
        Field("tile", tile_index(config), "native tile"),
        Field("invalid", uint(1), "holes are left in it: it must be rendered"),
    ))


class WarpBench(Bench):
    """The warp unit, with frames and a memory supplied by `frame_by_frame`.

    `tiles` gives the first `tile_count` bits of the mask after the frame is finished.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"rows": pixel_row(config)}, {"writes": write_request(config), "tiles": warped_tile(config)},
            {"width": 14, "height": 14, "source_right": 1, "disparity_scale": DISPARITY_SCALE_BITS,
             "target_frame_base": BEAT_BITS, "tile_count": frame_tiles(config).bit_length(), "frame": 8},
            {**dict.fromkeys(EVENTS, COUNTER_BITS), "finished": 1, "busy": 1, "early": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = WarpUnit(self.config)
        self.join(m, unit)
        frame_by_frame(m, self, unit)
        self._tiles(m, unit)
        return m

    def _tiles(self, m: Module, unit: WarpUnit) -> None:
        """Reads the bits of the mask, one tile every three cycles."""
        tile, asked, known = Signal(range(frame_tiles(self.config) + 1)), Signal(), Signal()
        m.d.comb += [
            unit.tile.eq(tile), self.tiles.valid.eq(known), self.tiles.payload.tile.eq(tile)]
        with m.If(known):
            with m.If(self.tiles.ready):
                m.d.sync += [known.eq(0), tile.eq(tile + 1)]
        with m.Elif(asked):
            m.d.sync += [asked.eq(0), known.eq(1), self.tiles.payload.invalid.eq(unit.invalid)]
        with m.Else():
            m.d.sync += asked.eq(unit.finished & (tile != self.tile_count))
        with m.If(unit.begin):
            m.d.sync += [tile.eq(0), asked.eq(0), known.eq(0)]


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return WarpBench(config).playback(f"warp-{config.warp_lanes}-{config.cores_x}", "warp_bench")
