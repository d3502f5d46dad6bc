"""The writer of pairs, connected to a memory, the tile merge unit and the list reader as in the machine."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring

from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.supertiles.pair_writer import PairWriter
from rtl.tile_lists.list_reader import ListReader
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, write_request
from spec.records import COUNT_BITS, chunk_item, frame_lists, intersection_item
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.playback import Playback
from tb.tile_lists.memory import MEMORY, add_memory

OBSERVED = {**dict.fromkeys(("full", "list_error", "writer_busy", "merge_busy"), 1), "waits": 24}
"""The widths in bits of plain outputs. `waits` counts the cycles in which a pair that is no `end` waits for the writer, but for
those after a reset."""


class PairDevice(Bench):
    """The units, connected as in the machine. A frame's pairs are accepted when all of the previous frame have been read back.

    Parameters:
        config: the machine's configuration.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"entries": intersection_item(config)}, {"written": write_request(config), "groups": chunk_item(config)},
            {"list_count": frame_lists(config).bit_length(), "beta": COUNT_BITS, "directory_base": BEAT_BITS,
             "entries_base": BEAT_BITS, "entries_beats": BEAT_BITS, "latency": 10, "hesitates": 8, "bad": BEAT_BITS}, OBSERVED)

    def elaborate(self, platform: object) -> Module:
        m, config = Module(), self.config
        m.submodules.writer = writer = PairWriter(config)
        m.submodules.merge = merge = TileMergeUnit(config)
        m.submodules.reader = reader = ListReader(config)
        for unit in (writer, reader):
            m.d.comb += [getattr(unit, name).eq(getattr(self, name))
                         for name in self.settings if name in unit.signature.members]
        m.d.comb += [merge.tiles_x.eq(self.list_count), merge.tile_count.eq(self.list_count), merge.beta.eq(self.beta)]
        wiring.connect(m, writer.hits, merge.hits)
        wiring.connect(m, merge.groups, reader.tiles)
        wiring.connect(m, writer.writes, wiring.flipped(self.written))
        wiring.connect(m, reader.groups, wiring.flipped(self.groups))
        host = stream.Signature(layout(write_request(config))).create()  # the host writes nothing
        add_memory(
            m, {name: getattr(self, name) for name in ("latency", "hesitates", "bad")}, host, self.written,
            writer.writes_idle, [(reader.reads, reader.data)])
        opens = self._frames(m, writer, merge, reader)
        offers, waits = self.entries.valid & opens, Signal()
        m.d.comb += [
            self.full.eq(writer.full), self.list_error.eq(reader.error), self.writer_busy.eq(writer.busy),
            self.merge_busy.eq(merge.busy),
            writer.entries.payload.eq(self.entries.payload),
            writer.entries.valid.eq(offers), self.entries.ready.eq(writer.entries.ready & opens),
        ]
        m.d.sync += waits.eq(waits | (offers & self.entries.ready))  # places have been cleared
        m.d.sync += self.waits.eq(self.waits + (waits & offers & ~self.entries.payload.end & ~self.entries.ready))
        return m

    def _frames(self, m: Module, writer: PairWriter, merge: TileMergeUnit, reader: ListReader) -> Signal:
        """Whether pairs are accepted: everything of the previous frame has left. The reader's error is reset for each frame."""
        opens, within, listed = Signal(), Signal(), Signal(COUNT_BITS + 1)
        hit, hits = writer.hits.payload, writer.hits.valid & writer.hits.ready
        m.d.comb += within.eq(hits & ~hit.end & (hit.tile < self.list_count))
        m.d.sync += listed.eq(listed + within - (self.groups.valid & self.groups.ready))
        with m.FSM():
            with m.State("PAIRS"):
                m.d.comb += opens.eq(1)
                with m.If(self.entries.valid & self.entries.ready & self.entries.payload.end):
                    m.next = "HITS"
            with m.State("HITS"):
                with m.If(hits & hit.end):
                    m.d.comb += reader.clear.eq(1)
                    m.next = "LISTS"
            with m.State("LISTS"):
                with m.If((listed == 0) & ~merge.busy):
                    m.next = "PAIRS"
        return opens


def _emit(config: AcceleratorConfig) -> str:
    return to_verilog(PairDevice(config), "pair_device") + MEMORY


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The device of a configuration and its memory, emitted, with files at its streams."""
    name = f"pair-lists-{frame_lists(config)}"
    return PairDevice(config).playback(name, "pair_device", emitted(name, config, _emit))
