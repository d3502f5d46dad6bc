"""The tags of the splat cache, which are looked up and changed in the order of the requests, far ahead of the data.

The index' low bits choose a set of lines; the rest of the index and the level are a line's tag. A set's tags are one word,
in which a miss replaces the tag that came first. A request that follows another to the same set in the very next cycle must see
what that one wrote, so that the read port lets a write through::

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
    """A view wanted: of Gaussian `index` at tile level `level`; `blend` passes through."""
    return data.StructLayout({"index": INDEX_BITS, "level": 2, "blend": 1})


def found_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A view wanted, its line, and whether that must be filled with it first."""
    return data.StructLayout({"wanted": wanted_layout(config), "line": line_bits(config), "missed": 1})


def line_bits(config: AcceleratorConfig) -> int:
    """Bits of a line's number: its way, then the lowest of the index."""
    return config.splat_cache_lines.bit_length() - 1


class SplatTags(wiring.Component):
    """Hit or miss.

    Parameters:
        config: the machine; `splat_cache_lines` matters here.

    Ports:
        wanted: views, in the order in which they are wanted.
        found: the same; a miss has taken over its line in the tags.
        clear: strobe, no line is valid any more. What was taken before is still answered out of the old tags.
        busy: a view is inside, or tags are being cleared; then nothing is taken.

    Storage: a word for each set; for PAPER 512 x 74 bits. Throughput: one a cycle. Latency: 1 cycle. Clearing takes a cycle a
    set, and is done after a reset as well: memory may then hold anything.
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

    def elaborate(self, platform) -> Module:
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
