"""The median of a hole's neighbours in each colour channel, determined bit by bit from the top.

A neighbour is called alive as long as it may be the median. Of the neighbours alive, those with a 0 in the current bit are
smaller than those with a 1. If the zeros are more than `rank`, the wanted neighbour is one of them and its bit is 0. Otherwise
its bit is 1, and its rank among the ones is lower by the number of zeros. The neighbours with the other bit are no longer
alive. A stage handles two bits. If a hole has fewer than eight neighbours, the missing ones are not alive from the start.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.warp_unit.window import NEIGHBOURS, group_members, slot_layout
from spec.config import AcceleratorConfig

_BITS_A_STAGE = 2

FILL_LATENCY = 1 + 8 // _BITS_A_STAGE
"""Cycles through the unit."""


def filled_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A slot, and the colour of the hole that is filled in it."""
    return data.StructLayout({**group_members(config), "colour": data.ArrayLayout(8, 3)})


class Fill(wiring.Component):
    """Adds to each slot the colour of the hole that is filled in it.

    Parameters:
        config: the machine; only `warp_lanes` is used.

    Ports:
        slots: groups of pixels, each with one hole and its neighbours.
        filled: the same slots with colours, in the same order.
        busy: a slot is inside.

    Throughput: one slot per cycle. Latency: 5 cycles. All stages stall together when the last one does.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "slots": In(stream.Signature(slot_layout(config))), "filled": Out(stream.Signature(filled_layout(config))),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        slot, advance = self.slots.payload, Signal()
        m.d.comb += [advance.eq(~self.filled.valid | self.filled.ready), self.slots.ready.eq(advance)]
        group = Pipeline(m, load=self.slots.valid, advance=advance)
        hole = Pipeline(m, load=self.slots.valid & slot.fills, advance=advance)
        valid = group.control("valid", self.slots.valid)
        m.d.comb += [self.filled.valid.eq(valid.at(FILL_LATENCY)),
                     self.busy.eq(Cat(valid.at(stage) for stage in range(1, FILL_LATENCY + 1)).any())]
        for name in group_members(self.config):
            value = slot[name] if isinstance(slot[name], Value) else slot[name].as_value()
            target = self.filled.payload[name]
            m.d.comb += (target if isinstance(target, Value) else target.as_value()).eq(
                group.data(name, value).at(FILL_LATENCY))
        alive = hole.data("alive", Cat(pixel.valid for pixel in slot.around))
        rank = hole.data("rank", slot.rank)
        for channel in range(3):
            planes = [hole.data(f"plane_{channel}_{bit}", Cat(pixel.colour[channel][bit] for pixel in slot.around))
                      for bit in range(8)]
            m.d.comb += self.filled.payload.colour[channel].eq(_median(m, hole, channel, alive.to(1), rank.to(1), planes))
        return m


def _median(m: Module, p: Pipeline, channel: int, alive: Staged, rank: Staged, planes: list[Staged]) -> Value:
    """The value of the given rank among those alive, 0 for the smallest; `planes` are the values' bits, lowest bit first."""
    def stage(alive: Value, rank: Value, upper: Value, lower: Value) -> Value:
        # The lower zeros are counted for either upper bit, so that the second count does not wait for the first.
        zeros, with_0, with_1 = (_count(m, bits) for bits in (
            alive & ~upper, alive & ~upper & ~lower, alive & upper & ~lower))
        alive, rank, high = _halved(m, alive, rank, upper, zeros)
        alive, rank, low = _halved(m, alive, rank, lower, Mux(high, with_1, with_0))
        return Cat(alive, rank, low, high)

    found: list[Staged] = []
    for top in range(7, -1, -_BITS_A_STAGE):
        both = p.reg(f"median_{channel}", stage, alive, rank, *(planes[top - i] for i in range(_BITS_A_STAGE)))
        alive, rank, bits = (both.map(lambda v, a=a, b=b: v[a:b]) for a, b in (  # type: ignore[misc]
            (0, len(NEIGHBOURS)), (len(NEIGHBOURS), -_BITS_A_STAGE), (-_BITS_A_STAGE, None)))
        found.insert(0, bits)
    return Cat(bits.at(both.stage) for bits in found)


def _count(m: Module, bits: Value) -> Value:
    """The number of ones."""
    ones = Signal(range(len(NEIGHBOURS) + 1))
    m.d.comb += ones.eq(sum(bits))
    return ones


def _halved(m: Module, alive: Value, rank: Value, plane: Value, zeros: Value) -> tuple[Value, Value, Value]:
    """One bit: which values stay alive, the wanted rank among them, and the bit of the wanted value. `zeros`: how many of those
    alive have a 0."""
    alive_next, rank_next, bit = Signal.like(alive), Signal.like(rank), Signal()
    m.d.comb += [
        bit.eq(rank >= zeros), alive_next.eq(alive & (plane ^ ~bit.replicate(len(plane)))),
        rank_next.eq(Mux(bit, rank - zeros, rank))]
    return alive_next, rank_next, bit
