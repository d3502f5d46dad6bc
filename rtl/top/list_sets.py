"""The lists of both frames in flight, in machines whose phases overlap."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.frame import setting_ports
from rtl.shapes import layout
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.supertiles.bucket_ports import bucket_ports
from rtl.supertiles.buckets import depth_buckets
from spec.config import AcceleratorConfig
from spec.records import intersection_tile

_SETTINGS = ("beta", "auto_beta")


class ListSets(wiring.Component):
    """Two sets of depth buckets and tile merge unit, one for the frame in each phase::

        pairs ─► depth_buckets ─► entries                    hits ─► TileMergeUnit        first phase
                                                                            │
                                  listed ◄─ depth_buckets ◄─────────────────┘             second phase

    A frame uses the same set in both phases, so that the bounds of its lists are those that the frame before the last has made.
    Merging begins when a frame's last hit has come; what it finds waits for the second phase.

    Parameters:
        config: the machine, with overlapped phases.

    Ports:
        which: the set of the first phase, 0 or 1; the second phase has the other one. It changes only where the first phase has
            ended since `clear`, and the second one has ended, too.
        settings `beta`, `auto_beta`: those of the frame in its first phase; second_beta, second_auto_beta: in its second.
        pairs, entries, supertile_count, list_count, clear, busy: those of the set of the first phase (`bucket_ports`).
        listed, sorted_item, sorted_taken: those of the set of the second phase.
        hits: IntersectionTile items for the tile merge unit of the first phase.
        ready: the first phase's tile merge unit has nothing of a frame, and its counters are clear.
        saturated: a list of the frame in its first phase has more pairs than can be counted, or a pair's list is not one of the
            frame.

    Storage, throughput and latency: those of `depth_buckets` and `TileMergeUnit`, twice.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.overlap:
            raise ValueError(f"overlap must be True, not {config.overlap!r}")
        self.config = config
        ports, settings = bucket_ports(config), setting_ports(config, _SETTINGS)
        super().__init__({
            **{name: member for name, member in ports.items() if name not in ("groups", "forget")}, **settings,
            **{f"second_{name}": member for name, member in settings.items()},
            "which": In(1), "hits": In(stream.Signature(layout(intersection_tile(config)))), "ready": Out(1),
            "saturated": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sets = [(depth_buckets(self.config), TileMergeUnit(self.config)) for _ in range(2)]
        for number, (buckets, merge) in enumerate(sets):
            m.submodules[f"buckets_{number}"], m.submodules[f"tile_merge_{number}"] = buckets, merge
            self._connect(m, self.which == number, buckets, merge)
        (one, one_merge), (two, two_merge) = sets
        m.d.comb += [
            self.pairs.ready.eq(Mux(self.which, two.pairs.ready, one.pairs.ready)),
            self.hits.ready.eq(Mux(self.which, two_merge.hits.ready, one_merge.hits.ready)),
            self.entries.valid.eq(Mux(self.which, two.entries.valid, one.entries.valid)),
            self.entries.payload.eq(Mux(self.which, two.entries.payload, one.entries.payload)),
            self.listed.valid.eq(Mux(self.which, one.listed.valid, two.listed.valid)),
            self.listed.payload.eq(Mux(self.which, one.listed.payload, two.listed.payload)),
            self.list_count.eq(Mux(self.which, two.list_count, one.list_count)),
            self.busy.eq(Mux(self.which, two.busy, one.busy)),
            self.ready.eq(~Mux(self.which, two_merge.busy, one_merge.busy)),
            self.saturated.eq(Mux(self.which, two_merge.saturated | two_merge.outside,
                                  one_merge.saturated | one_merge.outside))]
        return m

    def _connect(self, m: Module, first: Signal, buckets: wiring.Component, merge: TileMergeUnit) -> None:
        """Connects a set, which serves the first phase where `first` is high."""
        count = Signal.like(self.supertile_count)
        with m.If(self.clear & first):
            m.d.sync += count.eq(self.supertile_count)
        wiring.connect(m, merge.groups, buckets.groups)
        m.d.comb += [
            buckets.supertile_count.eq(Mux(self.clear & first, self.supertile_count, count)),
            buckets.clear.eq(self.clear & first),
            buckets.pairs.valid.eq(self.pairs.valid & first), buckets.pairs.payload.eq(self.pairs.payload),
            buckets.entries.ready.eq(self.entries.ready & first),
            buckets.listed.ready.eq(self.listed.ready & ~first),
            buckets.sorted_item.eq(self.sorted_item), buckets.sorted_taken.eq(self.sorted_taken & ~first),
            merge.hits.valid.eq(self.hits.valid & first), merge.hits.payload.eq(self.hits.payload),
            merge.tiles_x.eq(buckets.list_count), merge.tile_count.eq(buckets.list_count),
            merge.beta.eq(Mux(first, self.beta, self.second_beta)),
            merge.auto.eq(Mux(first, self.auto_beta, self.second_auto_beta))]
