"""One row of the rendering array: `cores_x` pixel cores, and the op's fields delayed beside them.

Rows are chained: what leaves `op_out`, `exponent_out` and `slope_out` enters the row below, which therefore works one cycle
behind. No port has back-pressure: one op enters per cycle, and `valid` low is a bubble. Free space for results is tracked
outside the array.

An op that is on `op_in` in cycle 0 (PIPELINE = 3)::

    cycle             0     1     2     3     4     5
    op_in           < op >
    exponent_in     < e  >
    op_out                < op >                           with the row below's exponents beside it
    (alpha)                     < a  >
    draining                          <~~~~>               if op.drain: `transmittance` is final in this cycle
    drained                                       <~~~~>   if op.drain: `colour` and `depth` are final in this cycle

The two strobes are SUMS_LATER cycles apart, because the weights of the sums are computed from the transmittance and the first
op of the next tile may follow at once. The collection of the row must therefore delay `transmittance` by SUMS_LATER cycles; it
does so behind its multiplexer.
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Const, Module, Signal, Value, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared
from rtl.vrc_array.pixel_core import PixelCore, index_shape, pixel_layout
from spec.config import AcceleratorConfig

PIPELINE = 3
"""Cycles from an op on `op_in` to the transmittance after it."""

SUMS_LATER = 2
"""Cycles from an op's transmittance to its sums."""


def op_layout(config: AcceleratorConfig) -> data.StructLayout:
    """What travels down the rows together with the exponents."""
    n = config.formats
    start = {"load": 1} if config.supertiles else {"first": 1}  # every pixel takes its state; the bank's state starts afresh
    return data.StructLayout({
        "valid": 1,  # low: a bubble, whose other fields are ignored
        "curve_yy": signed(n.curvature.width),  # second difference along y
        "cut": signed(n.cut.width),  # a pixel skips the op if its exponent is below this; at least tables.log2_alpha_min
        "bank": index_shape(config.banks),  # block * level_banks + level
        "outer": 1,  # alpha may reach 1
        **start,
        "last": 1,  # background: alpha 1, transmittance unchanged
        "drain": 1,  # raises the strobes
        "colour": data.ArrayLayout(unsigned(n.colour.width), 3),
        "depth": unsigned(n.depth.width),  # ignored without config.depth
    })


