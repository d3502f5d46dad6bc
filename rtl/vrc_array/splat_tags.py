"""The tags of the splat cache, which are looked up and changed in the order of the requests, far ahead of the data.

Direct-mapped: the index' low bits choose the line, the rest of the index and the level are its tag. A request that follows
another to the same line in the very next cycle must see what that one wrote, so that the read port lets a write through::

    cycle            0      1      2      3
    wanted       <  A  ><  B  ><  A  >            A and B share a line
    read                <  -  ><  A  ><  B  >     the tag that was there
    write               <  A  ><  B  ><  A  >
    found               <A new><B new><A new>
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from spec.config import AcceleratorConfig
from spec.records import INDEX_BITS


def wanted_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A view wanted: of Gaussian `index` at tile level `level`; `blend` passes through."""
    return data.StructLayout({"index": INDEX_BITS, "level": 2, "blend": 1})


def found_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A view wanted, and whether its line must be filled with it first."""
    return data.StructLayout({"wanted": wanted_layout(config), "missed": 1})


def line_bits(config: AcceleratorConfig) -> int:
    """Bits of a line's number: the lowest of the index."""
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

    Storage: `splat_cache_lines` tags; for PAPER 1,024 x 17 bits. Throughput: one a cycle. Latency: 1 cycle. Clearing takes a
    cycle a line, and is done after a reset as well: memory may then hold anything.
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
        bits = line_bits(self.config)
        tag = data.StructLayout({"valid": 1, "above": INDEX_BITS - bits, "level": 2})
        m.submodules.tags = tags = memory.Memory(shape=tag, depth=self.config.splat_cache_lines, init=[])
        write = tags.write_port()
        read = tags.read_port(transparent_for=(write,))
        wanted, held, out = self.wanted.payload, Signal(wanted_layout(self.config), reset_less=True), self.found.payload
        occupied, clearing, place = Signal(), Signal(init=1), Signal(bits)
        advance, taken = Signal(), Signal()
        m.d.comb += [
            advance.eq(~occupied | self.found.ready),
            self.wanted.ready.eq(advance & ~clearing),
            taken.eq(self.wanted.valid & self.wanted.ready),
            read.en.eq(taken),
            read.addr.eq(wanted.index[:bits]),
            self.found.valid.eq(occupied),
            out.wanted.eq(held),
            out.missed.eq(~read.data.valid | (Cat(read.data.above, read.data.level) != Cat(held.index[bits:], held.level))),
            self.busy.eq(occupied | clearing),
        ]
        with m.If(occupied):
            m.d.comb += [
                write.en.eq(self.found.ready & out.missed),
                write.addr.eq(held.index[:bits]),
                write.data.valid.eq(1),
                write.data.above.eq(held.index[bits:]),
                write.data.level.eq(held.level),
            ]
        with m.Else():
            m.d.comb += [write.en.eq(clearing), write.addr.eq(place)]
            with m.If(clearing):
                m.d.sync += [place.eq(place + 1), clearing.eq(~place.all())]
        with m.If(self.clear):
            m.d.sync += [place.eq(0), clearing.eq(1)]
        with m.If(advance):
            m.d.sync += occupied.eq(taken)
        with m.If(taken):
            m.d.sync += held.eq(wanted)
        return m
