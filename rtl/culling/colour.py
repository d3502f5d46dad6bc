"""The colour unit: computes the colours of splats with an intersection and writes splat records for the array to memory."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.culling.colour_sum import ColourSum, by_degree
from rtl.culling.compact_sum import CompactColourSum
from rtl.culling.compact_views import CompactRecordWriter
from rtl.culling.datapath import Datapath
from rtl.culling.harmonics import OFFSETS, harmonics_graph
from rtl.culling.views import RecordWriter
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.harmonics import terms
from spec.memory import BEAT_BITS, colour_beats, read_data, read_request, write_request
from spec.queues import COLOUR_LOOKAHEAD
from spec.records import surviving_splat

LEAST_INTERVAL = {"wide": 4, "compact": 2}
"""Least number of cycles per splat, by the format of records. A wide record has three beats, which come at one per cycle, and a
step reads two of them; a compact one has two beats."""


def splat_interval(config: AcceleratorConfig) -> int:
    """Number of cycles that a splat takes in the unit."""
    return max(LEAST_INTERVAL[config.records], config.colour_interval)


def carried_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The fields that pass the unit unchanged: those of SurvivingSplat without `offset` and `end`. Compact records have the
    opacities, so that those of the splat stay behind."""
    left_out = ("offset", "end", "log2_opacity") if config.compact else ("offset", "end")
    return data.StructLayout({
        name: field.shape for name, field in layout(surviving_splat(config)) if name not in left_out})


