"""A lane's rows of two strips: one is open, pixels are scattered into it; the other is closed, it is read and cleared.

Of pixels that meet at a place the one with the largest key stays. Its place is read, compared and written in three cycles, in
which up to two others may follow it to the same place: what they write is compared with instead of what memory gave::

    cycle            0         1            2
    moved        <   A    ><  B        ><  C        >
    read         <   A    ><  B        ><  C        >
    compared                <  A, old  ><  B, A     >     where B's place is A's
    written                             <  A        >

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
        open: which strip is; it changes only where no pixel came for three cycles and nothing is read or cleared.
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

        moved = self.moved
        compared, written = (Signal(moved_layout(self.config), name=name, reset_less=True) for name in ("compared", "written"))
        comes, replaces = Signal(), Signal()
        old_valid, old_key = Signal(), Signal(key_bits)
        self._old(m, compared, written, replaces, key_read.data, Mux(self.open, reads[1].data.valid, reads[0].data.valid),
                  old_valid, old_key)
        wins = Signal()
        m.d.comb += wins.eq(comes & (~old_valid | (compared.key > old_key)))
        m.d.sync += [comes.eq(moved.keep), replaces.eq(wins)]
        with m.If(moved.keep):
            m.d.sync += compared.eq(moved)
        with m.If(comes):
            m.d.sync += written.eq(compared)

        m.d.comb += [
            key_read.en.eq(moved.keep), key_read.addr.eq(moved.place),
            key_write.en.eq(replaces), key_write.addr.eq(written.place), key_write.data.eq(written.key),
            self.kept.eq(Mux(self.open, reads[0].data, reads[1].data)),
        ]
        for strip, (read, write) in enumerate(zip(reads, writes, strict=True)):
            scatters = Signal(name=f"scatters_{strip}")
            m.d.comb += [
                scatters.eq((self.open == strip) & ~self.wipe),
                read.en.eq(Mux(scatters, moved.keep, self.read)),
                read.addr.eq(Mux(scatters, moved.place, self.place)),
                write.en.eq(Mux(scatters, replaces, self.clear)),
                write.addr.eq(Mux(scatters, written.place, self.clear_place)),
                write.data.colour.eq(written.colour),
                write.data.valid.eq(scatters),
                write.data.solid.eq(written.key.any()),
            ]
        return m

    def _old(
        self, m: Module, compared: data.View, written: data.View, replaces: Signal, key: Signal, valid: Signal,
        old_valid: Signal, old_key: Signal,
    ) -> None:
        """What lies at the place of `compared`: what is being written, what was the cycle before, or what memory gave."""
        near, far, just_wrote, just_key = Signal(), Signal(), Signal(), Signal.like(old_key, reset_less=True)
        place = self.moved.place.as_value()
        m.d.sync += just_wrote.eq(replaces)
        with m.If(replaces):
            m.d.sync += just_key.eq(written.key)
        with m.If(self.moved.keep):
            m.d.sync += [near.eq(place == compared.place.as_value()), far.eq(place == written.place.as_value())]
        by_near, by_far = near & replaces, far & just_wrote
        m.d.comb += [
            old_valid.eq(by_near | by_far | valid),
            old_key.eq(Mux(by_near, written.key, Mux(by_far, just_key, key)))]
