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
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered

from rtl.supertiles.batch_buffer import BatchBuffer
from rtl.supertiles.stream_buffer import StreamBuffer
from spec.config import AcceleratorConfig
from spec.memory import SHIFT_BITS
from spec.queues import COUNTER_BITS
from spec.supertiles import SEQUENCE_BITS, batch_place, supertile, tile_visit, visit_entry
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


def observe(
    m: Module, ports: tuple[stream.Interface, stream.Interface], source: stream.Interface, says: tuple[Signal, Signal],
    settings: tuple[Signal, Signal], suffix: str = "",
) -> None:
    """Takes the array's part: passes on entries behind their visit, and says which tiles have stopped.

    Args:
        m: the bench.
        ports: the bench's visits, which are the unit's, and its entries.
        source: the unit's entries.
        says: the unit's `done` and `current`.
        settings: `mode` and `limit`.
        suffix: ends the names of submodules.
    """
    (visits, entries), (done_port, current_port), (mode, limit) = ports, says, settings
    tiles, of_eye = len(says[0]), ["eye"] if "eye" in visits.payload.shape().members else []
    visit = data.StructLayout({"place": (tiles - 1).bit_length(), "sequence": SEQUENCE_BITS, "fresh": 1})
    m.submodules[f"taken{suffix}"] = taken = SyncFIFOBuffered(width=visit.size, depth=AHEAD)
    head, item = visit(taken.r_data), entries.payload
    moves = entries.valid & entries.ready
    m.d.comb += [
        taken.w_en.eq(visits.valid & visits.ready),
        taken.w_data.eq(Cat(visits.payload[name] for name in ("place", *of_eye, "sequence", "fresh"))),
        entries.payload.eq(source.payload), entries.valid.eq(source.valid & taken.r_rdy),
        source.ready.eq(entries.ready & taken.r_rdy), taken.r_en.eq(moves & item.end),
    ]
    counts = Array(Signal(16, name=f"count{suffix}_{n}") for n in range(tiles))
    begun, count = Signal(), Signal(16)
    m.d.comb += count.eq(Mux(head.fresh & ~begun, 0, counts[head.place]) + ~item.end)
    done, current = Signal(tiles), Signal(SEQUENCE_BITS)
    with m.If(taken.r_rdy):
        m.d.sync += current.eq(head.sequence)
        with m.If(head.sequence != current):
            m.d.sync += done.eq(0)
    with m.If(moves):
        m.d.sync += [counts[head.place].eq(count), begun.eq(~item.end)]
        with m.If((count >= limit + head.place) & (item.end | (mode != Mode.AT_END))):
            m.d.sync += done.bit_select(head.place, 1).eq(1)
    said = late = Cat(done, current)
    for n in range(LATE):
        said, late = late, Signal.like(said, name=f"late{suffix}_{n}")
        m.d.sync += late.eq(said)
    with m.Switch(mode):
        with m.Case(Mode.AT_ONCE, Mode.AT_END):
            m.d.comb += Cat(done_port, current_port).eq(Cat(done, current))
        with m.Case(Mode.LATE):
            m.d.comb += Cat(done_port, current_port).eq(late)
        with m.Case(Mode.STALE):
            m.d.comb += [done_port.eq(-1), current_port.eq(current - 1)]


def _settings(config: AcceleratorConfig) -> dict[str, int]:
    joint = {"joint": 1, "shift": SHIFT_BITS} if config.joint else {}
    return {"mode": 3, "limit": 16, "frame": 8} | joint


class BatchBench(Bench):
    """The batch buffer with an observer of its outputs that drives `done` and `current`."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__(
            {"supertiles": supertile(config), "places": batch_place(config)},
            {"visits": tile_visit(config), "entries": visit_entry(config)},
            _settings(config),
            {"batches": COUNTER_BITS, "visits_count": COUNTER_BITS, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = BatchBuffer(self.config)
        self.join(m, unit, apart=("entries",))
        before = Signal(8)
        m.d.comb += unit.clear.eq(before != self.frame)
        m.d.sync += before.eq(self.frame)
        observe(m, (self.visits, self.entries), unit.entries, (unit.done, unit.current), (self.mode, self.limit))
        return m


class StreamBench(Bench):
    """The batch buffer of several streams, with an observer at each."""

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        count = range(config.streams)
        super().__init__(
            {"supertiles": supertile(config), "places": batch_place(config)},
            {**{f"visits_{q}": tile_visit(config) for q in count}, **{f"entries_{q}": visit_entry(config) for q in count}},
            _settings(config),
            {"batches": COUNTER_BITS, "visits_count": COUNTER_BITS, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = StreamBuffer(self.config)
        self.join(m, unit)
        before = Signal(8)
        m.d.comb += unit.clear.eq(before != self.frame)
        m.d.sync += before.eq(self.frame)
        for q in range(self.config.streams):
            visits, entries = getattr(self, f"visits_{q}"), getattr(self, f"entries_{q}")
            wiring.connect(m, unit.visits[q], wiring.flipped(visits))
            observe(m, (visits, entries), unit.entries[q], (unit.done[q], unit.current[q]), (self.mode, self.limit), f"_{q}")
        return m


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    size = f"{config.batch_places}{'-joint' * config.joint}"
    if config.streams > 1:
        return StreamBench(config).playback(f"streams-{size}", "stream_bench")
    return BatchBench(config).playback(f"batch-{size}", "batch_bench")