class ColourUnit(wiring.Component):
    """Reads a survivor's colour record, evaluates its harmonics, and writes one splat record for each of its levels.

        survivors -+-> waiting --> Datapath(harmonics) --> ColourSum --> RecordWriter --> writes
                   |                                          ^
                   +-> reads ......... memory ......... data -+

    Parameters:
        config: the machine.
        sh_degree: degree of the largest records, 0..3; hardware that only higher degrees need is left out.

    Ports:
        survivors: SurvivingSplat items; an item with `end` follows the last one of a frame.
        reads, data: read port of memory; colour_beats(sh_degree) beats at colour_base + index * beats, for every splat in
            order.
        writes: one beat, a splat record (SplatRecord), for every level of every splat, in order.
        sh_degree: setting of the frame, at most the parameter.
        colour_base, views_base, view_shift: settings of the frame.
        finished: `end` has come and every write has been taken; high until the next frame's first item is taken. Settings may
            change while it is high, and after a reset.
        error: the memory answered with an error; high until the next frame's first item. The frame goes on.

    Compact records have one beat of opacities and base colours and one of harmonics; ColourSum and RecordWriter are then
    CompactColourSum and CompactRecordWriter.

    Throughput: one splat every `splat_interval` cycles, whatever the degree, while memory answers within COLOUR_LOOKAHEAD
    cycles. With wide records and an interval of 4, a splat with 3 or 4 levels may take 1 or 2 cycles more; with compact ones it
    takes one cycle for each level where those are more than the interval. Latency from the transfer of a
    splat to its first write: the latency of the datapath or of memory, whichever is longer, plus the degree's steps and 5
    cycles.
    """

    def __init__(self, config: AcceleratorConfig, *, sh_degree: int = 3) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(sh_degree, int) or isinstance(sh_degree, bool):
            raise TypeError(f"sh_degree must be an integer, not {sh_degree!r}")
        if not 0 <= sh_degree <= 3:
            raise ValueError(f"sh_degree must be in 0..3, not {sh_degree!r}")
        self.config, self._degree, interval = config, sh_degree, splat_interval(config)
        carried = carried_layout(config)
        self._path = Datapath(harmonics_graph(config, sh_degree), interval=interval, carried=carried) if sh_degree else None
        kinds = (CompactColourSum, CompactRecordWriter) if config.compact else (ColourSum, RecordWriter)
        self._sum = kinds[0](config, sh_degree=sh_degree, lanes=-(-terms(sh_degree) // interval), carried=carried)
        self._views = kinds[1](config, carried=carried)
        inside = self._path.schedule.depth if self._path else 0
        self._waiting = max(2, -(-COLOUR_LOOKAHEAD // interval) - inside)
        self._most = self._waiting + inside + 8  # 8 for the splats in registers between the queues
        super().__init__({
            "survivors": In(stream.Signature(layout(surviving_splat(config)))),
            "reads": Out(stream.Signature(layout(read_request(config)))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "sh_degree": In(2),
            "colour_base": In(BEAT_BITS),
            "views_base": In(BEAT_BITS),
            "view_shift": In(2),
            "finished": Out(1),
            "error": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.sum, m.submodules.views = total, views = self._sum, self._views
        of = data.StructLayout({
            **({name: shape(self.config.formats.view) for name in OFFSETS} if self._path else {}),
            "carried": carried_layout(self.config)})
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=of.size, depth=self._waiting)
        first = self._path.sink if self._path else total.basis
        if self._path:
            m.submodules.path = self._path
            wiring.connect(m, self._path.source, total.basis)
        wiring.connect(m, wiring.flipped(self.data), total.data)
        wiring.connect(m, total.sums, views.sums)
        wiring.connect(m, views.writes, wiring.flipped(self.writes))
        m.d.comb += [
            waiting.w_data.eq(self._item(of)),
            Value.cast(first.payload).eq(waiting.r_data),
            first.valid.eq(waiting.r_rdy),
            waiting.r_en.eq(first.ready),
            total.sh_degree.eq(self.sh_degree),
            views.views_base.eq(self.views_base),
            views.view_shift.eq(self.view_shift),
        ]
        self._accept(m, waiting, views.sums.valid & views.sums.ready)
        return m

    def _item(self, of: data.StructLayout) -> Value:
        """The fields of a survivor that wait in the queue."""
        splat = self.survivors.payload
        parts = {**dict(zip(OFFSETS, splat.offset, strict=True)), "carried": Cat(
            Value.cast(splat[name]) for name, _ in carried_layout(self.config))}
        return Cat(parts[name] for name, _ in of)

    def _accept(self, m: Module, waiting: SyncFIFOBuffered, leaves: Value) -> None:
        """Takes survivors, requests every beat of their records, and detects the end of the frame."""
        splat, left, inside, ending = self.survivors.payload, Signal(2), Signal(range(self._most + 1)), Signal()
        taken, enters = Signal(), Signal()
        beats = by_degree(self.sh_degree, [colour_beats(self.config, d) for d in range(self._degree + 1)])
        asked = self.reads.valid & self.reads.ready
        m.d.comb += [
            self.reads.valid.eq(left != 0),
            self.survivors.ready.eq(~ending & waiting.w_rdy & ((left == 0) | (left == 1) & self.reads.ready)),
            taken.eq(self.survivors.valid & self.survivors.ready),
            enters.eq(taken & ~splat.end),
            waiting.w_en.eq(enters),
        ]
        with m.If(asked):
            m.d.sync += [left.eq(left - 1), self.reads.payload.beat.eq(self.reads.payload.beat + 1)]
        with m.If(enters):
            offset = sum(Mux(beats[i], splat.index << i, 0) for i in range(len(beats)))
            m.d.sync += [left.eq(beats), self.reads.payload.beat.eq(self.colour_base + offset)]
        m.d.sync += inside.eq(inside + enters - leaves)
        with m.If(taken):
            m.d.sync += [self.finished.eq(0), ending.eq(splat.end)]
        with m.If(self.data.valid & self.data.ready & self.data.payload.error):
            m.d.sync += self.error.eq(1)
        with m.If(taken & self.finished):
            m.d.sync += self.error.eq(0)
        written = ~self.writes.valid & ~self._views.busy if self.config.compact else ~self.writes.valid
        with m.If(ending & (inside == 0) & self._sum.idle & written):
            m.d.sync += [self.finished.eq(1), ending.eq(0)]
