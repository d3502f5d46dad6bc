"""The setup unit of a machine with super-tiles: turns the intersections of visits into pixel ops (docs/array.md).

The arithmetic is that of `rtl.vrc_array.setup`. A visit begins with a load and ends with a store, or, if it is the tile's last
one, with the background of each level::

    cycle            0      1      2      3      4      5
    visits       <  V  >                                      taken with the last slot of the visit before
    entries             <  A  ><  A  ><  B  ><  B  >< end >   B is used by both levels
    slot                <load >< A,0 >< B,0 >< B,1 ><store>
"""

from __future__ import annotations

from typing import Any, NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In

from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.vrc_array.setup import SetupUnit
from spec.config import AcceleratorConfig
from spec.supertiles import check_supertiles, tile_visit, visit_entry


class _Slot(NamedTuple):
    """What enters the pipeline in a cycle; each field is one bit. `background` marks every op without a polynomial."""

    valid: Signal
    load: Signal
    level: Signal
    background: Signal
    drain: Signal
    last: Signal
    state: Signal


def quarter_port(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The port that tells an array of a machine with streams which quarter of the tiles is its region."""
    return {"quarter": In(2)} if config.streams > 1 else {}


class BatchSetup(SetupUnit):
    """Turns the intersections of each visit into pixel ops, and adds loads, stores and background ops.

    Parameters:
        config: the machine.

    Ports: those of SetupUnit, but

        visits: in place of `tiles`; a visit is taken together with the last slot of the visit before.
        quarter: with streams, the column (bit 0) and the row (bit 1) of the array's region in its tile, at whose first pixel
            the polynomials are given; constant.
        entries: intersections; each visit's end with an item with `end`, which is taken with the last slot of the visit.

    Throughput: one slot per cycle. A visit takes a slot for its load, one for each intersection, one more for each that both
    levels use, and one for its store or for the background of each level. Intersections without an op are those of SetupUnit.
    Latency: that of SetupUnit.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        check_supertiles(config)

    def _ports(self) -> dict[str, wiring.Member]:
        ports = {name: port for name, port in super()._ports().items() if name not in ("tiles", "entries")}
        return {
            "visits": In(stream.Signature(layout(tile_visit(self.config)))),
            "entries": In(stream.Signature(layout(visit_entry(self.config)))), **quarter_port(self.config), **ports}

    def _quarter(self) -> Value | None:
        return self.quarter if self.config.streams > 1 else None

    def _header(self) -> data.View:
        return Signal(self.visits.payload.shape(), name="header")

    def _schedule(self, m: Module, header: data.View, advance: Value) -> Any:
        entry, two_levels = self.entries.payload, self.config.level_banks == 2
        busy, begun, second, background_level = Signal(), Signal(), Signal(), Signal()
        blend = header.blend if two_levels else Const(0, 1)
        used = Cat(entry.use[0], entry.use[1] & blend)
        turn, ends, skip = Signal(), Signal(), Signal()
        slot = _Slot(*(Signal(name=f"slot_{name}") for name in _Slot._fields))
        m.d.comb += [
            skip.eq(self.stopped[0] & (self.stopped[-1] | ~blend)),
            turn.eq(busy & begun & ~second & self.entries.valid),
            ends.eq(turn & entry.end),
            self.entries.ready.eq(turn & Mux(ends, slot.drain & advance, advance | skip)),
            self.skipped.eq(turn & ~entry.end & skip),
            slot.load.eq(turn & ~entry.end & used.any() & ~skip),
            slot.state.eq(busy & ~begun),
            slot.last.eq(ends & header.final),
            slot.background.eq(slot.state | ends),
            slot.drain.eq(ends & (~header.final | (background_level == blend))),
            slot.valid.eq(slot.load | second | slot.background),
            slot.level.eq(Mux(slot.load, ~used[0], second | background_level) if two_levels else 0),
            self.visits.ready.eq(~busy | slot.drain & advance),
        ]
        with m.If(slot.state & advance):
            m.d.sync += begun.eq(1)
        if two_levels:
            with m.If(advance):
                m.d.sync += [second.eq(slot.load & used.all()), background_level.eq(slot.last & ~slot.drain)]
        with m.If(self.visits.ready):
            m.d.sync += [busy.eq(self.visits.valid), begun.eq(0)]
            with m.If(self.visits.valid):
                m.d.sync += header.eq(self.visits.payload)
        return slot

    def _mark(self, m: Module, p: Pipeline, header: data.View, slot: Any, level: Value, background: Value, end: int,
              out: stream.Interface) -> None:
        """Tells loads, stores and backgrounds apart, and adds the tile's place."""
        op = out.payload
        flags = {"last": slot.last, "load": slot.state, "place": header.place, "fresh": header.fresh}
        if self.config.joint:
            flags["eye"] = header.eye
        m.d.comb += [op[name].eq(p.control(name, flag).at(end)) for name, flag in flags.items()]
