"""A row of the array of a machine with super-tiles: its cores take the state of their pixels with a load.

A load covers no pixel. It enters the rows as any op does, and row r takes transmittances and sums from the state bus, which
carries them for the row that the load has reached::

    cycle             0     1     2     3     4     5
    op_in           <load>
    state (T)                   <  T >
    transmittance                     <  T >
    state (sums)                            <sums>
    colour, depth                                 <sums>

The bus is common to all rows: loads are at least `cores_y` cycles apart, so that one row at a time takes a state, and another
one sums. A load takes both level banks of its block. An op may directly precede or follow it.

A store is an op with `drain` that is not the background: it raises the strobes and changes nothing.
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Const, Module, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In

from rtl.vrc_array.pixel_core import PixelCore, pixel_layout
from rtl.vrc_array.row import VrcRow
from spec.config import AcceleratorConfig
from spec.supertiles import check_supertiles


def state_layout(config: AcceleratorConfig) -> data.ArrayLayout:
    """The state of a pixel: one `pixel_layout` for each level bank."""
    return data.ArrayLayout(pixel_layout(config), config.level_banks)


class BatchCore(PixelCore):
    """A pixel core whose state can be loaded.

    Parameters and ports: those of PixelCore, and

        load, load_sums: cycles 2 and 4 of a load; one-hot block that takes transmittances, and sums, of both level banks.
        state: the transmittances in cycle 2, the sums in cycle 4.
    """

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        check_supertiles(config)

    def _ports(self) -> dict[str, wiring.Member]:
        blocks = self.config.blocks
        return {**super()._ports(), "load": In(blocks), "load_sums": In(blocks), "state": In(state_layout(self.config))}

    def _first(self) -> Value:
        return Const(0, 1)

    def _blend(self, m: Module, keep: Value, covered: Value) -> tuple[list[Signal], Value, Signal]:
        blended = banks, _, _ = super()._blend(m, keep, covered)
        self._take(m, self.load, banks, [pixel.transmittance for pixel in self.state])
        return blended

    def _sums(self, m: Module, weight: Value, fine: Value, touched: Value) -> list[list[Signal]]:
        every = super()._sums(m, weight, fine, touched)
        for s, banks in enumerate(every):
            self._take(m, self.load_sums, banks, [pixel.depth if s == 3 else pixel.colour[s] for pixel in self.state])
        return every

    def _take(self, m: Module, load: Value, banks: list[Signal], levels: list[Value]) -> None:
        """Loads the banks of a block with the values of their levels."""
        for b, bank in enumerate(banks):
            block, level = divmod(b, self.config.level_banks)
            with m.If(load[block]):
                m.d.sync += bank.eq(levels[level])


class BatchRow(VrcRow):
    """A row of pixel cores whose state can be loaded.

    Parameters and ports: those of VrcRow, and

        state: the state bus, for each column; see the module.
    """

    _core = "batch_core", BatchCore

    def __init__(self, config: AcceleratorConfig):
        super().__init__(config)
        check_supertiles(config)

    def _ports(self) -> dict[str, wiring.Member]:
        return {**super()._ports(), "state": In(data.ArrayLayout(state_layout(self.config), self.config.array_x))}

    def _reads(self, op: Any) -> Value:
        return Const(1, 1)

    def _writes(self, op: Any, valid: Value) -> Value:
        return valid & ~op.load & (op.last | ~op.drain)

    def _banks(self, m: Module, op: list[Any], valid: list[Value]) -> tuple[dict[int, Signal], dict[int, Signal], Signal]:
        blocks, level_bits = self.config.blocks, self.config.level_banks - 1
        self._load = [Signal(blocks, name=f"load{cycle}") for cycle in (2, 3, 4)]
        for block in range(blocks):
            here = op[1].bank >> level_bits == block if blocks > 1 else Const(1)
            m.d.sync += self._load[0][block].eq(here & valid[1] & op[1].load)
        m.d.sync += [after.eq(before) for before, after in zip(self._load, self._load[1:], strict=False)]
        return super()._banks(m, op, valid)

    def _begin(self, column: int, core: Any, op: list[Any]) -> list[Any]:
        return [core.load.eq(self._load[0]), core.load_sums.eq(self._load[-1]), core.state.eq(self.state[column])]
