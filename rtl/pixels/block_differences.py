"""Differences of a block's rows, and the codes of their groups."""

from __future__ import annotations

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.packed import (
    ALL_PLANES,
    BLOCK_BITS,
    BLOCK_WIDTH,
    CHANNELS,
    CODE_BITS,
    GROUP,
    GROUPS,
    block_row,
)

VALUES = data.ArrayLayout(data.ArrayLayout(8, CHANNELS), BLOCK_WIDTH)
"""The differences of a row, by pixel and channel."""

CODES = data.ArrayLayout(CODE_BITS, GROUPS)
"""The codes of a row's groups."""


def place_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The place of a row: its number in the block, the block, the eye in machines with joint frames, and whether no pixel of
    the row lies in the frame."""
    return data.StructLayout({
        "row": 2, "block": BLOCK_BITS, **({"eye": 1} if config.joint else {}), "outside": 1})


def coded_row(config: AcceleratorConfig) -> data.StructLayout:
    """A row with its codes. Row 0 still has the differences of the first pixel, which its codes leave out."""
    return data.StructLayout({"values": VALUES, "codes": CODES, "place": place_layout(config)})


class BlockDifferences(wiring.Component):
    """Turns rows of blocks (BlockRow) into differences with the codes of their groups (`coded_row`).

    Ports:
        rows: the rows of each block, row 0 first.
        coded: the same rows, as `coded_row`.
        busy: a row is inside.

    Storage: five rows. Throughput: a row a cycle. Latency: 4 cycles: differences along the row, differences to the row above,
    the bits that a group needs, its code.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self._place = place_layout(config)
        super().__init__({
            "rows": In(stream.Signature(layout(block_row(config)))), "coded": Out(stream.Signature(coded_row(config))),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        room, valid = Signal(), Signal(4)
        places = [Signal(self._place, name=f"place_{n}", reset_less=True) for n in range(3)]
        m.d.comb += [room.eq(~valid[3] | self.coded.ready), self.rows.ready.eq(room), self.coded.valid.eq(valid[3]),
                     self.busy.eq(valid.any())]
        with m.If(room):
            m.d.sync += valid.eq(Cat(self.rows.valid, valid[:3]))
        differences = self._differences(m, room, valid, places)
        held, used = Signal(VALUES, reset_less=True), [Signal(8, name=f"used_{n}", reset_less=True) for n in range(GROUPS)]
        with m.If(room & valid[1]):
            m.d.sync += [held.eq(differences), places[2].eq(places[1]),
                         *(used[g].eq(_used(differences, g, places[1].row == 0)) for g in range(GROUPS))]
        out = self.coded.payload
        with m.If(room & valid[2]):
            m.d.sync += [out.values.eq(held), out.place.eq(places[2]),
                         *(out.codes[g].eq(_code(used[g])) for g in range(GROUPS))]
        return m

    def _differences(self, m: Module, room: Signal, valid: Signal, places: list[data.View]) -> data.View:
        """The first two stages."""
        row = self.rows.payload
        along, above = Signal(VALUES, reset_less=True), Signal(VALUES, reset_less=True)
        out, inside = Signal(VALUES, name="differences", reset_less=True), Signal(BLOCK_WIDTH, reset_less=True)
        pixels = [[row.pixel[CHANNELS * x + k] for k in range(CHANNELS)] for x in range(BLOCK_WIDTH)]
        channels = [(r - g, g, b - g, coverage) for r, g, b, coverage in pixels]
        with m.If(room & self.rows.valid):
            m.d.sync += [
                places[0].row.eq(row.row), places[0].block.eq(row.block), places[0].outside.eq(row.inside == 0),
                inside.eq(Cat(row.inside > x for x in range(BLOCK_WIDTH))),
                *(along[x][k].eq(channels[x][k] - channels[x - 1][k] if x else channels[x][k])
                  for x in range(BLOCK_WIDTH) for k in range(CHANNELS))]
            if "eye" in self._place.members:
                m.d.sync += places[0].eye.eq(row.eye)
        with m.If(room & valid[0]):
            m.d.sync += [
                above.eq(along), places[1].eq(places[0]),
                *(out[x][k].eq((along[x][k] - Mux(places[0].row == 0, 0, above[x][k]))[:8] & inside[x].replicate(8))
                  for x in range(BLOCK_WIDTH) for k in range(CHANNELS))]
        return out


def _used(differences: data.View, group: int, first: Value) -> Value:
    """What a group's code depends on: in bits 0 to 6, where any difference has another bit than its sign; in bit 7, whether
    any is negative. `first`: the first pixel's difference lies in the header and does not count."""
    half, k = divmod(group, CHANNELS)
    values = [differences[GROUP * half + i][k] for i in range(GROUP)]
    if half == 0:
        values[0] = Mux(first, 0, values[0])
    return reduce(or_, (Cat(value[:7] ^ value[7].replicate(7), value[7]) for value in values))


def _code(used: Value) -> Value:
    """A group's code: as many bits as the largest difference has, and one for the sign."""
    code: Value = Cat(used[7], Const(0, CODE_BITS - 1))  # all are 0, or 0 and -1
    for bit in range(7):
        code = Mux(used[bit], min(bit + 2, ALL_PLANES), code)
    return code
