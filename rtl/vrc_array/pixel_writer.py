"""Pixel rows to the frame in memory.

Two pixels fill a beat. Where a frame's width is odd, every other row begins in the middle of a beat: its pixels move up by a
place, and the beats at its ends are written by half. Pixels outside the frame are not written, and rows without any give no
beat::

    cycle            0      1      2      3      4      5      6       rows of 4 pixels, which begin in the middle of a beat
    rows         <  A  ><  B  ><  B  ><  B  ><  C  >
    placed              <  A  ><  B  ><  B  ><  B  ><  C  >           y * width
    writes                     < .A0 ><A1 A2>< A3. >< .B0 ><B1 B2>
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, BEAT_BYTES, PIXEL_BYTES, WORDS, frame_pixel, frame_settings, write_request
from spec.records import frame_tiles, pixel_row

COUNTER_BITS = 32

BEAT_PIXELS = BEAT_BYTES // PIXEL_BYTES
"""Pixels of a beat."""


class PixelWriter(wiring.Component):
    """The array's rows to writes.

    Parameters:
        config: the machine; `cores_x`, `depth` and `row_width` matter here.

    Ports:
        rows: PixelRow items, in any order.
        writes: the memory's; words whose strobe is low are 0.
        writes_idle: the memory has all writes that were taken.
        width, height, frame_base: settings of the frame.
        tile_count: tiles of the frame.
        begin: strobe before a frame's first row: `finished` falls, `pixels` is 0 again.
        pixels: pixels written since `begin`; 0 for ever without `config.counters`.
        finished: all rows of `tile_count` tiles have come since `begin`, and memory has their pixels. Stays until `begin`.
        busy: a row is inside.

    Storage: two rows. Throughput: one beat a cycle, one row a cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        size = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in ("width", "height")}
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            **size,
            "frame_base": In(BEAT_BITS),
            "tile_count": In(range(frame_tiles(config) + 1)),
            "begin": In(1),
            "pixels": Out(COUNTER_BITS),
            "finished": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        config, n = self.config, self.config.formats
        pixel = data.StructLayout({
            "colour": data.ArrayLayout(shape(n.accumulator), 3), "transmittance": shape(n.transmittance),
            **({"depth": shape(n.depth_accumulator)} if config.depth else {})})
        placed, placed_room = Signal(), Signal()
        line, x, first, left, below = self._place(m, data.ArrayLayout(pixel, config.cores_x), placed, placed_room)

        slots = config.cores_x + BEAT_PIXELS  # room to move up, in whole beats
        held, inside = Signal(data.ArrayLayout(pixel, slots), reset_less=True), Signal(slots)
        beat, shift = Signal(BEAT_BITS, reset_less=True), BEAT_PIXELS * pixel.size
        sends, ends, room = Signal(), Signal(), Signal()
        start = Signal.like(first)
        mask = Cat(below & (left > i) for i in range(config.cores_x))
        m.d.comb += [
            start.eq(first + x),
            sends.eq(inside.any()),
            ends.eq(~inside[BEAT_PIXELS:].any()),
            room.eq(~sends | self.writes.ready & ends),
            placed_room.eq(~placed | room),
        ]
        with m.If(room):
            m.d.sync += inside.eq(Mux(placed, Mux(start[0], mask << 1, mask), 0))
            with m.If(placed):
                m.d.sync += held.eq(Mux(start[0], line.as_value() << pixel.size, line.as_value()))
                m.d.sync += beat.eq(self.frame_base + start[1:])
        with m.Elif(self.writes.ready):
            m.d.sync += [inside.eq(inside >> BEAT_PIXELS), held.eq(held.as_value() >> shift), beat.eq(beat + 1)]
        self._write(m, beat, [held[i] for i in range(BEAT_PIXELS)], inside[:BEAT_PIXELS], sends)
        self._count(m, placed | sends, inside[:BEAT_PIXELS])
        return m

    def _place(self, m: Module, line_layout: data.ArrayLayout, placed: Signal, room: Signal) -> tuple:
        """The first register: a row's pixels, x, the frame's pixels above its row, those from it to the right edge, and whether
        its row is in the frame."""
        row, config = self.rows.payload, self.config
        y = row.tile_y * TILE + row.row
        column = row.tile_x * TILE + row.column
        line, x = Signal(line_layout, reset_less=True), Signal(len(column), reset_less=True)
        above = Signal(BEAT_BITS + 1, reset_less=True)
        left, below = Signal((self.width - column).shape(), reset_less=True), Signal(reset_less=True)
        m.d.comb += self.rows.ready.eq(room)
        with m.If(room):
            m.d.sync += placed.eq(self.rows.valid)
        with m.If(self.rows.valid & room):
            m.d.sync += [x.eq(column), above.eq(y * self.width), left.eq(self.width - column), below.eq(y < self.height)]
            for i, pixel in enumerate(line):
                m.d.sync += [pixel.colour[c].eq(row.colour[3 * i + c]) for c in range(3)]
                m.d.sync += pixel.transmittance.eq(row.transmittance[i])
                if config.depth:
                    m.d.sync += pixel.depth.eq(row.depth[i])
        return line, x, above, left, below

    def _write(self, m: Module, beat: Signal, pixels: list[data.View], inside, valid: Signal) -> None:
        """`writes` out of what stands in the lowest slots."""
        out = self.writes.payload
        m.d.comb += [
            self.writes.valid.eq(valid),
            out.beat.eq(beat),
            out.strobe.eq(Cat(bit.replicate(WORDS // BEAT_PIXELS) for bit in inside)),
        ]
        words = []
        for pixel, bit in zip(pixels, inside, strict=True):
            memory = Signal(layout(frame_pixel(self.config)), name=f"memory_{len(words)}")
            m.d.comb += [memory.colour[c].eq(pixel.colour[c]) for c in range(3)]
            m.d.comb += [memory.transmittance.eq(pixel.transmittance), memory.reserved.eq(Const(0))]
            if self.config.depth:
                m.d.comb += memory.depth.eq(pixel.depth)
            words.append(Mux(bit, memory.as_value(), 0))
        m.d.comb += out.word.as_value().eq(Cat(words))

    def _count(self, m: Module, busy, inside) -> None:
        """Tiles that have come, pixels that have left."""
        row, tiles = Signal(range(TILE * TILE // self.config.cores_x)), Signal.like(self.tile_count)
        with m.If(self.rows.valid & self.rows.ready):
            m.d.sync += row.eq(row + 1)  # a power of two to a tile
            with m.If(row.all()):
                m.d.sync += tiles.eq(tiles + 1)
        if self.config.counters:
            with m.If(self.writes.valid & self.writes.ready):
                m.d.sync += self.pixels.eq(self.pixels + sum(inside))
        with m.If(self.begin):
            m.d.sync += [row.eq(0), tiles.eq(0), self.pixels.eq(0)]
        m.d.comb += [
            self.busy.eq(busy),
            self.finished.eq((tiles == self.tile_count) & ~busy & self.writes_idle),
        ]


def emit_pixel_writer(config: AcceleratorConfig) -> str:
    """Verilog of module `pixel_writer`."""
    return to_verilog(PixelWriter(config), "pixel_writer")
