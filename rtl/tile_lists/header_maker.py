"""Makes the tile headers, which the array and the splat fetch unit need before a tile's intersections."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.tile_lists.beats import check_config, read_port
from rtl.tile_lists.tile_settings import BEAT_TILES, TileSettings, connect_mask, mask_port
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS
from spec.queues import HEADER_TILES, HEADERS
from spec.records import COUNT_BITS, frame_tiles, tile_group, tile_header, tile_use


def waiting_tiles(config: AcceleratorConfig) -> int:
    """Number of tiles that may wait in the header maker: two rows of tiles, and HEADER_TILES more.

    The list reader gets a tile only if this unit takes it, too. The array's next tile comes only when its whole group, which is
    at most a row of tiles, has been read and sorted. So this unit must take at least that many tiles before its outputs move.
    """
    return 2 * -(-config.row_width // TILE) + HEADER_TILES


class HeaderMaker(wiring.Component):
    """Makes TileHeader and TileUse items from the counts of the tile merge unit and the host's table, both in tile order.

    Parameters:
        config: the machine; `row_width` and the plane's format matter here.

    Ports:
        tiles: TileGroup items of every tile of a frame, in order. `waiting_tiles` of them are taken even if no other port
        moves. tiles_base, tiles_x, tile_count: the table's first beat; the number of tiles in a row and in the frame; stable
        during a
            frame.
        reads, data: read port of memory; a beat holds four tiles and is requested when the first of them comes.
        headers: TileHeader items, one per tile; up to 16 headers whose TileUse has left may wait in the unit.
        levels: TileUse items, one per tile.
        clear: strobe: resets `error`.
        error: memory answered with an error. The items of such beats are undefined, but are passed on.

    With stereo, tiles that are not rendered give neither a header nor a TileUse, and there are more ports:
        target, mask_tile, mask: see `mask_port`.
        done: all tiles of a frame have passed since `clear`.

    Storage: `waiting_tiles` counts, a beat, 16 headers. Throughput: one tile per cycle, for memory latencies of up to about
    `waiting_tiles` cycles. Latency: one cycle from a tile to its beat's request, the latency of memory, and 3 cycles from the
    beat to the header. A frame's first tile is taken only when all beats of the frame before have been requested.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        self.config = config
        tiles = range(frame_tiles(config) + 1)
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_group(config)))),
            "tiles_base": In(BEAT_BITS), "tiles_x": In(tiles), "tile_count": In(tiles),
            **read_port(config),
            "headers": Out(stream.Signature(layout(tile_header(config)))),
            "levels": Out(stream.Signature(layout(tile_use(config)))),
            "clear": In(1), "error": Out(1),
            **mask_port(config), **({"done": Out(1)} if config.stereo else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        waits = data.StructLayout({"count": COUNT_BITS, "ends": 1})
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=waits.size, depth=waiting_tiles(self.config))
        m.submodules.table = table = TileSettings(self.config)
        wiring.connect(m, wiring.flipped(self.data), table.data)
        with m.If(self.clear):
            m.d.sync += self.error.eq(0)
        with m.Elif(table.failed):
            m.d.sync += self.error.eq(1)
        self._ask(m, waiting, waits)
        self._join(m, waits(waiting.r_data), waiting, table)
        return m

    def _ask(self, m: Module, waiting: SyncFIFOBuffered, waits: data.StructLayout) -> None:
        """Puts tiles into the queue, and requests a beat of the table for every fourth of them."""
        tile = self.tiles.payload
        owed = Signal(range(frame_tiles(self.config) // BEAT_TILES + 2))
        first, taken = tile.tile == 0, Signal()
        into = Signal(waits)
        m.d.comb += [
            into.count.eq(tile.count),
            into.ends.eq(tile.tile == self.tile_count - 1),
            waiting.w_data.eq(into),
            self.tiles.ready.eq(waiting.w_rdy & ~(first & owed.any())),
            taken.eq(self.tiles.valid & self.tiles.ready),
            waiting.w_en.eq(taken),
            self.reads.valid.eq(owed.any()),
        ]
        place = Signal(BEAT_BITS, reset_less=True)
        m.d.comb += self.reads.payload.beat.eq(place)
        asked = self.reads.valid & self.reads.ready
        m.d.sync += owed.eq(owed + (taken & (tile.tile % BEAT_TILES == 0)) - asked)
        with m.If(taken & first):
            m.d.sync += place.eq(self.tiles_base)
        with m.Elif(asked):
            m.d.sync += place.eq(place + 1)

    def _join(self, m: Module, tile: data.View, waiting: SyncFIFOBuffered, table: TileSettings) -> None:
        """Joins a tile with its setting and sends both outputs."""
        m.submodules.levels = levels = Buffer(self.levels.payload.shape())
        m.submodules.headers = headers = SyncFIFOBuffered(width=tile_header(self.config).width, depth=HEADERS)
        wiring.connect(m, levels.source, wiring.flipped(self.levels))
        setting, header, use = table.settings.payload, Signal(self.headers.payload.shape()), levels.sink.payload
        column, row = Signal.like(header.tile_x), Signal.like(header.tile_y)
        last_column = Signal.like(self.tiles_x, reset_less=True)
        whole, moves = waiting.r_rdy & table.settings.valid, Signal()
        leaves = moves & table.rendered if self.config.stereo else moves
        m.d.comb += [
            moves.eq(whole & headers.w_rdy & levels.sink.ready),
            waiting.r_en.eq(moves), table.settings.ready.eq(moves), table.last.eq(tile.ends),
            headers.w_en.eq(leaves), headers.w_data.eq(header), levels.sink.valid.eq(leaves),
            header.tile_x.eq(column), header.tile_y.eq(row),
            header.outer.eq(setting.level != 0), header.blend.eq(setting.blend), header.plane.eq(setting.plane),
            header.count.eq(tile.count),
            use.level.eq(setting.level), use.blend.eq(setting.blend), use.count.eq(tile.count),
            self.headers.valid.eq(headers.r_rdy), self.headers.payload.as_value().eq(headers.r_data),
            headers.r_en.eq(self.headers.ready),
        ]
        m.d.sync += last_column.eq(self.tiles_x - 1)  # stable when the first tile is taken, so before the first header
        with m.If(moves):
            row_ends = column == last_column
            m.d.sync += column.eq(Mux(row_ends | tile.ends, 0, column + 1))
            m.d.sync += row.eq(Mux(tile.ends, 0, row + row_ends))
        if self.config.stereo:
            connect_mask(m, self, table)
            with m.If(self.clear):
                m.d.sync += self.done.eq(0)
            with m.Elif(moves & tile.ends):
                m.d.sync += self.done.eq(1)
