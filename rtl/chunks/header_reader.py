"""Reads the headers of chunks from memory for the chunk test."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.tile_lists.beats import BeatRun, check_config, read_port
from spec.chunks import chunk_header, header_item
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES
from spec.records import INDEX_BITS
from spec.supertiles import CHUNK_RUN, CHUNK_STREAMS


class ChunkWalk(wiring.Component):
    """Counts through the chunks of a model, run by run of CHUNK_STREAMS parts by turns (`spec.supertiles`).

    Parameters:
        bits: bits of the numbers.

    Ports:
        start: strobe; `base` and `count` are taken in its cycle.
        base, count: the first chunk's number, and how many there are; their sum has no more bits.
        step: strobe; the number is used up. It must not come while `busy` is low.
        number: the next chunk's number.
        busy: there is one.

    Throughput: one number a cycle. Latency: one cycle from `start`.
    """

    def __init__(self, bits: int):
        super().__init__({
            "start": In(1), "base": In(bits), "count": In(bits), "step": In(1), "number": Out(bits), "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # the run that is walked through, the first part's run of these turns, the distance between parts, and the last number
        run, first, apart, tail = (Signal(len(self.count) + 1, name=name) for name in ("run", "first", "apart", "tail"))
        place, left = Signal(range(CHUNK_RUN)), Signal.like(self.count)
        places, parts = CHUNK_RUN.bit_length() - 1, CHUNK_STREAMS.bit_length() - 1
        runs = (self.count + (CHUNK_RUN * CHUNK_STREAMS - 1)) >> (places + parts)
        # What follows the run is known two cycles after its first number, and after `start` three, before a whole run can end.
        # Only the last part's last run may be shorter. It is the last of its turn, and the first part's next run is known.
        limit, following = Signal(signed(len(tail) + 1), reset_less=True), Signal.like(tail)
        along, around, turns = Signal.like(tail, reset_less=True), Signal.like(tail, reset_less=True), Signal(reset_less=True)
        ends, over = Signal(), Signal()
        m.d.sync += [
            limit.eq(tail - apart), turns.eq(run > limit), along.eq(run + apart), around.eq(first + CHUNK_RUN)]
        m.d.comb += [
            self.busy.eq(left.any()), ends.eq(self.number == tail), over.eq(turns | ends),
            following.eq(Mux(over, around, along))]
        with m.If(self.start):
            m.d.sync += [
                self.number.eq(self.base), run.eq(self.base), first.eq(self.base), place.eq(0), left.eq(self.count),
                tail.eq(self.base + self.count - 1), apart.eq(runs << places)]
        with m.Elif(self.step):
            m.d.sync += left.eq(left - 1)
            with m.If(place.all() | ends):
                m.d.sync += [self.number.eq(following), run.eq(following), place.eq(0)]
                with m.If(over):
                    m.d.sync += first.eq(following)
            with m.Else():
                m.d.sync += [self.number.eq(self.number + 1), place.eq(place + 1)]
        return m


class ChunkHeaderReader(wiring.Component):
    """Reads the header of every chunk of the model, and then emits an item with `end`. With super-tiles, chunks come in the
    order of `spec.supertiles`, in other machines in that of the model.

    Parameters:
        config: the machine; the formats matter here. A ChunkHeader must fit a beat.

    Ports:
        start: strobe; it must not come while `busy`. Settings are stable from then on.
        chunks_base, chunks: the beat of the first header, and the number of chunks; 0 gives only the item with `end`.
        reads, data: read port of memory; one beat per chunk.
        headers: HeaderItem items; the one with `end` is 0 besides. With super-tiles, `number` is the chunk's number.
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
        record, item, words = chunk_header(self.config), self.headers.payload, self.data.payload
        left, end, moves = Signal(INDEX_BITS), Signal(), Signal()
        m.d.comb += [
            end.eq(left == 0), moves.eq(self.data.valid & self.data.ready),
            Cat(item[f.name] for f in record.fields).eq(
                Mux(end, 0, words.word.as_value()[: record.width])),  # without a valid beat these words may change
            item.end.eq(end),
            self.headers.valid.eq(self.busy & (end | self.data.valid & ~words.error)),
            self.data.ready.eq(self.busy & ~end & (self.headers.ready | words.error)),
        ]
        if self.config.supertiles:
            m.submodules.asked, m.submodules.numbers = asked, numbers = ChunkWalk(BEAT_BITS), ChunkWalk(INDEX_BITS)
            m.d.comb += [
                asked.base.eq(self.chunks_base), self.reads.valid.eq(asked.busy), self.reads.payload.beat.eq(asked.number),
                asked.step.eq(self.reads.valid & self.reads.ready), numbers.step.eq(moves),
                item.number.eq(Mux(end, 0, numbers.number)),
                *(signal for walk in (asked, numbers) for signal in (
                    walk.start.eq(self.start), walk.count.eq(self.chunks)))]
        else:
            m.submodules.beats = beats = BeatRun(self.config, INDEX_BITS)
            wiring.connect(m, beats.reads, wiring.flipped(self.reads))
            m.d.comb += [beats.start.eq(self.start), beats.base.eq(self.chunks_base), beats.count.eq(self.chunks)]
        with m.If(self.headers.valid & self.headers.ready & end):
            m.d.sync += self.busy.eq(0)
        with m.If(self.start):
            m.d.sync += [left.eq(self.chunks), self.busy.eq(1), self.error.eq(0)]
        with m.Elif(moves):
            m.d.sync += [left.eq(left - 1), self.error.eq(self.error | words.error)]
        return m
