"""The lines of a prefetching cache, behind its tags (`rtl.cache_tags`), and the fields of chunk headers that records need."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.chunks import chunk_header
from spec.config import AcceleratorConfig

PLACING = ("bound", "first")
"""Fields of a header that a record's address depends on, and the kind of its fields."""

DECODING = ("low", "step", "scale_top")
"""Fields of a header that its Gaussians' geometry is relative to."""


def header_part(config: AcceleratorConfig, names: tuple[str, ...]) -> data.StructLayout:
    """Layout of some fields of a ChunkHeader."""
    header = layout(chunk_header(config))
    return data.StructLayout({name: header[name].shape for name in names})


class CacheLines(wiring.Component):
    """Gives every item the content of its line. An item that missed first fills its line.

    As all items pass in the order in which the tags saw them, an item finds in its line what the tags promised.

    Parameters:
        content: layout of a line.
        lines: number of lines.
        carried: layout of what an item brings besides.

    Ports:
        items: `line`, `missed` and `carried` of each item.
        fills: contents of lines, one for each item that missed, in order.
        found: `content` of each item's line and its `carried`.
        busy: an item is inside.

    Storage: a memory of `lines` contents, never read and written in the same cycle. Throughput: one item per cycle. Latency: 2
    cycles, as the memory's output is registered. A content that comes bypasses its line, because the line is written in that
    cycle and cannot be read::

        cycle       0      1      2      3      4
        items       < A   hit    >< B   >< C    >       A waits for `found` to move, B misses
        fills                     < b   >
        memory                    read A  write b  read C
        found                                   < A   >< B    >
    """

    def __init__(self, content: data.StructLayout, lines: int, carried: data.StructLayout):
        self._content, self._lines, self._carried = content, lines, carried
        super().__init__({
            "items": In(stream.Signature(data.StructLayout({
                "line": (lines - 1).bit_length(), "missed": 1, "carried": carried}))),
            "fills": In(stream.Signature(content)),
            "found": Out(stream.Signature(data.StructLayout({"content": content, "carried": carried}))),
            "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.lines = lines = memory.Memory(shape=self._content, depth=self._lines, init=[])
        write, read = lines.write_port(), lines.read_port(transparent_for=())
        item, found = self.items.payload, Signal(self.found.payload.shape(), reset_less=True)
        came, passes = Signal(self._content, reset_less=True), Signal(reset_less=True)
        carried, passed = Signal(self._carried, reset_less=True), Signal()
        free, leaves, moves = Signal(), Signal(), Signal()
        m.d.comb += [
            leaves.eq(~self.found.valid | self.found.ready),
            free.eq(~passed | leaves),
            self.items.ready.eq(free & (self.fills.valid | ~item.missed)),
            moves.eq(self.items.valid & self.items.ready),
            self.fills.ready.eq(self.items.valid & free & item.missed),
            read.en.eq(moves & ~item.missed), read.addr.eq(item.line),
            write.en.eq(moves & item.missed), write.addr.eq(item.line), write.data.eq(self.fills.payload),
            self.found.payload.eq(found),
            self.busy.eq(passed | self.found.valid),
        ]
        with m.If(free):
            m.d.sync += passed.eq(moves)
        with m.If(moves):
            m.d.sync += [carried.eq(item.carried), passes.eq(item.missed)]
        with m.If(write.en):
            m.d.sync += came.eq(self.fills.payload)
        with m.If(leaves):
            m.d.sync += self.found.valid.eq(passed)
        with m.If(leaves & passed):
            m.d.sync += [found.carried.eq(carried), found.content.eq(Mux(passes, came.as_value(), read.data.as_value()))]
        return m
