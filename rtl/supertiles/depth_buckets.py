"""Depth buckets: lists of super-tiles by the depth of their pairs, with bounds that the frame before has made
(`spec.supertiles`)."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory, wiring

from rtl.supertiles.bounds_maker import BoundsMaker
from rtl.supertiles.bucket_ports import bucket_ports
from rtl.supertiles.bucket_search import BucketSearch
from spec.config import AcceleratorConfig
from spec.records import frame_lists, tile_group
from spec.supertiles import BUCKET_PAIRS, supertile_index


class DepthBuckets(wiring.Component):
    """Gives the pairs of each super-tile lists by their depth, and makes the bounds of the next frame.

    All pairs of a frame have left `entries` before the first of them leaves the sorter, and a list has left `listed` before any
    of its pairs does: the tables of the search are written while the frame is sorted, and the super-tiles of lists are learnt
    from `groups`.

    Parameters:
        config: the machine; `row_width`, `list_heads` and the format of the depth key matter here.
        every: pairs between two bounds, 2 or more.

    Ports: `bucket_ports`.

    Storage: for each super-tile of the largest frame its first list and its number of bounds; for each list four copies of a
    bound, its super-tile, and two bits. Throughput: one pair, one list and one sorted pair per cycle. Latency: 16 cycles from
    `pairs` to `entries`, one from `groups` to `listed`.
    """

    def __init__(self, config: AcceleratorConfig, *, every: int = BUCKET_PAIRS):
        super().__init__(bucket_ports(config))
        if not isinstance(every, int) or isinstance(every, bool):
            raise TypeError(f"every must be an integer, not {every!r}")
        if every < 2:
            raise ValueError(f"every must be 2 or more, not {every!r}")
        self.config, self._every = config, every

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.search = search = BucketSearch(self.config)
        m.submodules.maker = maker = BoundsMaker(self.config, self._every)
        wiring.connect(m, wiring.flipped(self.pairs), search.pairs)
        wiring.connect(m, search.entries, wiring.flipped(self.entries))
        lists = frame_lists(self.config)
        numbering, bank, made_for = Signal.like(maker.numbering), Signal(), Signal.like(self.supertile_count)
        keeps = (made_for == self.supertile_count) & ~self.forget
        m.d.comb += [
            search.numbering.eq(numbering), search.row.eq(maker.row),
            maker.item.eq(self.sorted_item), maker.taken.eq(self.sorted_taken),
            maker.clear.eq(self.clear), maker.forget.eq(self.forget), maker.limit.eq(lists - self.supertile_count),
            self.busy.eq(maker.busy | search.bound.en),
        ]
        m.d.sync += search.bound.eq(maker.bound)  # its address goes to one memory for each step of the search
        with m.If(self.clear):
            m.d.sync += [bank.eq(~bank), made_for.eq(self.supertile_count), numbering.eq(0)]
            m.d.sync += self.list_count.eq(Mux(keeps, lists - maker.left, self.supertile_count))
            with m.If(keeps):
                m.d.sync += numbering.eq(maker.numbering)
        self._list(m, maker, numbering.at, bank)
        return m

    def _list(self, m: Module, maker: BoundsMaker, at: Signal, bank: Signal) -> None:
        """Passes lists on, marks the last one of each super-tile, and keeps the super-tile of each for the maker of bounds.
        From list `at` on every list is a super-tile's last; one bank of the memory says which of the others are, the other one
        is written for the next frame."""
        lists = frame_lists(self.config)
        m.submodules.ends = ends = memory.Memory(shape=1, depth=2 * lists, init=[])
        m.submodules.owners = owners = memory.Memory(shape=supertile_index(self.config), depth=lists, init=[])
        ends_write, ends_read = ends.write_port(), ends.read_port()
        owner_write, owner_read = owners.write_port(), owners.read_port()
        group, listed, moves = self.groups.payload, self.listed.payload, Signal()
        alone, supertile, taken = Signal(reset_less=True), Signal(supertile_index(self.config)), Signal()
        m.d.comb += [
            moves.eq(~self.listed.valid | self.listed.ready), self.groups.ready.eq(moves),
            ends_read.addr.eq(Cat(bank, group.tile)), ends_read.en.eq(moves & self.groups.valid),
            ends_write.addr.eq(Cat(~bank, maker.ends.list)), ends_write.en.eq(maker.ends.en),
            ends_write.data.eq(maker.ends.ends),
            listed.ends.eq(alone | ends_read.data), taken.eq(self.listed.valid & self.listed.ready),
            owner_write.addr.eq(listed.tile), owner_write.data.eq(supertile), owner_write.en.eq(taken),
            owner_read.addr.eq(maker.owner_list), maker.owner.eq(owner_read.data),
        ]
        with m.If(moves):
            m.d.sync += self.listed.valid.eq(self.groups.valid)
            with m.If(self.groups.valid):
                m.d.sync += [listed[f.name].eq(group[f.name]) for f in tile_group(self.config).fields]
                m.d.sync += alone.eq(group.tile >= at)
        with m.If(self.clear):
            m.d.sync += supertile.eq(0)
        with m.Elif(taken):
            m.d.sync += supertile.eq(supertile + listed.ends)
