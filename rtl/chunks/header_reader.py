"""Reads the headers of chunks from memory for the chunk test."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import BeatRun, check_config, read_port
from spec.chunks import chunk_header, header_item
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES
from spec.records import INDEX_BITS


class ChunkHeaderReader(wiring.Component):
    """Reads the header of every chunk of the model, in order, and then emits an item with `end`.

    Parameters:
        config: the machine; the formats matter here. A ChunkHeader must fit a beat.

    Ports:
        start: strobe; it must not come while `busy`. Settings are stable from then on.
        chunks_base, chunks: the beat of the first header, and the number of chunks; 0 gives only the item with `end`.
        reads, data: read port of memory; one beat per chunk.
        headers: HeaderItem items; the one with `end` is 0 besides. With super-tiles, `number` counts the chunks of the model,
            lost ones too.
        busy: high from the cycle after `start` until `end` is taken.
        error: memory answered with an error since `start`. Chunks whose header is lost are left out, because a reader must not
            wait for Gaussians that nobody has counted.

    Throughput: one header per cycle, or as many as memory gives beats. Latency: none from a beat to its item, as beats are not
    stored here; the first request leaves in the cycle after `start`.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        width = chunk_header(config).width
        if width > 8 * BEAT_BYTES:
            raise ValueError(f"formats must be so short that a ChunkHeader fits {8 * BEAT_BYTES} bits, not {width!r}")
        self.config = config
        super().__init__({
            "start": In(1), "chunks_base": In(BEAT_BITS), "chunks": In(INDEX_BITS),
            **read_port(config),
            "headers": Out(stream.Signature(layout(header_item(config)))),
            "busy": Out(1), "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.beats = beats = BeatRun(self.config, INDEX_BITS)
        wiring.connect(m, beats.reads, wiring.flipped(self.reads))
        record, item, words = chunk_header(self.config), self.headers.payload, self.data.payload
        left, end, moves = Signal(INDEX_BITS), Signal(), Signal()
        m.d.comb += [
            beats.start.eq(self.start), beats.base.eq(self.chunks_base), beats.count.eq(self.chunks),
            end.eq(left == 0), moves.eq(self.data.valid & self.data.ready),
            Cat(item[f.name] for f in record.fields).eq(
                Mux(end, 0, words.word.as_value()[: record.width])),  # without a valid beat these words may change
            item.end.eq(end),
            self.headers.valid.eq(self.busy & (end | self.data.valid & ~words.error)),
            self.data.ready.eq(self.busy & ~end & (self.headers.ready | words.error)),
        ]
        if self.config.supertiles:
            number = Signal.like(item.number)
            m.d.comb += item.number.eq(Mux(end, 0, number))
            m.d.sync += number.eq(Mux(self.start, 0, number + moves))
        with m.If(self.headers.valid & self.headers.ready & end):
            m.d.sync += self.busy.eq(0)
        with m.If(self.start):
            m.d.sync += [left.eq(self.chunks), self.busy.eq(1), self.error.eq(0)]
        with m.Elif(moves):
            m.d.sync += [left.eq(left - 1), self.error.eq(self.error | words.error)]
        return m