class VrcRow(wiring.Component):
    """A row of pixel cores.

    Parameters:
        config: the machine; `cores_x`, `banks`, `level_banks`, `depth` and the formats are used.

    Ports:
        op_in, exponent_in, slope_in: an op, and for each column the exponent and its first difference along y at this row.
        op_out, exponent_out, slope_out: the same for the row below, one cycle later.
        draining, draining_block: strobe PIPELINE cycles after a valid op with `drain`: `pixels[...].transmittance` of that op's
            block is final. The block index says which block (constant 0 if blocks = 1).
        drained, drained_block: the same SUMS_LATER cycles later, for `pixels[...].colour` and `.depth`.
        pixels: per column and level bank, the state of the block that the strobe names: transmittance of `draining_block`, sums
            of `drained_block`. Undefined in other cycles.
        stopped: per level bank, whether T < t_stop for every pixel of the row in every block. It is combinational from the
            transmittance registers, so it concerns the tile whose first op entered more than PIPELINE cycles ago. In a machine
            with several blocks it is meaningful only once all blocks have had their first op.

    Latency: PIPELINE cycles to transmittance, SUMS_LATER more to the sums. Throughput: one op per cycle, in any order of banks.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__(self._ports())

    def _ports(self) -> dict[str, wiring.Member]:
        config, n, columns = self.config, self.config.formats, self.config.array_x
        exponents = data.ArrayLayout(signed(n.exponent.width), columns)
        slopes = data.ArrayLayout(signed(n.slope.width), columns)
        block = index_shape(config.blocks)
        return {
            "op_in": In(op_layout(config)),
            "exponent_in": In(exponents),
            "slope_in": In(slopes),
            "op_out": Out(op_layout(config)),
            "exponent_out": Out(exponents),
            "slope_out": Out(slopes),
            "draining": Out(1),
            "draining_block": Out(block),
            "drained": Out(1),
            "drained_block": Out(block),
            "pixels": Out(data.ArrayLayout(data.ArrayLayout(pixel_layout(config), config.level_banks), columns)),
            "stopped": Out(config.level_banks),
        }

    _core: tuple[str, type[PixelCore]] = ("pixel_core", PixelCore)

    def _begin(self, column: int, core: Any, op: list[Any]) -> list[Any]:
        """Tells a core when the state of its pixel begins."""
        return [core.blend_op.first.eq(op[2].first)]

    def _look_ahead(self, core: Any, op: list[Any]) -> list[Any]:
        """Tells a core what it needs of an op a cycle before it is blended: nothing where banks are in registers."""
        return []

    def _reads(self, op: Any) -> Value:
        """Whether an op reads its bank."""
        return ~op.first

    def _writes(self, op: Any, valid: Value) -> Value:
        """Whether an op may change its bank."""
        return valid

    def elaborate(self, platform: object) -> Module:
        m = Module()
        op, valid = self._delayed(m)
        read, write, left = self._banks(m, op, valid)
        columns = range(self.config.array_x)
        cores = [add_shared(m, platform, f"core{x}", *self._core, self.config) for x in columns]
        for level, stopped in enumerate(self.stopped):
            m.d.comb += stopped.eq(Cat(core.stopped[level] for core in cores).all())
        thrice = Signal(self.config.formats.depth.width + 2, name="depth_thrice", reset_less=True)
        m.d.sync += thrice.eq(op[3].depth + (op[3].depth << 1))
        for x, core in enumerate(cores):
            m.d.comb += [
                core.exponent.eq(self.exponent_in[x]),
                core.slope.eq(self.slope_in[x]),
                core.curve_yy.eq(op[1].curve_yy),
                self.exponent_out[x].eq(core.exponent_below),
                self.slope_out[x].eq(core.slope_below),
                core.alpha_op.cut.eq(op[1].cut),
                core.alpha_op.outer.eq(op[1].outer),
                core.alpha_op.last.eq(op[1].last),
                *self._look_ahead(core, op),
                core.blend_op.read.eq(read[2]),
                core.blend_op.write.eq(write[2]),
                *self._begin(x, core, op),
                core.blend_op.last.eq(op[2].last),
                core.weigh_op.read.eq(left),
                core.sum_op.read.eq(read[4]),
                core.sum_op.write.eq(write[4]),
                core.sum_op.colour.eq(op[4].colour),
                core.sum_op.depth.eq(op[4].depth),
                core.sum_op.depth_thrice.eq(thrice),
                core.draining_block.eq(self.draining_block),
                core.drained_block.eq(self.drained_block),
                self.pixels[x].eq(core.pixel),
            ]
        return m

    def _delayed(self, m: Module) -> tuple[list[Any], list[Value]]:
        """The op in cycles 0 to 4, and its `valid`, which alone has a reset; drives op_out and the strobes."""
        op, valid = [self.op_in], [self.op_in.valid]
        for cycle in range(1, PIPELINE + SUMS_LATER):
            op.append(Signal(op_layout(self.config), name=f"op{cycle}", reset_less=True))
            valid.append(Signal(name=f"valid{cycle}"))
            m.d.sync += [op[cycle].eq(op[cycle - 1]), valid[cycle].eq(valid[cycle - 1])]
        m.d.comb += [
            self.op_out.eq(op[1]),
            self.op_out.valid.eq(valid[1]),
            self.draining.eq(valid[PIPELINE] & op[PIPELINE].drain),
            self.draining_block.eq(op[PIPELINE].bank >> self.config.level_banks - 1),
        ]
        m.d.sync += [
            self.drained.eq(valid[-1] & op[-1].drain),
            self.drained_block.eq(op[-1].bank >> self.config.level_banks - 1),
        ]
        return op, valid

    def _banks(self, m: Module, op: list[Any], valid: list[Value]) -> tuple[dict[int, Signal], dict[int, Signal], Signal]:
        """One-hot banks to read and to write in cycles 2 to 4, and to weigh in cycle 3; decoded once for the whole row."""
        read, write = ({cycle: Signal(self.config.banks, name=f"{name}{cycle}", reset_less=True) for cycle in (2, 3, 4)}
                       for name in ("read", "write"))
        left = Signal(self.config.banks, reset_less=True)
        for b in range(self.config.banks):
            here = op[1].bank == b if self.config.banks > 1 else Const(1)
            m.d.sync += [read[2][b].eq(here & self._reads(op[1])), write[2][b].eq(here & self._writes(op[1], valid[1]))]
        m.d.sync += left.eq(write[2] & ~op[2].last.replicate(len(left)))
        for cycle in (3, 4):
            m.d.sync += [read[cycle].eq(read[cycle - 1]), write[cycle].eq(write[cycle - 1])]
        return read, write, left
