"""The precise level of the hierarchical sorting unit: sorts chunks of intersections at one intersection per cycle."""

from __future__ import annotations

from itertools import pairwise

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from rtl.sort_tmu.merge_stage import Kind, MergeStage
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.records import chunk_item, intersection


class ChunkSorter(wiring.Component):
    """Sorts chunks of up to `sort_chunk` intersections by (native tile, depth key, index); chunks keep their order.

    The sorter is a chain of log2(capacity) `MergeStage`s. The run length doubles from stage to stage, so that all stages
    together store two chunks. The storage of the paper's double buffer ahead of its sorter is thus the sorter itself.

    Parameters:
        config: the machine; only `sort_buffer_bytes`, `row_width` and the format of the depth key are used.

    Ports:
        chunks: ChunkItem items. A chunk ends with `last`; an empty chunk is a single item with `last` and `empty`.
        sorted: the same chunks, each sorted. The order is total, because two equal records would be the same Gaussian in the
            same tile.
        oversize: strobe; the intersection being taken exceeds the capacity of its chunk. The chunk then leaves as several
            sorted runs of `sort_chunk` intersections, one after another, and only its very end carries `last`.
        busy: at least one item is inside.

    Storage: memories of 2, 4, ... capacity items, each an Intersection and 3 bits. For PAPER these are 8,190 items of 65
        bits, so
    532,350 bits against the 524,288 bits of the paper's 64 KB. Each stage also holds two items in registers, and there is a
    register for one item between stages.
    Throughput: one intersection per cycle at both ports, also from chunk to chunk. Latency: the first of n intersections leaves
    about n + log2(capacity) cycles after it was taken. If n is at most half the capacity it leaves n cycles later still,
    because a stage learns only from the end of the chunk that a run has no second run to merge with.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if intersection(config).width > 8 * ENTRY_BYTES:
            raise ValueError(f"row_width must leave an entry {8 * ENTRY_BYTES} bits, not {config.row_width!r}")
        self.config, self.capacity = config, config.sort_chunk
        items = stream.Signature(layout(chunk_item(config)))
        super().__init__({"chunks": In(items), "sorted": Out(items), "oversize": Out(1), "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        width = intersection(self.config).width
        stages = [MergeStage(width, 1 << k) for k in range(self.capacity.bit_length() - 1)]
        for k, stage in enumerate(stages):
            m.submodules[f"stage_{k}"] = stage
        for stage, following in pairwise(stages):
            wiring.connect(m, stage.source, following.sink)

        first, last = stages[0].sink, stages[-1].source
        item, out = self.chunks.payload, self.sorted.payload
        taken, left = self.chunks.valid & self.chunks.ready, self.sorted.valid & self.sorted.ready
        place = Signal(range(2 * self.capacity))  # position in the chunk; the top bit stays set once it is set
        after, top = place + 1, len(place) - 1
        m.d.comb += [
            self.chunks.ready.eq(first.ready),
            first.valid.eq(self.chunks.valid),
            first.payload.word.eq(Cat(item[f.name] for f in intersection(self.config).fields)),
            first.payload.last.eq(item.last),
            first.payload.kind.eq(
                Mux(item.empty, Kind.EMPTY, Mux(place[0], Kind.SECOND, Mux((place == 0) & item.last, Kind.WHOLE, Kind.FIRST)))),
            self.oversize.eq(taken & place[top]),
        ]
        with m.If(taken):
            m.d.sync += place.eq(Mux(item.last, 0, Cat(after[:top], after[top] | place[top])))
        m.d.comb += [
            last.ready.eq(self.sorted.ready),
            self.sorted.valid.eq(last.valid),
            Cat(out[f.name] for f in intersection(self.config).fields).eq(last.payload.word),
            out.last.eq(last.payload.last),
            out.empty.eq(last.payload.kind == Kind.EMPTY),
        ]
        inside = Signal(range(4 * self.capacity))
        m.d.comb += self.busy.eq(inside.any())
        with m.If(taken & ~left):  # both sums are computed before it is known whether an item leaves
            m.d.sync += inside.eq(inside + 1)
        with m.Elif(left & ~taken):
            m.d.sync += inside.eq(inside - 1)
        return m
