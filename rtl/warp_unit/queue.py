"""Stores a lane's rows of pixels, and delivers their pixels one by one.

The current row stays at the output of the memory's read port, which holds its value until the next read, so that no register is
needed for it::

    cycle            0      1      2      3      4      5      6      rows of 2 pixels
    push         ~~~~~~~~~~~~~~
    row          <  A  ><  B  >
    read                ~~~~~~~       ~~~~~~~
    pixel                      < A0  >< A1  >< B0  >< B1  >
    tile_ends    __________________________________~~~~~~~        B is the tile's last row of this lane
"""

from __future__ import annotations

from amaranth.hdl import Array, Module, Mux, Signal
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import shape
from spec.config import AcceleratorConfig
from spec.constants import TILE


def column_bits(config: AcceleratorConfig) -> int:
    """Bits of a column number of a frame."""
    return (config.row_width - 1).bit_length()


def sub_rows(config: AcceleratorConfig) -> int:
    """Rows of a strip that one lane works on; lane r takes rows r, r + warp_lanes, ..."""
    return TILE // config.warp_lanes


def sub_bits(config: AcceleratorConfig) -> int:
    """Bits of a row's number among those of its lane."""
    return (sub_rows(config) - 1).bit_length()


def source_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The fields of one pixel of a PixelRow."""
    n = config.formats
    return data.StructLayout({
        "colour": data.ArrayLayout(shape(n.accumulator), 3), "depth": shape(n.depth_accumulator),
        "transmittance": shape(n.transmittance)})


def place_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Place of a source pixel: its row among the lane's, its column in the frame, and its tile's slot in the ring."""
    return data.StructLayout({
        "sub": sub_bits(config), "x": column_bits(config), "slot": (ring_tiles(config) - 1).bit_length()})


def ring_tiles(config: AcceleratorConfig) -> int:
    """Tiles of a tile row that the ring of columns holds."""
    return config.warp_columns // TILE


def row_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A row of pixels: place of its first pixel, index of the last one in the frame, whether any is, and the pixels."""
    return data.StructLayout({
        "place": place_layout(config), "last": range(config.cores_x), "inside": 1,
        "pixels": data.ArrayLayout(source_layout(config), config.cores_x)})


def lane_rows(config: AcceleratorConfig) -> int:
    """Rows of the array that one lane takes of a tile."""
    return sub_rows(config) * TILE // config.cores_x


def queue_rows(config: AcceleratorConfig) -> int:
    """Rows that a lane's queue holds besides the current one: a tile's, but at least two."""
    return max(2, lane_rows(config))


class RowQueue(wiring.Component):
    """Turns rows into pixels.

    Parameters:
        config: the machine; `cores_x`, `row_width` and `warp_lanes` are used.

    Ports:
        push: strobe; `row` is stored. Allowed only while `room` is high.
        room: there is free space for a row.
        valid, place, pixel: a pixel of the frame; the receiver must take it in that cycle.
        tile_ends: strobe; the last row of a tile leaves. Rows outside the frame have no pixels, but count too.
        busy: a row is inside.

    Storage: `queue_rows` rows, for PAPER 4 rows of 1,271 bits. Throughput: one pixel per cycle; a row outside the frame takes
    one cycle. Latency: 2 cycles. Order is kept.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "push": In(1), "row": In(row_layout(config)), "room": Out(1), "valid": Out(1), "place": Out(place_layout(config)),
            "pixel": Out(source_layout(config)), "tile_ends": Out(1), "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        depth = queue_rows(self.config)
        m.submodules.store = store = memory.Memory(shape=row_layout(self.config), depth=depth, init=[])
        write, read = store.write_port(), store.read_port()
        waiting, shown, index = Signal(range(depth + 1)), Signal(), Signal(range(self.config.cores_x))
        ends, pops = Signal(), Signal()
        head = read.data
        m.d.comb += [
            self.room.eq(waiting != depth),
            write.en.eq(self.push), write.data.eq(self.row),
            ends.eq(index == head.last),
            pops.eq(waiting.any() & (ends | ~shown)),
            read.en.eq(pops),
            self.valid.eq(shown & head.inside), self.pixel.eq(Array(head.pixels)[index]),
            self.place.sub.eq(head.place.sub), self.place.slot.eq(head.place.slot),
            self.place.x.eq(head.place.x | index),  # a row begins at a multiple of its length
            self.busy.eq(shown | waiting.any()),
        ]
        fewer = Mux(pops, waiting - 1, waiting)
        # `push` is on the critical path
        m.d.sync += [waiting.eq(Mux(self.push, fewer + 1, fewer)), shown.eq(pops | shown & ~ends)]
        rows = Signal(range(lane_rows(self.config)))  # a power of two, so the counter wraps
        m.d.comb += self.tile_ends.eq(shown & ends & (rows == lane_rows(self.config) - 1))
        with m.If(shown & ends):
            m.d.sync += rows.eq(rows + 1)
        with m.If(shown):
            m.d.sync += index.eq(Mux(ends, 0, index + 1))
        for moves, address in ((self.push, write.addr), (pops, read.addr)):
            place = Signal(range(depth), name=f"{'write' if moves is self.push else 'read'}_place")
            m.d.comb += address.eq(place)
            with m.If(moves):
                m.d.sync += place.eq(place + 1)  # wraps, as the depth is a power of two
        return m
