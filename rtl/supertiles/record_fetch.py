"""Record fetch: reads the record of every sorted pair, by its chunk's header, and decodes its geometry for projection.

    sorted -> CacheTags -+-> pairs -----> CacheLines --+-> pairs ---------> CacheLines -> GeometryDecode -> points
                         |                  ^   |      |                      ^    ^
                         +-> reads_chunks   |   |      +-> reads_colour       |    |
                                            |   +--- headers that missed -----+    |
                              data_chunks --+                       data_colour ---+-> queue -> beats

A record's address depends on the header of its chunk, so that two latencies follow each other. Each is covered by a queue of
pairs, as in `rtl.vrc_array.splat_fetch`: tags are looked up as pairs come, and a pair that misses waits for its header with all
pairs behind it, while headers and records of these are on their way.

A header's fields lie in two memories of lines. The first has what the address needs, and is filled when the header comes. The
second has what the geometry is relative to, and is filled when the pair's record comes, because pairs before it still use what
its line held. So a pair that waits for its record holds its line's number instead of a header of 114 bits.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.cache_tags import CacheTags
from rtl.chunks.geometry_decode import GeometryDecode
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.header_cache import DECODING, PLACING, CacheLines, header_part
from rtl.tile_lists.beats import check_config
from spec.chunks import PLACE_BITS, chunk_header
from spec.compact import COARSE_BOUND, FINE_LEVELS, OPACITY_BITS, compact_colour, compact_geometry
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.memory import BEAT_BITS, BEAT_BYTES, read_data, read_request
from spec.queues import COUNTER_BITS, HEADERS_MISSED, HEADERS_PENDING, RECORD_BEATS, RECORDS_PENDING
from spec.records import chunk_item, gaussian_point
from spec.supertiles import CHUNK_BITS, HEADER_WAYS, check_supertiles

LATENCY = 14
"""Cycles from a pair's transfer to its item at `points`, besides those of memory for its record, if nothing waits and its
header is in the cache."""


class RecordFetch(wiring.Component):
    """Takes sorted pairs, delivers their Gaussians as projection takes them, and their beats for the colour unit.

    Parameters:
        config: a machine with super-tiles.

    Ports:
        sorted: ChunkItem items in rendering order; only `index` and `empty` are used. Items with `empty` are dropped.
        reads_chunks, data_chunks: read port of memory for headers; one beat for every miss, in order.
        reads_colour, data_colour: read port of memory for records: CompactColour and, where the frame has harmonics,
            CompactHarmonics of every pair, in order.
        points: GaussianPoint items, one for each pair, in order, with the pair's `index`; `end` is 0. They are those that
            `ChunkReader` gives in the first phase, bit for bit.
        beats: the beats of `data_colour` once more, in order; `error` is 0.
        chunks_base, colour_base, sh_degree: settings of the frame: where headers and records lie in memory, and whether there
            are harmonics.
        clear: strobe between frames: headers in memory may change from here on. No pair is taken while the tags are cleared,
            which takes a cycle per set (64 for V3). The same happens after a reset.
        hits, misses: pairs since `clear` whose header was, or was not, in the cache, counted two cycles after the tags' answer;
            always 0 without `config.counters`.
        error: the memory answered a read with an error since `clear`. What depends on it is undefined, but pairs pass on.
        busy: pairs or beats are inside, or tags are being cleared.

    Storage: tags, for V3 64 words of 54 bits; header lines, 256 of 26 and 256 of 112 bits; HEADERS_PENDING and
    RECORDS_PENDING pairs; HEADERS_MISSED headers; RECORD_BEATS beats. Throughput: one pair per cycle, or with harmonics one
    every two cycles, as long as memory delivers a beat in every cycle and takes 130 cycles at most, and no more than one header
    in five pairs misses. Latency: LATENCY cycles and that of memory for the record; for a header that missed, one more of
    memory.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        check_supertiles(config)
        self.config = config
        line = config.header_lines.bit_length() - 1
        self._looked = data.StructLayout({"index": CHUNK_BITS, "place": PLACE_BITS})
        self._located = data.StructLayout({"line": line, "missed": 1, "pair": self._looked})
        self._awaited = data.StructLayout({"line": line, "missed": 1, "pair": self._looked, "bound": 2})
        requests, beats = stream.Signature(layout(read_request(config))), stream.Signature(layout(read_data(config)))
        super().__init__({
            "sorted": In(stream.Signature(layout(chunk_item(config)))),
            "reads_chunks": Out(requests), "data_chunks": In(beats), "reads_colour": Out(requests), "data_colour": In(beats),
            "points": Out(stream.Signature(layout(gaussian_point(config)))), "beats": Out(beats),
            "chunks_base": In(BEAT_BITS), "colour_base": In(BEAT_BITS), "sh_degree": In(2), "clear": In(1),
            "hits": Out(COUNTER_BITS), "misses": Out(COUNTER_BITS), "error": Out(1), "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        config, lines = self.config, self.config.header_lines
        m.submodules.tags = tags = CacheTags(self._looked, lines=lines, ways=HEADER_WAYS)
        m.submodules.located = located = SyncFIFOBuffered(width=self._located.size, depth=HEADERS_PENDING)
        m.submodules.awaited = awaited = SyncFIFOBuffered(width=self._awaited.size, depth=RECORDS_PENDING)
        carried = self._located  # the line is needed again
        m.submodules.places = places = CacheLines(header_part(config, PLACING), lines, carried)
        word = data.StructLayout({"word": 8 * BEAT_BYTES // 2, "bound": 2, "pair": self._looked})
        m.submodules.shapes = shapes = CacheLines(header_part(config, DECODING), lines, word)
        busy = [
            tags.busy, places.busy, shapes.busy, located.level.any(), awaited.level.any(), self._look(m, tags, located),
            self._locate(m, located, places, shapes), self._ask(m, places, awaited), self._join(m, awaited, shapes),
            self._decode(m, shapes)]
        m.d.comb += self.busy.eq(Cat(busy).any())
        failed = Cat(port.valid & port.ready & port.payload.error for port in (self.data_chunks, self.data_colour)).any()
        m.d.sync += self.error.eq((self.error & ~self.clear) | failed)
        return m

    def _look(self, m: Module, tags: CacheTags, located: SyncFIFOBuffered) -> Value:
        """Passes pairs to the tags, and the tags' answers to the queue, and misses to memory too; both must have free space, or
        neither happens. Returns whether a request is inside."""
        m.submodules.headers = headers = Buffer(self.reads_chunks.payload.shape())
        wiring.connect(m, headers.source, wiring.flipped(self.reads_chunks))
        item, found, pair = self.sorted.payload, tags.found.payload, data.View(self._located, located.w_data)
        moves = tags.found.valid & tags.found.ready
        m.d.comb += [
            tags.clear.eq(self.clear),
            tags.wanted.valid.eq(self.sorted.valid & ~item.empty),
            tags.wanted.payload.place.eq(item.index[:PLACE_BITS]),
            tags.wanted.payload.index.eq(item.index[PLACE_BITS:]),
            self.sorted.ready.eq(item.empty | tags.wanted.ready),
            tags.found.ready.eq(located.w_rdy & headers.sink.ready),
            located.w_en.eq(moves),
            pair.line.eq(found.line), pair.missed.eq(found.missed), pair.pair.eq(found.wanted),
            headers.sink.valid.eq(tags.found.valid & located.w_rdy & found.missed),
            headers.sink.payload.beat.eq(self.chunks_base + found.wanted.index),
        ]
        if self.config.counters:  # counted a cycle later, because the tags' answer is on the critical path
            hit, missed = Signal(), Signal()
            m.d.sync += [hit.eq(moves & ~found.missed & ~self.clear), missed.eq(moves & found.missed & ~self.clear)]
            for counter, counts in ((self.hits, hit), (self.misses, missed)):
                m.d.sync += counter.eq(Mux(self.clear, 0, counter + counts))
        return headers.source.valid

    def _locate(self, m: Module, located: SyncFIFOBuffered, places: CacheLines, shapes: CacheLines) -> Value:
        """Gives every pair the place of its chunk. Headers that come go to the lines of places, and wait for those of shapes.
        Returns whether one waits."""
        waiting, header = data.View(self._located, located.r_data), data.View(
            layout(chunk_header(self.config)), self.data_chunks.payload.word.as_value()[: chunk_header(self.config).width])
        rest = header_part(self.config, DECODING)
        m.submodules.missed = missed = SyncFIFOBuffered(width=rest.size, depth=HEADERS_MISSED)
        m.d.comb += [
            places.items.valid.eq(located.r_rdy), located.r_en.eq(places.items.ready),
            places.items.payload.line.eq(waiting.line), places.items.payload.missed.eq(waiting.missed),
            places.items.payload.carried.eq(waiting),
            places.fills.valid.eq(self.data_chunks.valid & missed.w_rdy),
            self.data_chunks.ready.eq(places.fills.ready & missed.w_rdy),
            missed.w_en.eq(self.data_chunks.valid & self.data_chunks.ready),
            missed.w_data.eq(Cat(Value.cast(header[name]) for name in DECODING)),
            shapes.fills.valid.eq(missed.r_rdy), missed.r_en.eq(shapes.fills.ready), shapes.fills.payload.eq(missed.r_data),
        ]
        m.d.comb += [places.fills.payload[name].eq(header[name]) for name in PLACING]
        return missed.level.any()

    def _ask(self, m: Module, places: CacheLines, awaited: SyncFIFOBuffered) -> Value:
        """Requests the beats of every pair, and puts the pair into the queue with the first; returns whether a request is
        inside."""
        m.submodules.records = records = Buffer(self.reads_colour.payload.shape())
        wiring.connect(m, records.source, wiring.flipped(self.reads_colour))
        found, pair, two = places.found.payload, data.View(self._awaited, awaited.w_data), self.sh_degree.any()
        second, moves, first, place = Signal(), Signal(), found.content.first, found.carried.pair.place
        # one sum of three numbers, which takes little longer than one of two
        beat = self.colour_base + Mux(two, Cat(second, first), first) + Mux(two, Cat(Const(0, 1), place), place)
        m.d.comb += [
            records.sink.valid.eq(places.found.valid & (second | awaited.w_rdy)),
            records.sink.payload.beat.eq(beat),
            moves.eq(records.sink.valid & records.sink.ready),
            places.found.ready.eq(moves & (second | ~two)),
            awaited.w_en.eq(moves & ~second),
            pair.line.eq(found.carried.line), pair.missed.eq(found.carried.missed), pair.pair.eq(found.carried.pair),
            pair.bound.eq(found.content.bound),
        ]
        with m.If(moves):
            m.d.sync += second.eq(two & ~second)
        return records.source.valid

    def _join(self, m: Module, awaited: SyncFIFOBuffered, shapes: CacheLines) -> Value:
        """Gives every pair the geometry of its record, and passes all beats to their queue; returns whether one is in it."""
        width = 8 * BEAT_BYTES
        m.submodules.beats = queue = SyncFIFOBuffered(width=width, depth=RECORD_BEATS)
        waiting, beat, second, moves = data.View(self._awaited, awaited.r_data), Signal(width), Signal(), Signal()
        m.d.comb += [
            beat.eq(self.data_colour.payload.word.as_value()),
            shapes.items.valid.eq(awaited.r_rdy & self.data_colour.valid & queue.w_rdy & ~second),
            shapes.items.payload.line.eq(waiting.line), shapes.items.payload.missed.eq(waiting.missed),
            shapes.items.payload.carried.word.eq(_word(m, self.config, beat, waiting.bound)),
            shapes.items.payload.carried.bound.eq(waiting.bound), shapes.items.payload.carried.pair.eq(waiting.pair),
            awaited.r_en.eq(shapes.items.valid & shapes.items.ready),
            self.data_colour.ready.eq(queue.w_rdy & (second | awaited.r_rdy & shapes.items.ready)),
            moves.eq(self.data_colour.valid & self.data_colour.ready),
            queue.w_en.eq(moves), queue.w_data.eq(beat),
            self.beats.valid.eq(queue.r_rdy), queue.r_en.eq(self.beats.ready), self.beats.payload.word.eq(queue.r_data),
        ]
        with m.If(moves):
            m.d.sync += second.eq(self.sh_degree.any() & ~second)
        return queue.level.any()

    def _decode(self, m: Module, shapes: CacheLines) -> Value:
        """Passes pairs with their headers to the decode unit; returns whether one is inside."""
        m.submodules.decode = decode = GeometryDecode(self.config)
        wiring.connect(m, decode.points, wiring.flipped(self.points))
        found, codes = shapes.found, decode.codes
        m.d.comb += [
            codes.valid.eq(found.valid), found.ready.eq(codes.ready),
            codes.payload.index.eq(Cat(found.payload.carried.pair.place, found.payload.carried.pair.index)),
            codes.payload.bound.eq(found.payload.carried.bound), codes.payload.word.eq(found.payload.carried.word)]
        m.d.comb += [codes.payload[name].eq(found.payload.content[name]) for name in DECODING]
        inside = Signal(range(GeometryDecode.latency + 2))
        m.d.sync += inside.eq(inside + (codes.valid & codes.ready) - (self.points.valid & self.points.ready))
        return inside.any()


def _word(m: Module, config: AcceleratorConfig, beat: Signal, bound: Value) -> Value:
    """The CompactGeometry that goes with a CompactColour of this quality bound: both begin alike, and then comes the strongest
    opacity."""
    fine, rough = (data.View(layout(record), beat[: record.width])
                   for record in (compact_colour(config), compact_colour(config, coarse=True)))
    coarse = bound == COARSE_BOUND
    codes = [Signal(OPACITY_BITS, name=f"code_{level}") for level in range(MAX_LEVELS)]
    for level, code in enumerate(codes):
        held = Mux(coarse, rough.opacity[level], fine.opacity[level]) if level < FINE_LEVELS else rough.opacity[level]
        m.d.comb += code.eq(held & (bound >= level).replicate(OPACITY_BITS))
    halves = [Signal(OPACITY_BITS, name=f"strongest_{i}") for i in range(2)]
    m.d.comb += [half.eq(_larger(*codes[2 * i : 2 * i + 2])) for i, half in enumerate(halves)]
    strongest = Signal(OPACITY_BITS)
    m.d.comb += strongest.eq(_larger(*halves))
    longer, shorter = (compact_geometry(config, kind).width - OPACITY_BITS for kind in (False, True))
    return Mux(coarse, Cat(beat[:shorter], strongest), Cat(beat[:longer], strongest))


def _larger(a: Value, b: Value) -> Value:
    return Mux(a > b, a, b)
