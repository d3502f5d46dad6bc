"""The on-chip table of the levels of a frame's tiles, from which sixteen tiles of a row are read at a time."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, Value, unsigned
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.queues import LEVEL_GROUP
from spec.records import TILE_BITS, tile_index, tile_level

GROUP_PLACES = LEVEL_GROUP.bit_length() - 1


def code_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The code of a tile, which the table holds: its TileLevel without the tile's number."""
    return data.StructLayout({
        f.name: unsigned(f.format.width) for f in tile_level(config).fields if f.name in ("level", "blend", "rendered")})


class LevelTable(wiring.Component):
    """A table that is filled in tile order once per frame, and then read.

    Parameters:
        config: the machine; `row_width` matters here.

    Ports:
        table: TileLevel items, one per tile, row-major; their field `tile` is ignored. They are taken until all tiles of the
            frame have come.
        filled: all tiles of the frame have come.
        clear: strobe: the frame is over, and the next frame's items may come.
        tiles_x, tiles_y: columns and rows of tiles of the frame.
        enable, row, group: reads the tiles 16 group, 16 group + 1, ... of a tile row.
        codes: the codes of these tiles, a cycle after `enable`; they stay until the next read. The codes of tiles beyond the
            end of the row are undefined.
        row_start: the number of the row's first tile, with the same timing. It is stored to save a multiplier.

    Throughput: one write or read of the table per cycle. Latency: one cycle from `enable` to `codes`. Storage: a memory with a
    word of 48 bits (64 with stereo) for 16 tiles, and a memory with a tile number for each row; for PAPER 960 and 120 words.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        widest = -(-config.row_width // TILE)
        self._code, self._rows, self._groups = code_layout(config), widest, 1 << ((widest - 1) >> GROUP_PLACES).bit_length()
        super().__init__({
            "table": In(stream.Signature(layout(tile_level(config)))),
            "filled": Out(1),
            "clear": In(1),
            "tiles_x": In(TILE_BITS + 1),
            "tiles_y": In(TILE_BITS + 1),
            "enable": In(1),
            "row": In(TILE_BITS),
            "group": In(TILE_BITS - GROUP_PLACES),
            "codes": Out(data.ArrayLayout(code_layout(config), LEVEL_GROUP)),
            "row_start": Out(tile_index(config).width),
        })

    def _address(self, row: Signal, group: Signal) -> Value:
        return Cat(group[: (self._groups - 1).bit_length()], row)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.words = words = memory.Memory(
            shape=data.ArrayLayout(self._code, LEVEL_GROUP), depth=self._rows * self._groups, init=[])
        m.submodules.starts = starts = memory.Memory(shape=self.row_start.shape(), depth=self._rows, init=[])
        write, read = words.write_port(granularity=1), words.read_port()
        write_start, read_start, tile = starts.write_port(), starts.read_port(), Signal.like(self.row_start)
        row, column, item = Signal(TILE_BITS), Signal(TILE_BITS), self.table.payload
        last_column, last_row = column + 1 == self.tiles_x, row + 1 == self.tiles_y
        taken = self.table.valid & self.table.ready
        m.d.comb += [
            self.table.ready.eq(~self.filled),
            write.addr.eq(self._address(row, column[GROUP_PLACES:])),
            write.en.eq(taken << column[:GROUP_PLACES]),
            read.en.eq(self.enable),
            read.addr.eq(self._address(self.row, self.group)),
            self.codes.eq(read.data),
            write_start.addr.eq(row),
            write_start.en.eq(taken & (column == 0)),
            write_start.data.eq(tile),
            read_start.addr.eq(self.row),
            read_start.en.eq(self.enable),
            self.row_start.eq(read_start.data),
        ]
        for code in write.data:
            for name in self._code.members:
                m.d.comb += code[name].eq(item[name])
        with m.If(taken):
            m.d.sync += [column.eq(column + 1), tile.eq(tile + 1)]
            with m.If(last_column):
                m.d.sync += [column.eq(0), row.eq(row + 1)]
                with m.If(last_row):
                    m.d.sync += [row.eq(0), tile.eq(0), self.filled.eq(1)]
        with m.If(self.clear):
            m.d.sync += self.filled.eq(0)
        return m
