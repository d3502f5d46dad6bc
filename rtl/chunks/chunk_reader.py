"""Reads the Gaussians of chunks from memory for projection."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.chunks.geometry_decode import GeometryDecode
from rtl.shapes import layout
from rtl.tile_lists.beats import check_config, read_port
from spec.chunks import CHUNK, PLACE_BITS, header_item
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES
from spec.queues import CHUNKS_AHEAD
from spec.records import gaussian_geometry, gaussian_point

_KEPT = {False: ("count", "first", "end"), True: ("low", "step", "scale_top", "bound", "count", "first", "end")}
"""Fields of a header that wait for the Gaussians, with wide records and with compact ones."""


def _kept_layout(config: AcceleratorConfig, item: data.StructLayout) -> data.StructLayout:
    """What waits of a HeaderItem. With super-tiles it is the chunk's number instead of `first`, and the half of a beat in which
    the first Gaussian lies."""
    kept = {name: item[name].shape for name in _KEPT[config.compact]}
    if config.supertiles:
        del kept["first"]
        kept |= {"half": 1, "number": item["number"].shape}
    return data.StructLayout(kept)


class ChunkReader(wiring.Component):
    """Reads every Gaussian of the chunks that it is given, chunk by chunk, and decodes compact records::

        tested -+-> headers in flight ----> halves of beats --> GeometryDecode --> points
                +-> reads ... memory ... data --^

    Requests run ahead of the data, from chunk to chunk. A beat of compact records holds two Gaussians; a beat that two chunks
    share is read for each of them.

    Parameters:
        config: the machine; records and formats matter here. A wide GaussianGeometry must fit a beat.

    Ports:
        start: strobe before a frame, while nothing is inside. Settings are stable from then on.
        geometry_base: the beat of the Gaussian with index 0.
        tested: HeaderItem items of the chunks to read, each with 1 to 64 Gaussians; a frame ends with an item with `end`.
        reads, data: read port of memory: two Gaussians per beat with compact records, else one.
        points: GaussianPoint items: those of a chunk in order of their indices, chunks in their order, then one with `end`.
            With super-tiles, their `index` is that of `spec.supertiles`: chunk << PLACE_BITS | place in the chunk.
        busy: high from the cycle after `start` until `end` is taken.
        error: memory answered with an error since `start`. The items of such beats are undefined, but are passed on.

    Throughput: one Gaussian per cycle, or as many as memory gives, also from chunk to chunk. Memory may take 130 cycles to
    answer without lowering it, provided that chunks have at least 9 Gaussians (CHUNKS_AHEAD). Latency: one cycle from a chunk
    to its first request, and two to its first item if the beat is there; from a beat to its first item none with wide records,
    else that of GeometryDecode.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        width = gaussian_geometry(config).width
        if not config.compact and width > 8 * BEAT_BYTES:
            raise ValueError(f"formats must be so short that a GaussianGeometry fits {8 * BEAT_BYTES} bits, not {width!r}")
        self.config = config
        item = layout(header_item(config))
        self._kept = _kept_layout(config, item)
        self._decode = GeometryDecode(config) if config.compact else None
        super().__init__({
            "start": In(1), "geometry_base": In(BEAT_BITS),
            "tested": In(stream.Signature(item)),
            **read_port(config),
            "points": Out(stream.Signature(layout(gaussian_point(config)))),
            "busy": Out(1), "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.headers = headers = SyncFIFOBuffered(width=self._kept.size, depth=CHUNKS_AHEAD)
        self._request(m, headers)
        self._arrive(m, headers)
        with m.If(self.start):
            m.d.sync += self.busy.eq(1)
        with m.Elif(self.points.valid & self.points.ready & self.points.payload.end):
            m.d.sync += self.busy.eq(0)
        with m.If(self.start):
            m.d.sync += self.error.eq(0)
        with m.Elif(self.data.valid & self.data.ready):
            m.d.sync += self.error.eq(self.error | self.data.payload.error)
        return m

    def _request(self, m: Module, headers: SyncFIFOBuffered) -> None:
        """Takes chunks, requests the beats of one after the other, and puts their headers into the queue."""
        chunk, halves = self.tested.payload, int(self.config.compact)
        left, taken = Signal(range(CHUNK + 1)), Signal()
        beat = self.reads.payload.beat
        m.d.comb += [
            self.reads.valid.eq(left != 0),
            self.tested.ready.eq(headers.w_rdy & ((left == 0) | (left == 1) & self.reads.ready)),
            taken.eq(self.tested.valid & self.tested.ready),
            headers.w_en.eq(taken),
            headers.w_data.eq(Cat(
                chunk.first[0] if name == "half" else Value.cast(chunk[name]) for name, _ in self._kept)),
        ]
        with m.If(self.reads.valid & self.reads.ready):
            m.d.sync += [left.eq(left - 1), beat.eq(beat + 1)]
        with m.If(taken & ~chunk.end):
            beats = (chunk.count + chunk.first[0] + 1) >> 1 if halves else chunk.count
            m.d.sync += [left.eq(beats), beat.eq(self.geometry_base + (chunk.first >> halves))]

    def _arrive(self, m: Module, headers: SyncFIFOBuffered) -> None:
        """Gives every Gaussian of a beat its header and its index. The header in use is in registers, because the queue's data
        come too late in a cycle to be added to."""
        waiting, words = data.View(self._kept, headers.r_data), self.data.payload.word.as_value()
        chunk, present = Signal(self._kept), Signal()
        last, valid, moves, loads = Signal(), Signal(), Signal(), Signal()
        if self.config.supertiles:
            counter, half = Signal(PLACE_BITS), chunk.half
            index = Cat(counter, chunk.number)
        else:
            counter, index, half = chunk.first, chunk.first, chunk.first[0]
        codes = self._decode.codes if self._decode else self.points
        m.d.comb += [
            last.eq(chunk.end | (chunk.count == 1)),
            valid.eq(present & (chunk.end | self.data.valid)),
            moves.eq(valid & codes.ready),
            loads.eq(headers.r_rdy & (~present | moves & last)),
            headers.r_en.eq(loads),
            codes.valid.eq(valid), codes.payload.index.eq(index), codes.payload.end.eq(chunk.end),
            self.data.ready.eq(present & ~chunk.end & codes.ready & ((half | last) if self._decode else 1)),
        ]
        with m.If(loads):
            m.d.sync += [chunk.eq(waiting), present.eq(1)]
        with m.Elif(moves):  # `first` and `count` become the index and the number of those that are left
            m.d.sync += [counter.eq(counter + 1), chunk.count.eq(chunk.count - 1), present.eq(~last)]
        if self.config.supertiles:
            with m.If(loads):
                m.d.sync += counter.eq(0)
            with m.Elif(moves):
                m.d.sync += half.eq(~half)
        if self._decode:
            m.submodules.decode = self._decode
            wiring.connect(m, self._decode.points, wiring.flipped(self.points))
            record = Mux(half, words[len(words) // 2:], words[: len(words) // 2])
            m.d.comb += [
                *(Value.cast(codes.payload[name]).eq(Value.cast(chunk[name]))
                  for name in ("low", "step", "scale_top", "bound")),
                Value.cast(codes.payload.word).eq(Mux(chunk.end, 0, record))]  # without a valid beat these words may change
        else:
            record = gaussian_geometry(self.config)
            m.d.comb += Cat(codes.payload[f.name] for f in record.fields).eq(Mux(chunk.end, 0, words[: record.width]))
