"""The batch buffer and the arrays of a machine with several streams: places of a batch come in, and rows of pixels leave.

    supertiles, places --> StreamBuffer -+-> visits, entries 0 -> BatchArray 0 -+-> RowJoin --> pixels
                             ^           |         ...                          |
                             |           +-> visits, entries 3 -> BatchArray 3 -+
                             +------------------- done, current ----------------+
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared
from rtl.shapes import layout, shape
from rtl.supertiles.eyes import joint_settings
from rtl.supertiles.row_join import RowJoin
from rtl.supertiles.stream_buffer import StreamBuffer
from rtl.vrc_array.batch_array import BatchArray
from spec.config import AcceleratorConfig
from spec.queues import COUNTER_BITS
from spec.records import pixel_row
from spec.supertiles import batch_place, check_supertiles, frame_rows, supertile


def _array(config: AcceleratorConfig, lines: int | None) -> BatchArray:
    return BatchArray(config, lines=lines)


class StreamArrays(wiring.Component):
    """Renders the places of super-tiles in several streams.

    Parameters:
        config: the machine; it must have lists by super-tile and several streams.
        lines: rows of the line buffer of each array; None stands for the minimum (see `rtl.vrc_array.collect`).

    Ports:
        supertiles, places, joint, shift, clear, batches, visits_count: those of StreamBuffer.
        background: r, g, b behind everything; must be stable during a frame.
        pixels: all pixel rows of every tile, those of `spec.supertiles.frame_rows`, by final visit, in the order of its array.
        taking, taken: an intersection, or the end of a visit, is offered to an array; one or more are taken.
        ops, skipped: those of all arrays, since reset, up to two cycles before.
        busy: a super-tile, a visit, its pixels or a store are inside.

    Storage and throughput: StreamBuffer's, and BatchArray's four times.
    """

    def __init__(self, config: AcceleratorConfig, *, lines: int | None = None):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        if config.streams == 1:
            raise ValueError(f"streams must be more than 1 for this unit, not {config.streams!r}")
        self.config, self._lines = config, lines
        super().__init__({
            "supertiles": In(stream.Signature(layout(supertile(config)))),
            "places": In(stream.Signature(layout(batch_place(config)))),
            **joint_settings(config, "joint", "shift"),
            "background": In(data.ArrayLayout(shape(config.formats.colour), 3)),
            "pixels": Out(stream.Signature(layout(pixel_row(frame_rows(config))))),
            "clear": In(1), "taking": Out(1), "taken": Out(1), "busy": Out(1),
            **{name: Out(COUNTER_BITS) for name in ("batches", "visits_count", "ops", "skipped")},
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.batches = batches = StreamBuffer(self.config)
        m.submodules.join = join = RowJoin(self.config)
        arrays = [add_shared(m, platform, f"array_{q}", "quarter_array", _array, self.config, self._lines)
                  for q in range(self.config.streams)]
        for name in ("supertiles", "places"):
            wiring.connect(m, wiring.flipped(getattr(self, name)), getattr(batches, name))
        for q, array in enumerate(arrays):
            wiring.connect(m, batches.visits[q], array.visits)
            wiring.connect(m, batches.entries[q], array.entries)
            wiring.connect(m, array.pixels, join.rows[q])
            m.d.comb += [array.background.eq(self.background), array.quarter.eq(q),
                         batches.done[q].eq(array.done), batches.current[q].eq(array.current)]
        wiring.connect(m, join.joined, wiring.flipped(self.pixels))
        for name in ("joint", "shift"):
            if self.config.joint:
                m.d.comb += getattr(batches, name).eq(getattr(self, name))
        m.d.comb += [
            batches.clear.eq(self.clear), self.batches.eq(batches.batches), self.visits_count.eq(batches.visits_count),
            self.taking.eq(Cat(entries.valid for entries in batches.entries).any()),
            self.taken.eq(Cat(entries.valid & entries.ready for entries in batches.entries).any()),
            self.busy.eq(batches.busy | Cat(array.busy for array in arrays).any())]
        for name in ("ops", "skipped"):
            m.d.sync += getattr(self, name).eq(self._sum(m, name, [getattr(array, name) for array in arrays]))
        return m

    def _sum(self, m: Module, name: str, counts: list[Value]) -> Value:
        """The sum of counts, of which each pair's was taken a cycle before."""
        pairs = [Signal(COUNTER_BITS, name=f"{name}_{k}") for k in range(0, len(counts), 2)]
        m.d.sync += [pair.eq(one + other) for pair, one, other in zip(pairs, counts[::2], counts[1::2], strict=True)]
        return sum(pairs[1:], pairs[0])
