"""Pixel rows to the frame in memory.

Two pixels fill a beat, or eight where the frame is for displays. A row may begin anywhere in a beat: its pixels move up by as
many words, and the beats at its ends are written in part. Pixels outside the frame are not written, and rows without any give
no beat::

    cycle            0      1      2      3      4      5      6       rows of 4 pixels, which begin in the middle of a beat
    rows         <  A  ><  B  ><  B  ><  B  ><  C  >
    packed              <  A  ><  B  ><  B  ><  B  ><  C  >           words of pixels, y * width
    writes                     < .A0 ><A1 A2>< A3. >< .B0 ><B1 B2>
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from rtl.fixed import saturate
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.formats import Fixed
from spec.memory import BEAT_BITS, PIXEL_BYTES, WORD_BITS, WORDS, frame_pixel, frame_settings, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row, uint

PIXEL_WORDS = PIXEL_BYTES // 4
"""Words of a FramePixel; a DisplayPixel is one."""

_SETTINGS = ("width", "height", "display", "frame_base")


class PixelWriter(wiring.Component):
    """The array's rows to writes.

    Parameters:
        config: the machine; `cores_x`, `depth` and `row_width` matter here.

    Ports:
        rows: PixelRow items, in any order.
        writes: the memory's; words whose strobe is low are 0.
        writes_idle: the memory has all writes that were taken.
        width, height, display, frame_base: settings of the frame.
        tile_count: tiles of the frame.
        begin: strobe before a frame's first row: `finished` falls, `pixels` is 0 again.
        pixels: pixels written since `begin`, until the cycle before; 0 for ever without `config.counters`.
        finished: all rows of `tile_count` tiles have come since `begin`, and memory has their pixels. Stays until `begin`.
        busy: a row is inside.

    Storage: two rows. Throughput: one beat a cycle, one row a cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        settings = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in _SETTINGS}
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            **settings,
            "tile_count": In(range(frame_tiles(config) + 1)),
            "begin": In(1),
            "pixels": Out(COUNTER_BITS),
            "finished": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        packed, packed_room = Signal(), Signal()
        line, start, left, below = self._pack(m, packed, packed_room)

        lanes, slots = self.config.cores_x, self.config.cores_x * PIXEL_WORDS + WORDS  # room to move up
        held, inside = Signal(WORD_BITS * slots, reset_less=True), Signal(slots)
        beat, sends, ends, room = Signal(BEAT_BITS, reset_less=True), Signal(), Signal(), Signal()
        display = Signal(reset_less=True)  # for the addresses alone: the port has all words to choose
        place = Mux(self.display, start[:3], start[0] << 2)  # in words, of the beat
        pixels = [below & (left > i) for i in range(lanes)]
        mask = Mux(self.display, Cat(pixels), Cat(pixel.replicate(PIXEL_WORDS) for pixel in pixels))
        by_word = Mux(self.display, line[: WORD_BITS * lanes] << Cat(Const(0, WORD_BITS.bit_length() - 1), place[:2]), line)
        m.d.comb += [
            sends.eq(inside[:WORDS].any()),  # words inside follow each other
            ends.eq(~inside[WORDS]),
            room.eq(~sends | self.writes.ready & ends),
            packed_room.eq(~packed | room),
        ]
        m.d.sync += display.eq(self.display)
        with m.If(room):
            m.d.sync += inside.eq(Mux(packed, mask << place, 0))
            with m.If(packed):
                m.d.sync += held.eq(Mux(place[2], by_word << WORD_BITS * PIXEL_WORDS, by_word))
                m.d.sync += beat.eq(self.frame_base + Mux(display, start >> 3, start >> 1))
        with m.Elif(self.writes.ready):
            m.d.sync += [inside.eq(inside >> WORDS), held.eq(held >> WORD_BITS * WORDS), beat.eq(beat + 1)]
        out = self.writes.payload
        m.d.comb += [
            self.writes.valid.eq(sends), out.beat.eq(beat), out.strobe.eq(inside[:WORDS]),
            *(out.word[i].eq(Mux(inside[i], held.word_select(i, WORD_BITS), 0)) for i in range(WORDS)),
        ]
        self._count(m, packed | sends, inside[:WORDS])
        return m

    def _pack(self, m: Module, packed: Signal, room: Signal) -> tuple:
        """The first register: a row's words, the frame's pixels before it, those from it to the right edge, and whether its row
        is in the frame."""
        row = self.rows.payload
        y, column = Cat(row.row, row.tile_y), Cat(row.column, row.tile_x)
        whole = Cat(self._whole(m, i) for i in range(self.config.cores_x))
        display = Cat(self._display(i) for i in range(self.config.cores_x))
        line, start = Signal(len(whole), reset_less=True), Signal(BEAT_BITS + 1, reset_less=True)
        left, below = Signal((self.width - column).shape(), reset_less=True), Signal(reset_less=True)
        m.d.comb += self.rows.ready.eq(room)
        with m.If(room):
            m.d.sync += packed.eq(self.rows.valid)
        with m.If(self.rows.valid & room):
            m.d.sync += [
                line.eq(Cat(Mux(self.display, display, whole[: len(display)]), whole[len(display) :])),
                start.eq(y * self.width + column), left.eq(self.width - column), below.eq(y < self.height)]
        return line, start, left, below

    def _whole(self, m: Module, lane: int) -> Value:
        """The FramePixel of a lane."""
        row, pixel = self.rows.payload, Signal(layout(frame_pixel(self.config)), name=f"whole_{lane}")
        m.d.comb += [pixel.colour[c].eq(row.colour[3 * lane + c]) for c in range(3)]
        m.d.comb += [pixel.transmittance.eq(row.transmittance[lane]), pixel.reserved.eq(0)]
        if self.config.depth:
            m.d.comb += pixel.depth.eq(row.depth[lane])
        return pixel.as_value()

    def _display(self, lane: int) -> Value:
        """The DisplayPixel of a lane."""
        row, n = self.rows.payload, self.config.formats
        colour = [display_byte(row.colour[3 * lane + c], n.accumulator) for c in range(3)]
        return Cat(colour, ~display_byte(row.transmittance[lane], n.transmittance))

    def _count(self, m: Module, busy, inside) -> None:
        """Tiles that have come, pixels that have left."""
        row, tiles = Signal(range(TILE * TILE // self.config.cores_x)), Signal.like(self.tile_count)
        with m.If(self.rows.valid & self.rows.ready):
            m.d.sync += row.eq(row + 1)  # a power of two to a tile
            with m.If(row.all()):
                m.d.sync += tiles.eq(tiles + 1)
        if self.config.counters:
            words, written = sum(inside), Signal(range(WORDS + 1))
            m.d.sync += [
                written.eq(Mux(self.writes.valid & self.writes.ready, Mux(self.display, words, words // PIXEL_WORDS), 0)),
                self.pixels.eq(self.pixels + written)]
        with m.If(self.begin):
            m.d.sync += [row.eq(0), tiles.eq(0), self.pixels.eq(0)]
        m.d.comb += [
            self.busy.eq(busy),
            self.finished.eq((tiles == self.tile_count) & ~busy & self.writes_idle),
        ]


def display_byte(raw: Value, number: Fixed) -> Value:
    """255 times the value, rounded half up, at most 255.

    Of 256 raw - raw the low 8 bits only matter by their borrow: it is 256 times raw - ceil(raw / 256), and less than 256 more.
    """
    drop = number.frac_bits - 8
    scaled = raw + (1 << (drop - 1)) - (raw >> 8) - raw[:8].any()
    return saturate(scaled[drop : len(raw)], uint(8))


def emit_pixel_writer(config: AcceleratorConfig) -> str:
    """Verilog of module `pixel_writer`."""
    return to_verilog(PixelWriter(config), "pixel_writer")
