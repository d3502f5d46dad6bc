"""The tags of the splat cache. They are looked up and updated in the order of the requests, far ahead of the data.

The low bits of a Gaussian's index choose a set of lines; the rest of the index and the level are the tag of a line. The tags of
a set are one word of memory, in which a miss replaces the oldest tag. If two requests to the same set come in consecutive
cycles, the second must see what the first wrote; the read port is therefore transparent for writes::

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

from spec.config import AcceleratorConfig
from spec.queues import CACHE_WAYS
from spec.records import INDEX_BITS

_WAY_BITS = CACHE_WAYS.bit_length() - 1


def wanted_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A request for the splat record of Gaussian `index` at tile level `level`; `blend` is passed through."""
    return data.StructLayout({"index": INDEX_BITS, "level": 2, "blend": 1})


def found_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A request, the line of its record, and whether the line must first be filled with the record."""
    return data.StructLayout({"wanted": wanted_layout(config), "line": line_bits(config), "missed": 1})


def line_bits(config: AcceleratorConfig) -> int:
    """Bits of a line's number: its way, then the low bits of the index."""
    return config.splat_cache_lines.bit_length() - 1


class SplatTags(wiring.Component):
    """Decides for each request whether it hits or misses, and which line it uses.

    Parameters:
        config: the machine; only `splat_cache_lines` is used.

    Ports:
        wanted: requests for splat records, in order.
        found: the answers, in the same order; on a miss the tags already assign the line to the new record.
        clear: strobe; invalidates every line. A request that was taken before is still answered from the old tags.
        busy: a request is inside, or tags are being cleared; while they are cleared, no request is taken.

    Storage: one word for each set; 512 x 74 bits for PAPER. Throughput: one request per cycle. Latency: 1 cycle. Clearing takes
    a cycle per set. It also runs after a reset, because the memory may then hold anything.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            "wanted": In(stream.Signature(wanted_layout(config))),
            "found": Out(stream.Signature(found_layout(config))),
            "clear": In(1),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sets, set_bits = self.config.splat_cache_lines // CACHE_WAYS, line_bits(self.config) - _WAY_BITS
        tag = data.StructLayout({"valid": 1, "above": INDEX_BITS - set_bits, "level": 2})
        word = data.StructLayout({"tags": data.ArrayLayout(tag, CACHE_WAYS), "oldest": _WAY_BITS})
        m.submodules.tags = tags = memory.Memory(shape=word, depth=sets, init=[])
        write = tags.write_port()
        read = tags.read_port(transparent_for=(write,))
        wanted, held, out = self.wanted.payload, Signal(wanted_layout(self.config), reset_less=True), self.found.payload
        occupied, clearing, place = Signal(), Signal(init=1), Signal(range(sets))
        advance, taken, key, hits = Signal(), Signal(), Signal(tag), Signal(CACHE_WAYS)
        m.d.comb += [
            advance.eq(~occupied | self.found.ready),
            self.wanted.ready.eq(advance & ~clearing),
            taken.eq(self.wanted.valid & self.wanted.ready),
            read.en.eq(taken),
            read.addr.eq(wanted.index[:set_bits]),
            key.valid.eq(1),
            key.above.eq(held.index[set_bits:]),
            key.level.eq(held.level),
            *(hits[way].eq(read.data.tags[way] == key) for way in range(CACHE_WAYS)),
            self.found.valid.eq(occupied),
            out.wanted.eq(held),
            out.missed.eq(~hits.any()),
            self.busy.eq(occupied | clearing),
        ]
        hit = Cat(Cat(hits[way] for way in range(CACHE_WAYS) if way >> bit & 1).any() for bit in range(_WAY_BITS))
        m.d.comb += out.line.eq(Cat(Mux(out.missed, read.data.oldest, hit), held.index[:set_bits]))
        with m.If(occupied):
            m.d.comb += [
                write.en.eq(self.found.ready & out.missed),
                write.addr.eq(held.index[:set_bits]),
                write.data.oldest.eq(read.data.oldest + 1),
                *(write.data.tags[way].eq(Mux(read.data.oldest == way, key, read.data.tags[way])) for way in range(CACHE_WAYS)),
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
            m.d.sync += held.eq(wanted)
        return m
