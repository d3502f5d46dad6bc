"""The batch buffer in a test bench that takes the array's part: it takes each visit before its entries, and says which tiles
have stopped.

A tile stops after as many entries in its super-tile as the setting `limit` and its number in the super-tile add up to. When
this is known depends on the setting `mode`; `Mode` has the choices. When the setting `frame` changes, `clear` is high for one
cycle.
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache

from amaranth.hdl import Array, Cat, Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.fifo import SyncFIFOBuffered

from rtl.supertiles.batch_buffer import BatchBuffer
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES
from spec.queues import COUNTER_BITS
from spec.supertiles import SEQUENCE_BITS, SUPER_PLACES, batch_place, supertile, tile_visit, visit_entry
from tb.common.bench import Bench
from tb.common.playback import Playback

LATE = 20
"""Cycles by which Mode.LATE delays what Mode.AT_ONCE says."""

AHEAD = 16
"""Visits that may be taken before their entries; the unit offers fewer."""


class Mode(IntEnum):
    """What the bench says of tiles that stop."""

    NEVER = 0
    """No tile stops."""
    AT_ONCE = 1
    """A tile stops in the cycle after its last entry was taken."""
    AT_END = 2
    """A tile stops when the visit ends in which its last entry was taken."""
    LATE = 3
    """As AT_ONCE, but LATE cycles later."""
    STALE = 4
    """All tiles of the super-tile before have stopped, and none of the visited one."""


class BatchBench(Bench):
    """The batch buffer with an observer of its outputs that drives `done` and `current`."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"supertiles": supertile(config), "places": batch_place(config)},
            {"visits": tile_visit(config), "entries": visit_entry(config)},
            {"mode": 3, "limit": 16, "frame": 8},
            {"batches": COUNTER_BITS, "visits_count": COUNTER_BITS, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = BatchBuffer(self.config)
        self.join(m, unit, apart=("entries",))
        before = Signal(8)
        m.d.comb += unit.clear.eq(before != self.frame)
        m.d.sync += before.eq(self.frame)
        visit = data.StructLayout({"place": SUPER_PLACES, "sequence": SEQUENCE_BITS, "fresh": 1})
        m.submodules.taken = taken = SyncFIFOBuffered(width=visit.size, depth=AHEAD)
        head, item = visit(taken.r_data), self.entries.payload
        moves = self.entries.valid & self.entries.ready
        m.d.comb += [
            taken.w_en.eq(self.visits.valid & self.visits.ready),
            taken.w_data.eq(Cat(self.visits.payload[name] for name in visit.members)),
            self.entries.payload.eq(unit.entries.payload), self.entries.valid.eq(unit.entries.valid & taken.r_rdy),
            unit.entries.ready.eq(self.entries.ready & taken.r_rdy), taken.r_en.eq(moves & item.end),
        ]
        counts = Array(Signal(16, name=f"count_{n}") for n in range(SUPER_TILES))
        begun, count = Signal(), Signal(16)
        m.d.comb += count.eq(Mux(head.fresh & ~begun, 0, counts[head.place]) + ~item.end)
        done, current = Signal(SUPER_TILES), Signal(SEQUENCE_BITS)
        with m.If(taken.r_rdy):
            m.d.sync += current.eq(head.sequence)
            with m.If(head.sequence != current):
                m.d.sync += done.eq(0)
        with m.If(moves):
            m.d.sync += [counts[head.place].eq(count), begun.eq(~item.end)]
            with m.If((count >= self.limit + head.place) & (item.end | (self.mode != Mode.AT_END))):
                m.d.sync += done.bit_select(head.place, 1).eq(1)
        said = late = Cat(done, current)
        for n in range(LATE):
            said, late = late, Signal.like(said, name=f"late_{n}")
            m.d.sync += late.eq(said)
        with m.Switch(self.mode):
            with m.Case(Mode.AT_ONCE, Mode.AT_END):
                m.d.comb += Cat(unit.done, unit.current).eq(Cat(done, current))
            with m.Case(Mode.LATE):
                m.d.comb += Cat(unit.done, unit.current).eq(late)
            with m.Case(Mode.STALE):
                m.d.comb += [unit.done.eq(-1), unit.current.eq(current - 1)]
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return BatchBench(config).playback(f"batch-{config.batch_places}", "batch_bench")
