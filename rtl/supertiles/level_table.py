"""The on-chip table of the levels of a frame's tiles, from which sixteen columns of two rows are read at a time."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.frame import setting_ports
from rtl.culling.level_table import GROUP_PLACES
from rtl.shapes import layout
from rtl.supertiles.eyes import origin_of
from spec.config import AcceleratorConfig
from spec.constants import SUPER_Y, TILE
from spec.joint import SHIFT_MOST
from spec.queues import LEVEL_GROUP
from spec.records import TILE_BITS, tile_level

ROW_PLACES = SUPER_Y.bit_length() - 1
"""Bits of a tile's row in its super-tile."""


def axis_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of a column or row of tiles, enough for two groups of columns; with joint frames enough for the
    columns of joint super-tiles."""
    return max((-(-config.row_width // TILE) + SHIFT_MOST * config.joint - 1).bit_length(), GROUP_PLACES + 1)


def row_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of a super-row."""
    return axis_bits(config) - ROW_PLACES


def group_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of a group of LEVEL_GROUP columns."""
    return axis_bits(config) - GROUP_PLACES


def levels_layout() -> data.ArrayLayout:
    """The levels of a group's tiles, by row and column."""
    return data.ArrayLayout(data.ArrayLayout(2, LEVEL_GROUP), SUPER_Y)


class SuperLevelTable(wiring.Component):
    """A table that is filled in tile order once per frame, and then read.

    Parameters:
        config: the machine; `row_width` matters here.

    Ports:
        table: TileLevel items, one per tile, row-major, of which only `level` matters. They are taken until all tiles of the
            frame have come.
        filled: all tiles of the frame have come.
        clear: strobe: the frame is over, and the next frame's items may come.
        tiles_x, tiles_y: columns and rows of tiles of the frame.
        enable, row, group: reads the columns 16 group, 16 group + 1, ... of the tile rows `row` and `row` + 1.
        levels: their levels, a cycle after `enable`; they stay until the next read. Those of tiles beyond the frame are
            undefined.

    With joint frames:
        joint, shift: settings. In joint frames the source's items are followed by the target's, and columns are those of joint
            super-tiles.
        eye: of whose tiles the levels are read.

    Throughput: one write or read of the table per cycle. Latency: one cycle from `enable` to `levels`. Storage: for each row of
    a super-tile a memory with a word of 32 bits for 16 tiles; for PAPER's rows 480 words, with joint frames 960.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        assert SUPER_Y == 2
        self._rows, self._groups = axis_bits(config), group_bits(config)
        self._depth = -(-config.row_width // (TILE * SUPER_Y)) << self._groups + config.joint
        self._joint = config.joint
        super().__init__({
            "table": In(stream.Signature(layout(tile_level(config)))),
            "filled": Out(1),
            "clear": In(1),
            "tiles_x": In(TILE_BITS + 1),
            "tiles_y": In(TILE_BITS + 1),
            "enable": In(1),
            "row": In(self._rows),
            "group": In(self._groups),
            "levels": Out(levels_layout()),
            **({**setting_ports(config, ("joint", "shift")), "eye": In(1)} if config.joint else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        row, column, item = Signal(TILE_BITS), Signal(TILE_BITS), self.table.payload
        taken = self.table.valid & self.table.ready
        odd, rows = Signal(), []  # the first row that was read lies in the second memory
        with m.If(self.enable):
            m.d.sync += odd.eq(self.row[0])
        m.d.comb += self.table.ready.eq(~self.filled)
        place, target = column, Signal()
        if self._joint:
            place = Signal(self._groups + GROUP_PLACES)
            m.d.comb += place.eq(column + origin_of(m, self.joint, self.shift)(target))
        written, wanted = ((target,), (self.eye,)) if self._joint else ((), ())
        for parity in range(SUPER_Y):
            words = memory.Memory(shape=data.ArrayLayout(2, LEVEL_GROUP), depth=self._depth, init=[])
            m.submodules[f"words_{parity}"] = words
            write, read = words.write_port(granularity=1), words.read_port()
            m.d.comb += [
                write.addr.eq(Cat(*written, place[GROUP_PLACES:][: self._groups], row[ROW_PLACES:])),
                write.en.eq((taken & (row[:ROW_PLACES] == parity)) << place[:GROUP_PLACES]),
                *(level.eq(item.level) for level in write.data),
                read.en.eq(self.enable),
                read.addr.eq(Cat(*wanted, self.group, (self.row + (1 - parity))[ROW_PLACES : self._rows])),
            ]
            rows.append(read.data)
        m.d.comb += [self.levels[0].eq(Mux(odd, rows[1], rows[0])), self.levels[1].eq(Mux(odd, rows[0], rows[1]))]
        with m.If(taken):
            m.d.sync += column.eq(column + 1)
            with m.If(column + 1 == self.tiles_x):
                m.d.sync += [column.eq(0), row.eq(row + 1)]
                with m.If(row + 1 == self.tiles_y):
                    m.d.sync += [row.eq(0), self.filled.eq(1)]
                    if self._joint:
                        m.d.sync += [target.eq(self.joint), self.filled.eq(~self.joint | target)]
        with m.If(self.clear):
            m.d.sync += self.filled.eq(0)
            if self._joint:
                m.d.sync += target.eq(0)
        return m
