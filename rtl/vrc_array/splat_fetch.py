"""Splat fetch: adds the splat record to each sorted intersection, through a prefetching cache.

    tiles, sorted -> SplatTags -+-> pending -------> line memory -> entries
                                |                       ^
                                +-> reads ... memory ... data

The organisation is that of texture units (Igehy, Eldridge, Proudfoot 1998, "Prefetching in a Texture Cache Architecture"). Tags
are looked up and updated as intersections arrive, misses go to memory at once, and a FIFO of pending intersections covers the
latency. At the end of the FIFO, in order, the data of a miss are written to its line, and a hit reads its line. An intersection
thus finds in its line what the tags promised, however many misses on that line are pending, and no tag is compared twice.

A splat record is used only a few times: in the frames of these scenes 20 to 70 % of the intersections are the first to use
their record, and the next use is a whole tile list away. A cache of four ways with replacement in the order of filling misses
about as little as a direct-mapped cache with twice the lines if tile lists are short, and costs tags but no lines. Replacement
by last use, or other index bits to choose the set, bring nothing. The table shows the misses of 1,024 lines as a share of the
intersections (`msv2 study run splat_cache`, reports/splat_cache.md); the last column is the share of first uses:

                               direct    2 ways    4 ways    4 ways, by last use    direct, 2,048 lines    first uses
    embedded 128x128            0.829     0.807     0.792                  0.796                  0.763          0.621
    truck 640x360               0.796     0.773     0.757                  0.765                  0.721          0.399
    truck 1280x720              0.603     0.546     0.508                  0.512                  0.522          0.219
    truck 1280x720, foveated    0.647     0.592     0.553                  0.556                  0.563          0.247
    garden_large 320x180        0.959     0.954     0.951                  0.954                  0.929          0.632
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.vrc_array.splat_tags import SplatTags, line_bits
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request, splat_record
from spec.queues import COUNTER_BITS, VIEWS_PENDING
from spec.records import array_splat, chunk_item, tile_use

LATENCY = 5
"""Cycles from an intersection's transfer to its record at `entries` if nothing waits and the record is in the cache."""

