"""One lane's rows of the ring of columns: pixels are scattered ahead, and complete columns are read and cleared behind.

If several pixels fall on the same place, the one with the largest key wins. The place of a pixel is read in one cycle and, if
the pixel wins, written in the next. If the next pixel falls on the same place, it is read too early; that pixel is compared
with the pixel just written instead::

    cycle            0         1            2
    moved        <   A    ><  B        ><  C        >
    read         <   A    ><  B        ><  C        >
    compared                <  A, old  ><  B, A     >     where B's place is A's
    written                 <  A       ><  B        >

The scan reads a place and clears it in the next cycle. Places are spread over two memories, so that one read port and one write
port each are enough: neighbours along a row lie in different memories, and so do neighbours down a column. Whoever reads a
memory also writes it in the next cycle. Only the read grant is therefore arbitrated, and it always goes to a pixel. The scan
uses the cycles that pixels leave free. In each memory it runs ahead on its own, into a few registers, whenever the pixel of the
cycle uses the other memory::

    cycle            0      1      2      3      4      5      6
    memory 0     < A    >< scan >< C    >< scan >< E    >< scan >< scan >
    memory 1     < scan >< B    >< scan >< D    >< scan >< scan >< scan >      no pixels come after E
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from rtl.warp_unit.disparity import moved_layout
from rtl.warp_unit.queue import sub_bits, sub_rows
from spec.config import AcceleratorConfig
from spec.queues import WARP_AHEAD
from spec.stereo import disparity

MEMORIES = 2


def kept_layout() -> data.StructLayout:
    """A place of a strip: its colour, whether it holds a pixel, and whether that pixel is solid, that is not background."""
    return data.StructLayout({"colour": data.ArrayLayout(8, 3), "valid": 1, "solid": 1})


def place_memory(config: AcceleratorConfig, place: data.View) -> Value:
    """The memory that a place is in; the places beside, above and below it are in the other one."""
    return place.x[0] ^ place.sub[0] if sub_bits(config) else place.x[0]


def pair_bits(config: AcceleratorConfig) -> int:
    """Bits of the number of a pair of places; each pair has one place in each memory."""
    return (sub_rows(config) * config.warp_columns // MEMORIES - 1).bit_length()


class RingBank(wiring.Component):
    """A lane's part of the ring of columns.

    Parameters:
        config: the machine; `warp_columns`, `row_width` and `warp_lanes` are used.

    Ports:
        moved: a pixel, if `keep` is high; it must not fall on a place that may be scanned.
        start: strobe; the scan continues at the pairs of places `limits`. Everything before them must have been taken.
        limits: for each memory the pair of places up to which, exclusively, all places are complete; one bit more than the
            number of a pair.
        which: the memory of the next place in the scan.
        kept_valid, kept: that place.
        take: strobe; moves on to the next place.
        wipe, wipe_pair: strobe; clears the places of the pair. No pixel may come and no place may be open to the scan.

    Storage: a pixel of 25 bits and its key at each of warp_columns * 16 / warp_lanes places: for PAPER two memories of 1,024
    words of 42 bits; 8 pixels in registers. Throughput: one pixel per cycle, and one place of the scan per cycle as long as
    pixels alternate between the memories. Places are scanned in order.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        pair = pair_bits(config)
        super().__init__({
            "moved": In(moved_layout(config)),
            "start": In(1), "limits": In(pair + 1).array(MEMORIES),
            "which": In(1), "kept_valid": Out(1), "kept": Out(kept_layout()), "take": In(1),
            "wipe": In(1), "wipe_pair": In(pair),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        key_bits, moved = disparity(self.config).width, self.moved
        compared = Signal(moved_layout(self.config), reset_less=True)
        comes, wins, wrote, near, at = Signal(), Signal(), Signal(), Signal(), Signal(reset_less=True)
        key = Signal(key_bits, reset_less=True)
        m.d.sync += [comes.eq(moved.keep), wrote.eq(wins)]
        with m.If(moved.keep):
            m.d.sync += [compared.eq(moved), near.eq(moved.place.as_value() == compared.place.as_value()),
                         at.eq(place_memory(self.config, moved.place))]
        with m.If(wins):
            m.d.sync += key.eq(compared.key)
        olds, valids, heads = zip(*(self._memory(m, number, compared, wins) for number in range(MEMORIES)), strict=True)
        old_valid, old_key = Signal(), Signal(key_bits)
        m.d.comb += [
            old_valid.eq(near & wrote | Mux(at, olds[1].valid, olds[0].valid)),
            old_key.eq(Mux(near & wrote, key, Mux(at, olds[1].key, olds[0].key))),
            wins.eq(comes & (~old_valid | (compared.key > old_key))),
            self.kept_valid.eq(Mux(self.which, valids[1], valids[0])),
            self.kept.eq(Mux(self.which, heads[1], heads[0])),
        ]
        return m

    def _memory(self, m: Module, number: int, compared: data.View, wins: Value) -> tuple[data.View, Value, Value]:
        """One of the memories with its scan: the word that was read, whether the scan has a place ready, and that place."""
        bits, names = pair_bits(self.config), f"_{number}"
        word = data.StructLayout({"colour": data.ArrayLayout(8, 3), "valid": 1, "key": disparity(self.config).width})
        m.submodules[f"places{names}"] = store = memory.Memory(shape=word, depth=1 << bits, init=[])
        read, write, moved = store.read_port(), store.write_port(), self.moved
        pair, pixel, scan = Signal(bits + 1, name=f"pair{names}"), Signal(name=f"pixel{names}"), Signal(name=f"scan{names}")
        pixel_read, scan_read = Signal(name=f"pixel_read{names}"), Signal(name=f"scan_read{names}")
        address = Signal(bits, name=f"address{names}", reset_less=True)
        ready, head, room = self._ahead(m, number, read.data, scan_read)
        m.d.comb += [
            pixel.eq(moved.keep & (place_memory(self.config, moved.place) == number)),
            scan.eq((pair != self.limits[number]) & room & ~pixel & ~self.start),
            read.en.eq(pixel | scan), read.addr.eq(Mux(pixel, moved.place.as_value() >> 1, pair[:bits])),
            write.en.eq(pixel_read & wins | scan_read | self.wipe), write.addr.eq(Mux(self.wipe, self.wipe_pair, address)),
            write.data.colour.eq(compared.colour), write.data.key.eq(compared.key), write.data.valid.eq(pixel_read)]
        m.d.sync += [pixel_read.eq(pixel), scan_read.eq(scan)]
        with m.If(read.en):
            m.d.sync += address.eq(read.addr)
        with m.If(self.start):
            m.d.sync += pair.eq(self.limits[number])
        with m.Elif(scan):
            m.d.sync += pair.eq(pair + 1)
        return read.data, ready, head

    def _ahead(self, m: Module, number: int, word: data.View, comes: Value) -> tuple[Value, Value, Value]:
        """The places that the scan has read of a memory: whether there is one, the first of them, and whether there is space
        to read another."""
        kept = Array(Signal(kept_layout(), name=f"kept_{number}_{i}", reset_less=True) for i in range(WARP_AHEAD))
        first, free = (Signal(range(WARP_AHEAD), name=f"{name}_{number}") for name in ("first", "free"))
        # bit i of `more`: more than i places are stored
        more, takes = Signal(WARP_AHEAD, name=f"more_{number}"), Signal(name=f"takes_{number}")
        m.d.comb += takes.eq(self.take & (self.which == number))  # on the critical path, so no adder follows
        with m.If(takes & ~comes):
            m.d.sync += more.eq(more >> 1)
        with m.Elif(comes & ~takes):
            m.d.sync += more.eq(Cat(1, more))
        with m.If(comes):
            m.d.sync += [kept[free].colour.eq(word.colour), kept[free].valid.eq(word.valid),
                         kept[free].solid.eq(word.key.any()), free.eq(free + 1)]
        with m.If(takes):
            m.d.sync += first.eq(first + 1)
        return more[0], kept[first], ~(more[-1] | comes & more[-2])
