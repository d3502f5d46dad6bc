"""Joins the rows of the arrays of several streams: what leaves are the rows of one array, in its order.

Where the regions of two arrays fill a row of a tile, a row of each becomes one of the whole tile::

    cycle        0      1      2      ...    8      9        arrays of 8 x 8 cores
    rows_0   <  A0  ><  A1  ><  A2  >
    rows_1   <  B0  ><  B1  >       < B2 >
    rows_2   <  C0  ><  C0  ><  C0  > ...  <  C0  ><  C1  >
    joined   <A0,B0 ><A1,B1 >       <A2,B2>...<C0,D0 ><C1,D1 >

Otherwise the arrays take turns, block by block.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.records import pixel_row
from spec.supertiles import frame_rows

_PLACE = ("tile_x", "tile_y", "row", "column", "eye")


class RowJoin(wiring.Component):
    """Makes one stream of pixel rows of those of all streams.

    Parameters:
        config: the machine, with several streams.

    Ports:
        rows: PixelRow items of each stream, in the order of its array. All streams have the same tiles in the same order.
        joined: PixelRow items of `spec.supertiles.frame_rows`, in the order of its array.

    Throughput: one row of `joined` a cycle. Latency: none. `valid` of `joined` does not depend on its `ready`; `ready` of a
    stream depends on `valid` of the stream that it is joined with.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if config.streams == 1:
            raise ValueError(f"streams must be more than 1 for this unit, not {config.streams!r}")
        self.config = config
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))).array(config.streams),
            "joined": Out(stream.Signature(layout(pixel_row(frame_rows(config)))))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        width, out = frame_rows(self.config).cores_x, self.joined
        row = Signal(range(TILE * TILE // width))  # of the tile, in the order of `joined`; it wraps
        with m.If(out.valid & out.ready):
            m.d.sync += row.eq(row + 1)
        lower = row[-1]
        across = (TILE // width).bit_length() - 1  # bits of a block's column, above those of its row
        if across:
            down = (self.config.array_y - 1).bit_length()
            self._take(m, Cat(row[down + across - 1], lower), 1)
        else:
            self._take(m, lower, 2)
        return m

    def _take(self, m: Module, turn: Value, side_by_side: int) -> None:
        """Offers the rows of the streams whose turn it is, one or two of them."""
        out, parts = self.joined, []
        for place in range(side_by_side):
            mine = list(self.rows)[place::side_by_side]
            every = Array(mine_.payload.as_value() for mine_ in mine)
            part = Signal(self.rows[0].payload.shape(), name=f"part_{place}")
            m.d.comb += part.as_value().eq(every[turn])
            parts.append(part)
        valid = [Array(rows.valid for rows in list(self.rows)[place::side_by_side])[turn] for place in range(side_by_side)]
        m.d.comb += [
            out.valid.eq(Cat(valid).all()),
            *(out.payload[name].eq(parts[0][name]) for name in out.payload.shape().members if name in _PLACE),
            *(out.payload[name].as_value().eq(Cat(part[name].as_value() for part in parts))
              for name in out.payload.shape().members if name not in _PLACE),
            *(rows.ready.eq(out.ready & out.valid & (turn == q // side_by_side)) for q, rows in enumerate(self.rows))]
