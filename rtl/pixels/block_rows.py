"""Rows of blocks in the format for displays, from the array's rows of pixels.

An array that is narrower than a block gives the rows of a band, `cores_y` rows of a tile, part by part: all rows of the left
part, then all of the next. The parts wait until the right one comes, with which a row is complete::

    cycle        0     1     2     3     4     5     6     7     8         an array of 8 x 4 cores
    rows       <A0 ><B0 ><C0 ><D0 ><A1 ><B1 ><C1 ><D1 >
    block_rows                           < A  >< B  >< C  >< D  >
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.vrc_array.pixel_writer import display_byte
from spec.config import AcceleratorConfig
from spec.memory import DISPLAY_PIXEL_BYTES
from spec.packed import BLOCK_BITS, BLOCK_WIDTH, BLOCKS, block_row
from spec.records import TILE_BITS, pixel_row


class BlockRows(wiring.Component):
    """Converts pixel rows to display pixels and joins them to rows of blocks.

    Parameters:
        config: the machine; `cores_x` and `cores_y` are used.

    Ports:
        rows: PixelRow items. Those of a tile come as the array gives them: band by band, in a band by columns, then by rows.
        block_rows: BlockRow items, the tiles in the same order. Pixels beyond the frame are what the array gave.
        width, height: size of the frame in pixels; stable from a cycle before its first row on, and while `busy`.
        busy: a row is inside, or a part of one.

    Storage: a row, and where the array is narrower than a block, the parts of `cores_y` rows but the last. Throughput: an item
    of `rows` a cycle. Latency: 1 cycle from the last part of a row.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "block_rows": Out(stream.Signature(layout(block_row(config)))),
            "width": In(14), "height": In(14), "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        row, out = self.rows.payload, self.block_rows
        pixels = Cat(self._display(lane) for lane in range(self.config.cores_x))
        whole, completes, waiting = self._join(m, pixels)
        columns = Signal(TILE_BITS, reset_less=True)
        m.d.sync += columns.eq((self.width + BLOCK_WIDTH - 1) >> (BLOCK_WIDTH - 1).bit_length())
        left, y = Signal(14), Cat(row.row, row.tile_y)
        m.d.comb += [
            left.eq(self.width - (row.tile_x << (BLOCK_WIDTH - 1).bit_length())),
            self.rows.ready.eq(~out.valid | out.ready | ~completes), self.busy.eq(out.valid | waiting),
        ]
        with m.If(self.rows.valid & completes & self.rows.ready):
            m.d.sync += [
                out.payload.pixel.eq(whole), out.payload.row.eq(row.row),
                out.payload.inside.eq(Mux(y < self.height, Mux(left < BLOCK_WIDTH, left, BLOCK_WIDTH), 0)),
                out.payload.block.eq(Cat(row.row[2:], (row.tile_y * columns + row.tile_x)[: BLOCK_BITS - 2])),
                *([out.payload.eye.eq(row.eye)] if self.config.joint else []),
            ]
        with m.If(~out.valid | out.ready):
            m.d.sync += out.valid.eq(self.rows.valid & completes)
        return m

    def _display(self, lane: int) -> Value:
        """The DisplayPixel of a lane."""
        row, n = self.rows.payload, self.config.formats
        colour = [display_byte(row.colour[3 * lane + c], n.accumulator) for c in range(3)]
        return Cat(colour, ~display_byte(row.transmittance[lane], n.transmittance))

    def _join(self, m: Module, pixels: Value) -> tuple[Value, Value, Value]:
        """The whole row that an item completes, whether it does, and whether parts of rows wait for others."""
        lanes, row = self.config.cores_x, self.rows.payload
        parts, rows = BLOCK_WIDTH // lanes, self.config.cores_y
        if parts == 1:
            return pixels, Value.cast(1), Value.cast(0)
        part, place = row.column[(lanes - 1).bit_length() :], row.row[: (rows - 1).bit_length()] if rows > 1 else Value.cast(0)
        moves, waiting, kept = self.rows.valid & self.rows.ready, Signal(), []
        for n in range(parts - 1):
            words = [Signal(8 * DISPLAY_PIXEL_BYTES * lanes, name=f"part_{n}_{k}", reset_less=True) for k in range(rows)]
            for k, word in enumerate(words):
                with m.If(moves & (part == n) & (place == k)):
                    m.d.sync += word.eq(pixels)
            kept.append(Array(words)[place])
        with m.If(moves):
            m.d.sync += waiting.eq((part != parts - 1) | (place != rows - 1))
        return Cat(*kept, pixels), part == parts - 1, waiting


assert BLOCKS == 4, "the number of a block ends with the upper two bits of a row's number in its tile"
