"""The handover of sorted intersections to the array: one by one through a line buffer, or group by group through two halves.

Both components have the same ports, so that the two variants of the machine differ in nothing else. A `LineBuffer` passes an
intersection on as soon as it arrives. A `DoubleBuffer`, the paper's baseline, shows a group only when all of it has arrived::

    cycle               0    1    2    3    4    5    6    7    8
    sink              < a >< b.>< c >< d >< e.>                         a dot marks the end of a group
    source, line                < a >< b.>< c >< d >< e.>
    source, double                   < a >< b.>     < c >< d >< e.>
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.records import chunk_item


class LineBuffer(wiring.Component):
    """A FIFO of `line_buffer_bytes`.

    Parameters:
        config: the machine; only `line_buffer_bytes` and the format of an intersection are used.

    Ports:
        sink, source: ChunkItem items; the order is kept.
        busy: the FIFO is not empty.

    Storage: line_buffer_bytes / 8 intersections. Throughput: one intersection per cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        self._entries = _checked(config).line_buffer_bytes // ENTRY_BYTES
        super().__init__(_ports(config))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.entries = entries = SyncFIFOBuffered(width=len(self.sink.payload.as_value()), depth=self._entries)
        m.d.comb += [
            entries.w_en.eq(self.sink.valid), entries.w_data.eq(self.sink.payload), self.sink.ready.eq(entries.w_rdy),
            self.source.valid.eq(entries.r_rdy), self.source.payload.eq(entries.r_data), entries.r_en.eq(self.source.ready),
        ]
        m.d.comb += self.busy.eq(entries.level != 0)
        return m


class DoubleBuffer(wiring.Component):
    """Two halves of `sort_chunk` intersections each; one is filled while the other is read.

    A half takes one group, or as much of a larger group as fits. It is shown to the reader when that is complete, and it is
    free again when its last intersection has been taken. A short group leaves most of its half unused, as in the paper's
    baseline.

    Parameters:
        config: the machine; only `sort_buffer_bytes` and the format of an intersection are used.

    Ports:
        sink, source: ChunkItem items, order kept; a group ends with `last`.
        busy: at least one item is inside.

    Storage: 2 `sort_chunk` intersections in one memory; the half that is written is never the one that is read. Throughput:
    one intersection per cycle if consecutive groups are of equal length; otherwise the faster side waits until the other has
    finished with its half. Latency: the first intersection of a group leaves two cycles after its last one arrived.
    """

    def __init__(self, config: AcceleratorConfig):
        self._capacity = _checked(config).sort_chunk
        super().__init__(_ports(config))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        item = self.sink.payload
        m.submodules.words = words = memory.Memory(shape=item.shape(), depth=2 * self._capacity, init=[])
        write, read = words.write_port(), words.read_port()
        full, ends = Signal(2), [Signal(range(self._capacity), name=f"end_{half}", reset_less=True) for half in range(2)]
        filled, place = Signal(), Signal(range(self._capacity))  # half and place where the next item is written
        shown, next_place = Signal(), Signal(range(self._capacity))  # half and place from which the next item is read
        taken, left = self.sink.valid & self.sink.ready, self.source.valid & self.source.ready
        complete = taken & (item.last | (place == self._capacity - 1))
        m.d.comb += [
            self.sink.ready.eq(~full.bit_select(filled, 1)),
            write.en.eq(taken), write.addr.eq(Cat(place, filled)), write.data.eq(item),
            self.busy.eq(full.any() | place.any()),
        ]
        with m.If(taken):
            m.d.sync += [place.eq(Mux(complete, 0, place + 1)), filled.eq(filled ^ complete)]
        fetch, exhausted = Signal(), next_place == Mux(shown, ends[1], ends[0])
        of_half, is_last = Signal(), Signal()  # of the item at the memory's output
        m.d.comb += [
            fetch.eq(full.bit_select(shown, 1) & (~self.source.valid | self.source.ready)),
            read.en.eq(fetch), read.addr.eq(Cat(next_place, shown)),
            self.source.payload.eq(read.data),
        ]
        with m.If(~self.source.valid | self.source.ready):
            m.d.sync += self.source.valid.eq(fetch)
        with m.If(fetch):
            m.d.sync += [
                next_place.eq(Mux(exhausted, 0, next_place + 1)), shown.eq(shown ^ exhausted), of_half.eq(shown),
                is_last.eq(exhausted),
            ]
        for half in range(2):
            with m.If(complete & (filled == half)):
                m.d.sync += [full[half].eq(1), ends[half].eq(place)]
            with m.Elif(left & is_last & (of_half == half)):
                m.d.sync += full[half].eq(0)
        return m


def handover(config: AcceleratorConfig) -> LineBuffer | DoubleBuffer:
    """The handover that the machine has: a line buffer if `incremental` is set, otherwise a double buffer."""
    return LineBuffer(config) if _checked(config).incremental else DoubleBuffer(config)


def _checked(config: AcceleratorConfig) -> AcceleratorConfig:
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    return config


def _ports(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    items = stream.Signature(layout(chunk_item(config)))
    return {"sink": In(items), "source": Out(items), "busy": Out(1)}
