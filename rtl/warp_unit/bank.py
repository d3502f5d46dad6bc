"""A lane's rows of two strips: one is open, pixels are scattered into it; the other is closed, it is read and cleared.

Of pixels that meet at a place the one with the largest key stays. A pixel's place is read, and written in the next cycle if
the pixel wins. One that follows to the same place just then reads too early: it is compared with what was written instead::

    cycle            0         1            2
    moved        <   A    ><  B        ><  C        >
    read         <   A    ><  B        ><  C        >
    compared                <  A, old  ><  B, A     >     where B's place is A's
    written                 <  A       ><  B        >

Keys are kept of the open strip alone: a place that is not valid has none, and the closed strip needs no more than to know which
pixels are background's.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from rtl.warp_unit.disparity import moved_layout
from rtl.warp_unit.queue import place_layout, sub_rows
from spec.config import AcceleratorConfig
from spec.stereo import disparity


def kept_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A place of a strip: its colour, whether there is any, and whether that is not the background's."""
    return data.StructLayout({"colour": data.ArrayLayout(8, 3), "valid": 1, "solid": 1})


class StripBank(wiring.Component):
    """A lane's part of both strips.

    Parameters:
        config: the machine; `row_width` and `warp_lanes` matter here.

    Ports:
        open: which strip is; it changes only where no pixel came in the cycle before and nothing is read or cleared.
        moved: a pixel for it, where `keep` is high.
        read, place: strobe, the closed strip's place is read; `kept` is what was there, from the next cycle to the next read.
        clear, clear_place: strobe, the closed strip's place becomes empty.
        wipe: both strips' places become empty by `clear`; no pixel may come.

    Storage in bits: 2 * 26 and a key's at each of row_width * 16 / warp_lanes places: for PAPER two memories of 7,680 words of
    26 bits and one of 7,680 of 19. Throughput: a pixel a cycle, and a read and a clearing.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "open": In(1), "moved": In(moved_layout(config)),
            "read": In(1), "place": In(place_layout(config)), "kept": Out(kept_layout(config)),
            "clear": In(1), "clear_place": In(place_layout(config)), "wipe": In(1),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        places, key_bits = sub_rows(self.config) * self.config.row_width, disparity(self.config).width
        m.submodules.keys = keys = memory.Memory(shape=key_bits, depth=places, init=[])
        key_write, key_read = keys.write_port(), keys.read_port()
        reads, writes = [], []
        for strip in range(2):
            m.submodules[f"strip_{strip}"] = kept = memory.Memory(shape=kept_layout(self.config), depth=places, init=[])
            writes.append(kept.write_port())
            reads.append(kept.read_port())

        moved, compared = self.moved, Signal(moved_layout(self.config), reset_less=True)
        comes, wins, wrote, near = Signal(), Signal(), Signal(), Signal()
        old_valid, old_key, key = Signal(), Signal(key_bits), Signal(key_bits, reset_less=True)
        m.d.sync += [comes.eq(moved.keep), wrote.eq(wins)]
        with m.If(moved.keep):
            m.d.sync += [compared.eq(moved), near.eq(moved.place.as_value() == compared.place.as_value())]
        with m.If(wins):
            m.d.sync += key.eq(compared.key)
        m.d.comb += [
            old_valid.eq(near & wrote | Mux(self.open, reads[1].data.valid, reads[0].data.valid)),
            old_key.eq(Mux(near & wrote, key, key_read.data)),
            wins.eq(comes & (~old_valid | (compared.key > old_key))),
            key_read.en.eq(moved.keep), key_read.addr.eq(moved.place),
            key_write.en.eq(wins), key_write.addr.eq(compared.place), key_write.data.eq(compared.key),
            self.kept.eq(Mux(self.open, reads[0].data, reads[1].data)),
        ]
        for strip, (read, write) in enumerate(zip(reads, writes, strict=True)):
            scatters = Signal(name=f"scatters_{strip}")
            m.d.comb += [
                scatters.eq((self.open == strip) & ~self.wipe),
                read.en.eq(Mux(scatters, moved.keep, self.read)),
                read.addr.eq(Mux(scatters, moved.place, self.place)),
                write.en.eq(Mux(scatters, wins, self.clear)),
                write.addr.eq(Mux(scatters, compared.place, self.clear_place)),
                write.data.colour.eq(compared.colour),
                write.data.valid.eq(scatters),
                write.data.solid.eq(compared.key.any()),
            ]
        return m
