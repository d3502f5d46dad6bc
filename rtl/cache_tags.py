"""The tags of a prefetching cache. They are looked up and updated in the order of the requests, far ahead of the data.

The low bits of a request's index choose a set of lines; the rest of the index, and further fields if the cache has any, are the
tag of a line. The tags of a set are one word of memory, in which a miss replaces the oldest tag. If two requests to the same
set come in consecutive cycles, the second must see what the first wrote; the read port is therefore transparent for writes::

    cycle            0      1      2
    wanted       <  A  ><  A  >
    read                <  -  ><  A  >            the set's word
    write               <  A  >
    found               <A new><A hit>
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out


def found_layout(wanted: data.StructLayout, lines: int) -> data.StructLayout:
    """A request, the line of its data, and whether the line must first be filled with them."""
    return data.StructLayout({"wanted": wanted, "line": lines.bit_length() - 1, "missed": 1})


class CacheTags(wiring.Component):
    """Decides for each request whether it hits or misses, and which line it uses.

    Parameters:
        request: layout of a request. Its field `index` chooses the set and is the tag; other fields are passed through.
        lines: number of lines, a power of two. The number of a line is its way, above the bits that choose the set.
        ways: lines of a set, a power of two and at least 2.
        tagged: further fields of a request that belong to the tag.

    Ports:
        wanted: requests, in order.
        found: the answers (`found_layout`), in the same order; on a miss the tags already assign the line to the new data.
        clear: strobe; invalidates every line. A request that was taken before is still answered from the old tags.
        busy: a request is inside, or tags are being cleared; while they are cleared, no request is taken.

    Storage: one word for each set. Throughput: one request per cycle. Latency: 1 cycle. Clearing takes a cycle per set. It also
    runs after a reset, because the memory may then hold anything.
    """

    def __init__(self, request: data.StructLayout, *, lines: int, ways: int, tagged: tuple[str, ...] = ()):
        self._request, self._lines, self._ways, self._tagged = request, lines, ways, tagged
        super().__init__({
            "wanted": In(stream.Signature(request)),
            "found": Out(stream.Signature(found_layout(request, lines))),
            "clear": In(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        ways, way_bits = self._ways, self._ways.bit_length() - 1
        sets = self._lines // ways
        set_bits, members = sets.bit_length() - 1, self._request.members
        tag = data.StructLayout({
            "valid": 1, "above": members["index"] - set_bits, **{name: members[name] for name in self._tagged}})
        word = data.StructLayout({"tags": data.ArrayLayout(tag, ways), "oldest": way_bits})
        m.submodules.tags = tags = memory.Memory(shape=word, depth=sets, init=[])
        write = tags.write_port()
        read = tags.read_port(transparent_for=(write,))
        wanted, found = self.wanted.payload, self.found.payload
        out = Signal(self._request, reset_less=True)
        occupied, clearing, place = Signal(), Signal(init=1), Signal(range(sets))
        advance, taken, key, hits = Signal(), Signal(), Signal(tag), Signal(ways)
        m.d.comb += [
            advance.eq(~occupied | self.found.ready),
            self.wanted.ready.eq(advance & ~clearing),
            taken.eq(self.wanted.valid & self.wanted.ready),
            read.en.eq(taken),
            read.addr.eq(wanted.index[:set_bits]),
            key.valid.eq(1),
            key.above.eq(out.index[set_bits:]),
            *(key[name].eq(out[name]) for name in self._tagged),
            *(hits[way].eq(read.data.tags[way] == key) for way in range(ways)),
            self.found.valid.eq(occupied),
            found.wanted.eq(out),
            found.missed.eq(~hits.any()),
            self.busy.eq(occupied | clearing),
        ]
        hit = Cat(Cat(hits[way] for way in range(ways) if way >> bit & 1).any() for bit in range(way_bits))
        m.d.comb += found.line.eq(Cat(Mux(found.missed, read.data.oldest, hit), out.index[:set_bits]))
        with m.If(occupied):
            m.d.comb += [
                write.en.eq(self.found.ready & found.missed),
                write.addr.eq(out.index[:set_bits]),
                write.data.oldest.eq(read.data.oldest + 1),
                *(write.data.tags[way].eq(Mux(read.data.oldest == way, key, read.data.tags[way])) for way in range(ways)),
            ]
        with m.Else():
            m.d.comb += [write.en.eq(clearing), write.addr.eq(place)]
            with m.If(clearing):
                m.d.sync += [place.eq(place + 1), clearing.eq(place != sets - 1)]
        with m.If(self.clear):
            m.d.sync += [place.eq(0), clearing.eq(1)]
        with m.If(advance):
            m.d.sync += occupied.eq(taken)
        with m.If(taken):
            m.d.sync += out.eq(wanted)
        return m
