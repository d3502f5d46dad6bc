"""Collection of the rows of visits: those of a last visit leave as pixels, the others go to the state memory.

Both come through the row multiplexer of `rtl.vrc_array.collect`, one per cycle. A store is therefore as far from other drains
as these are from each other, but needs no space in the output buffer.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.vrc_array.batch_row import state_layout
from rtl.vrc_array.batch_setup import quarter_port
from rtl.vrc_array.collect import Collect, place_latency
from spec.config import AcceleratorConfig
from spec.supertiles import SEQUENCE_BITS, batch_tile_bits, check_supertiles


def stored_row(config: AcceleratorConfig) -> data.StructLayout:
    """A finished row before blending, with the tile that it belongs to."""
    return data.StructLayout({
        "valid": 1,  # the row goes to the state memory
        "final": 1,  # the row is one of a last visit, which leaves as pixels; not both
        "place": batch_tile_bits(config),
        "sequence": SEQUENCE_BITS,
        "blend": 1,
        "row": 4,  # in the tile
        "column": 4,  # first column in the tile
        "pixels": data.ArrayLayout(state_layout(config), config.array_x),
    })


class BatchCollect(Collect):
    """Turns the finished rows of the array into a stream of pixel rows, and into rows for the state memory.

    Parameters and ports: those of Collect, whose `places` are visits, and whose `may_drain` concerns those of tiles that end;
    and

        storing, place: the drain that is issued is a store; its tile.
        may_store: a store may be issued in this cycle.
        quarter: with streams, the column (bit 0) and the row (bit 1) of the array's region in its tile; constant.
        stored: a row, place_latency + 1 cycles after `draining` for the first row of a drain.
    """

    def __init__(self, config: AcceleratorConfig, *, lines: int | None = None):
        super().__init__(config, lines=lines)
        check_supertiles(config)

    def _ports(self) -> dict[str, wiring.Member]:
        return {
            **super()._ports(), **quarter_port(self.config), "storing": In(1), "place": In(batch_tile_bits(self.config)),
            "may_store": Out(1), "stored": Out(stored_row(self.config))}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        place = self._places(m)
        pixels = self._deliver(m, place)
        end = place_latency(self.config)
        m.d.comb += [
            self.stored.valid.eq(place["stored"].at(end)), self.stored.final.eq(place["valid"].at(end)),
            self.stored.pixels.eq(pixels),
            *(self.stored[name].eq(place[name].at(end)) for name in ("place", "sequence", "row", "column"))]
        if self.config.level_banks == 2:
            m.d.comb += self.stored.blend.eq(place["blend"].at(end))
        return m

    def _admit(self, m: Module, room: Value, apart: Value) -> None:
        m.d.comb += [self.may_drain.eq(room & apart), self.may_store.eq(apart)]

    def _in_tile(self, place: Value, axis: int) -> Value:
        return Cat(place, self.quarter[axis]) if self.config.streams > 1 else place

    def _claims(self) -> Value:
        return self.draining & ~self.storing

    def _valid(self, m: Module, p: Pipeline, running: Value, head: data.View) -> dict[str, Staged]:
        stores, place = Signal(), Signal.like(self.place)
        with m.If(self.draining):
            m.d.sync += [stores.eq(self.storing), place.eq(self.place)]
        return {
            "valid": p.control("valid", running & ~stores), "stored": p.control("stored", running & stores),
            "place": p.data("place", place), "sequence": p.data("sequence", head.sequence)}
