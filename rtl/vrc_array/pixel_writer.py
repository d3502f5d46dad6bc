"""Writes pixel rows to the frame in memory.

A beat holds two pixels, or eight in the display format. A row may begin anywhere in a beat. Its pixels are then shifted by as
many words, and the beats at its ends are written in part. Pixels outside the frame are not written, and a row that lies outside
gives no beat::

    cycle            0      1      2      3      4      5      6       rows of 4 pixels, which begin in the middle of a beat
    rows         <  A  ><  B  ><  B  ><  B  ><  C  >
    packed              <  A  ><  B  ><  B  ><  B  ><  C  >           words of pixels, y * width
    writes                     < .A0 ><A1 A2>< A3. >< .B0 ><B1 B2>
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.fixed import saturate
from rtl.shapes import layout, shape
from rtl.supertiles.eyes import joint_settings
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.formats import Fixed
from spec.memory import BEAT_BITS, PIXEL_BYTES, WORD_BITS, WORDS, frame_pixel, frame_settings, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row, uint

PIXEL_WORDS = PIXEL_BYTES // 4
"""32-bit words of a FramePixel; a DisplayPixel is one word."""

_SETTINGS = ("width", "height", "display", "frame_base")


def frame_writer_ports(config: AcceleratorConfig, settings: Collection[str]) -> dict[str, wiring.Member]:
    """The ports of a unit that writes the array's pixel rows to a frame in memory, which `PixelWriter` describes.

    Args:
        config: the machine.
        settings: the names of the settings of the frame that the unit uses.
    """
    return {
        "rows": In(stream.Signature(layout(pixel_row(config)))),
        "writes": Out(stream.Signature(layout(write_request(config)))),
        "writes_idle": In(1),
        **{f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in settings},
        **joint_settings(config, "joint", "target_frame_base"),
        "tile_count": In(range((frame_tiles(config) << config.warps_joint) + 1)),
        "begin": In(1),
        "pixels": Out(COUNTER_BITS),
        "finished": Out(1),
        "busy": Out(1),
    }


class PixelWriter(wiring.Component):
    """Turns the array's pixel rows into memory writes.

    Parameters:
        config: the machine; `cores_x`, `depth` and `row_width` are used.

    Ports:
        rows: PixelRow items, in any order.
        writes: the memory's write port; words whose strobe is low are 0.
        writes_idle: the memory has completed all writes that it took.
        width, height, display, frame_base: settings of the frame.
        joint, target_frame_base: in machines with joint frames, settings of the frame: rows of the target go there.
        tile_count: tiles of the frame, or of either eye of a joint frame; in machines with a warp unit and joint frames all
            tiles that are rendered, of both eyes.
        begin: strobe before a frame's first row; clears `finished` and `pixels`.
        pixels: pixels written since `begin`, up to the previous cycle; always 0 without `config.counters`.
        finished: all rows of `tile_count` tiles, in joint frames twice as many, have arrived since `begin`, and memory has
            their pixels. Stays high until `begin`.
        busy: a row is inside.

    Storage: two rows. Throughput: one beat per cycle, one row per cycle. Order is kept. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__(frame_writer_ports(config, _SETTINGS))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        packed, packed_room = Signal(), Signal()
        line, start, left, below = self._pack(m, packed, packed_room)
        base = self._base(m)

        lanes, slots = self.config.array_x, self.config.array_x * PIXEL_WORDS + WORDS  # space to shift into
        held, inside = Signal(WORD_BITS * slots, reset_less=True), Signal(slots)
        beat, sends, ends, room = Signal(BEAT_BITS, reset_less=True), Signal(), Signal(), Signal()
        # used for the addresses only, because `self.display` already drives the multiplexers of all words
        display = Signal(reset_less=True)
        place = Mux(self.display, start[:3], start[0] << 2)  # of the row's first pixel in its beat, in words
        pixels = [below & (left > i) for i in range(lanes)]
        mask = Mux(self.display, Cat(pixels), Cat(pixel.replicate(PIXEL_WORDS) for pixel in pixels))
        by_word = Mux(self.display, line[: WORD_BITS * lanes] << Cat(Const(0, WORD_BITS.bit_length() - 1), place[:2]), line)
        m.d.comb += [
            sends.eq(inside[:WORDS].any()),  # valid words are adjacent, so none beyond the first beat means the row ends
            ends.eq(~inside[WORDS]),
            room.eq(~sends | self.writes.ready & ends),
            packed_room.eq(~packed | room),
        ]
        m.d.sync += display.eq(self.display)
        with m.If(room):
            m.d.sync += inside.eq(Mux(packed, mask << place, 0))
            with m.If(packed):
                m.d.sync += held.eq(Mux(place[2], by_word << WORD_BITS * PIXEL_WORDS, by_word))
                m.d.sync += beat.eq(base + Mux(display, start >> 3, start >> 1))
        with m.Elif(self.writes.ready):
            m.d.sync += [inside.eq(inside >> WORDS), held.eq(held >> WORD_BITS * WORDS), beat.eq(beat + 1)]
        out = self.writes.payload
        m.d.comb += [
            self.writes.valid.eq(sends), out.beat.eq(beat), out.strobe.eq(inside[:WORDS]),
            *(out.word[i].eq(Mux(inside[i], held.word_select(i, WORD_BITS), 0)) for i in range(WORDS)),
        ]
        self._count(m, packed | sends, inside[:WORDS])
        return m

    def _base(self, m: Module) -> Value:
        """The first beat of the frame to which the row in the first register stage belongs."""
        if not self.config.joint:
            return self.frame_base
        target = Signal(reset_less=True)
        with m.If(self.rows.valid & self.rows.ready):
            m.d.sync += target.eq(self.rows.payload.eye)
        return Mux(target, self.target_frame_base, self.frame_base)

    def _pack(self, m: Module, packed: Signal, room: Signal) -> tuple[Any, ...]:
        """The first register stage.

        Returns the row's words, the number of the frame's pixels before it, the number of pixels from its first one to the
        right edge of the frame, and whether the row is above the frame's lower edge.
        """
        row = self.rows.payload
        y, column = Cat(row.row, row.tile_y), Cat(row.column, row.tile_x)
        whole = Cat(self._whole(m, i) for i in range(self.config.array_x))
        display = Cat(self._display(i) for i in range(self.config.array_x))
        line, start = Signal(len(whole), reset_less=True), Signal(BEAT_BITS + 1, reset_less=True)
        left, below = Signal((self.width - column).shape(), reset_less=True), Signal(reset_less=True)
        width = Signal.like(self.width, reset_less=True)  # a setting's way from the registers and the product are too long
        m.d.comb += self.rows.ready.eq(room)
        m.d.sync += width.eq(self.width)
        with m.If(room):
            m.d.sync += packed.eq(self.rows.valid)
        with m.If(self.rows.valid & room):
            m.d.sync += [
                line.eq(Cat(Mux(self.display, display, whole[: len(display)]), whole[len(display) :])),
                start.eq(y * width + column), left.eq(self.width - column), below.eq(y < self.height)]
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

    def _count(self, m: Module, busy: Value, inside: Value) -> None:
        """Counts tiles that have arrived and pixels that have left."""
        row, tiles = Signal(range(TILE * TILE // self.config.array_x)), Signal.like(self.tile_count)
        count = self.tile_count
        if self.config.joint and not self.config.stereo:
            tiles = Signal(len(count) + 1)
            count = Mux(self.joint, count << 1, count)
        with m.If(self.rows.valid & self.rows.ready):
            m.d.sync += row.eq(row + 1)  # a tile has a power of two of rows, so the counter wraps
            with m.If(row.all()):
                m.d.sync += tiles.eq(tiles + 1)
        if self.config.counters:
            words, written = sum(inside), Signal(range(WORDS + 1))
            pixels = Signal(len(tiles) + 2 * (TILE - 1).bit_length())  # no frame has more, and all bits would not fit a cycle
            m.d.comb += self.pixels.eq(pixels)
            m.d.sync += [
                written.eq(Mux(self.writes.valid & self.writes.ready, Mux(self.display, words, words // PIXEL_WORDS), 0)),
                pixels.eq(pixels + written)]
            with m.If(self.begin):
                m.d.sync += pixels.eq(0)
        with m.If(self.begin):
            m.d.sync += [row.eq(0), tiles.eq(0)]
        m.d.comb += [
            self.busy.eq(busy),
            self.finished.eq((tiles == count) & ~busy & self.writes_idle),
        ]


def display_byte(raw: Value, number: Fixed) -> Value:
    """255 times the value, rounded half up, at most 255.

    255 raw = 256 (raw - ceil(raw / 256)) + a remainder below 256 that does not affect the result. The low 8 bits of raw matter
    only through the ceiling.
    """
    drop = number.frac_bits - 8
    scaled = raw + (1 << (drop - 1)) - (raw >> 8) - raw[:8].any()
    return saturate(scaled[drop : len(raw)], uint(8))
