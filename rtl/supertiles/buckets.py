"""Gives pairs their lists: with depth buckets or, without, one list for each super-tile."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import wiring

from rtl.supertiles.bucket_ports import bucket_ports
from rtl.supertiles.depth_buckets import DepthBuckets
from spec.config import AcceleratorConfig
from spec.records import tile_group


class SingleLists(wiring.Component):
    """Gives the pairs of each super-tile one list, which has the super-tile's number. It has no storage and no latency.

    Parameters:
        config: the machine; `row_width` and `list_heads` matter here.

    Ports: `bucket_ports`. The unit makes no bounds, so it does not look at what is sorted.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__(bucket_ports(config))
        self.config = config

    def elaborate(self, platform: object) -> Module:
        m = Module()
        pair, entry, group, listed = (port.payload for port in (self.pairs, self.entries, self.groups, self.listed))
        m.d.comb += [
            self.entries.valid.eq(self.pairs.valid), self.pairs.ready.eq(self.entries.ready),
            entry.index.eq(pair.index), entry.depth_key.eq(pair.depth_key), entry.tile.eq(pair.supertile),
            entry.end.eq(pair.end),
            self.listed.valid.eq(self.groups.valid), self.groups.ready.eq(self.listed.ready),
            *(listed[f.name].eq(group[f.name]) for f in tile_group(self.config).fields), listed.ends.eq(1),
            self.list_count.eq(self.supertile_count),
        ]
        return m


def depth_buckets(config: AcceleratorConfig) -> wiring.Component:
    """The unit that gives pairs their lists in this machine; its ports are `bucket_ports`."""
    return DepthBuckets(config) if config.buckets else SingleLists(config)
