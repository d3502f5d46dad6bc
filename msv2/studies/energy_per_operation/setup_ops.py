"""The setup unit's operations, simulated from its RTL in Amaranth's simulator, as the reference for its netlist alone.

The golden renderer has no values at this interface. Within the array, the same netlist is compared with golden pixels.
"""

from __future__ import annotations

import numpy as np
from amaranth.sim import Simulator

from rtl.vrc_array.setup import SetupUnit
from spec.config import AcceleratorConfig
from spec.records import array_splat, pixel_op, tile_header


def setup_ops(config: AcceleratorConfig, headers: np.ndarray, entries: np.ndarray, background: int) -> np.ndarray:
    """PixelOp rows of tiles in which no pixel ever stops."""
    dut, packed = SetupUnit(config), []

    async def feed(ctx, port, values: list[int]) -> None:
        ctx.set(port.valid, 1)
        for value in values:
            ctx.set(port.payload.as_value(), value)
            await ctx.tick().until(port.ready)
        ctx.set(port.valid, 0)

    async def tiles(ctx) -> None:
        ctx.set(dut.background.as_value(), background)
        await feed(ctx, dut.tiles, [tile_header(config).pack(row) for row in headers])

    async def pairs(ctx) -> None:
        await feed(ctx, dut.entries, [array_splat(config).pack(row) for row in entries])

    async def take(ctx) -> None:
        ctx.set(dut.ops.ready, 1)
        ended = 0
        while ended < len(headers):
            _, _, valid, bits, drain = await ctx.tick().sample(
                dut.ops.valid, dut.ops.payload.as_value(), dut.ops.payload.drain)
            if valid:
                packed.append(bits)
                ended += drain

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    for testbench in (tiles, pairs, take):
        simulator.add_testbench(testbench, background=testbench is not take)
    simulator.run()
    record = pixel_op(config)
    rows = np.zeros(len(packed), record.dtype)
    for row, bits in zip(rows, packed, strict=True):
        for name, value in record.unpack(bits).items():
            row[name] = value
    return rows