class SplatFetch(wiring.Component):
    """Takes intersections with the index of their splat, delivers them with its record.

    Parameters:
        config: the machine.
        pending: intersections that may wait for memory, 1 or more.

    Ports:
        sorted: ChunkItem items in rendering order; only `index` and `empty` are used. Items with `empty` are dropped.
        tiles: TileUse items of every tile, in the order of the intersections.
        entries: ArraySplat items, as many as the counts of `tiles`, in order.
        reads, data: the memory's read port; one beat for every miss, in order.
        views_base, view_shift: settings of the frame: where the splat records lie in memory.
        clear: strobe between frames: the records in memory may change from here on. No intersection is taken while the tags are
            cleared, which takes a cycle per set (512 for PAPER). The same happens after a reset.
        hits, misses: intersections since `clear`, counted two cycles after the tags' answer; always 0 without
            `config.counters`.
        error: the memory answered a read with an error since `clear`. The intersection left, with an undefined record.
        busy: intersections are inside, or a tile that was taken expects more of them, or tags are being cleared.

    Storage: that of `SplatTags`; `splat_cache_lines` records, for PAPER 2,048 x 222 bits, never read and written in the same
    cycle; `pending` intersections of a line number and 4 bits each. Throughput: one intersection per cycle, hits and misses
    alike, as long as memory delivers a beat per miss; an empty tile takes a cycle. Latency: LATENCY cycles, plus that of memory
    for a miss.
    """

    def __init__(self, config: AcceleratorConfig, *, pending: int = VIEWS_PENDING):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(pending, int) or isinstance(pending, bool):
            raise TypeError(f"pending must be an integer, not {pending!r}")
        if pending < 1:
            raise ValueError(f"pending must be 1 or more, not {pending!r}")
        self.config, self.pending = config, pending
        super().__init__({
            "sorted": In(stream.Signature(layout(chunk_item(config)))),
            "tiles": In(stream.Signature(layout(tile_use(config)))),
            "entries": Out(stream.Signature(layout(array_splat(config)))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "views_base": In(BEAT_BITS),
            "view_shift": In(2),
            "clear": In(1),
            "hits": Out(COUNTER_BITS),
            "misses": Out(COUNTER_BITS),
            "error": Out(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.tags = tags = SplatTags(self.config)
        m.submodules.requests = requests = Buffer(self.reads.payload.shape())
        pending = data.StructLayout({"line": line_bits(self.config), "missed": 1, "level": 2, "blend": 1})
        m.submodules.pending = fifo = SyncFIFOBuffered(width=pending.size, depth=self.pending)
        m.d.comb += tags.clear.eq(self.clear)
        wiring.connect(m, requests.source, wiring.flipped(self.reads))
        wanted = self._want(m, tags)
        self._ask(m, tags, requests, fifo, data.View(pending, fifo.w_data))
        inside = self._deliver(m, fifo, data.View(pending, fifo.r_data))
        m.d.comb += self.busy.eq(wanted | tags.busy | requests.source.valid | fifo.level.any() | inside)
        return m

    def _want(self, m: Module, tags: SplatTags) -> Value:
        """Passes intersections with the level of their tile to the tags; returns whether the current tile expects more."""
        tile, item, wanted = self.tiles.payload, self.sorted.payload, tags.wanted
        left, level, blend = Signal.like(tile.count), Signal(2, reset_less=True), Signal(reset_less=True)
        taken = wanted.valid & wanted.ready
        m.d.comb += [
            wanted.valid.eq(self.sorted.valid & ~item.empty & left.any()),
            wanted.payload.index.eq(item.index),
            wanted.payload.level.eq(level),
            wanted.payload.blend.eq(blend),
            self.sorted.ready.eq(item.empty | wanted.ready & left.any()),
            self.tiles.ready.eq((left == 0) | taken & (left == 1)),
        ]
        with m.If(taken):
            m.d.sync += left.eq(left - 1)
        with m.If(self.tiles.valid & self.tiles.ready):
            m.d.sync += [left.eq(tile.count), level.eq(tile.level), blend.eq(tile.blend)]
        return left.any()

    def _ask(self, m: Module, tags: SplatTags, requests: Buffer, fifo: SyncFIFOBuffered, pending: data.View) -> None:
        """Passes the tags' answers to the FIFO, and misses to memory too; both must have free space, or neither happens."""
        found, wanted = tags.found.payload, tags.found.payload.wanted
        moves = tags.found.valid & tags.found.ready
        m.d.comb += [
            tags.found.ready.eq(fifo.w_rdy & requests.sink.ready),
            fifo.w_en.eq(moves),
            pending.line.eq(found.line),
            pending.missed.eq(found.missed),
            pending.level.eq(wanted.level),
            pending.blend.eq(wanted.blend),
            requests.sink.valid.eq(tags.found.valid & fifo.w_rdy & found.missed),
            requests.sink.payload.beat.eq(self.views_base + (wanted.index << self.view_shift) + wanted.level),
        ]
        if self.config.counters:  # counted a cycle later, because the tags' answer is on the critical path
            hit, missed = Signal(), Signal()
            m.d.sync += [hit.eq(moves & ~found.missed & ~self.clear), missed.eq(moves & found.missed & ~self.clear)]
            for counter, counts in ((self.hits, hit), (self.misses, missed)):
                m.d.sync += counter.eq(Mux(self.clear, 0, counter + counts))

    def _deliver(self, m: Module, fifo: SyncFIFOBuffered, pending: data.View) -> Value:
        """Fills and reads lines in order and registers `entries`; returns whether anything is behind the FIFO.

        A record that arrives from memory bypasses its line, because the line is written in that cycle and cannot be read.
        """
        record_layout = layout(splat_record(self.config))
        m.submodules.lines = lines = memory.Memory(shape=record_layout, depth=self.config.splat_cache_lines, init=[])
        write, read = lines.write_port(), lines.read_port(transparent_for=())
        beat, entry = Signal(record_layout), Signal(self.entries.payload.shape(), reset_less=True)
        came, passed, passes = Signal(record_layout, reset_less=True), Signal(), Signal(reset_less=True)
        level, blend = Signal(2, reset_less=True), Signal(reset_less=True)
        room, leaves, moves = Signal(), Signal(), Signal()
        m.d.comb += [
            leaves.eq(~self.entries.valid | self.entries.ready),
            room.eq(~passed | leaves),
            moves.eq(fifo.r_rdy & room & (self.data.valid | ~pending.missed)),
            fifo.r_en.eq(moves),
            self.data.ready.eq(fifo.r_rdy & room & pending.missed),
            beat.as_value().eq(self.data.payload.word.as_value()),
            read.en.eq(moves & ~pending.missed),
            read.addr.eq(pending.line),
            write.en.eq(moves & pending.missed),
            write.addr.eq(pending.line),
            write.data.eq(beat),
            self.entries.payload.eq(entry),
        ]
        with m.If(room):
            m.d.sync += passed.eq(moves)
        with m.If(moves):
            m.d.sync += [level.eq(pending.level), blend.eq(pending.blend), passes.eq(pending.missed)]
        with m.If(write.en):
            m.d.sync += came.eq(beat)
        with m.If(leaves):
            m.d.sync += self.entries.valid.eq(passed)
        with m.If(leaves & passed):
            view = record_layout(Mux(passes, came.as_value(), read.data.as_value()))
            m.d.sync += [entry[name].eq(view[name]) for name in ("mean2d", "conic", "log2_opacity", "colour", "depth")]
            m.d.sync += [entry.use[0].eq(view.bound >= level), entry.use[1].eq(blend & (view.bound > level))]
        m.d.sync += self.error.eq((self.error & ~self.clear) | self.data.valid & self.data.ready & self.data.payload.error)
        return passed | self.entries.valid
