"""What test_tb_playback.py runs in the simulator's process: Python's sources and sinks on the faulty unit."""

import os

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, Combine

from spec.packing import pack, unpack
from tb.common.patterns import Pattern
from tb.common.streams import Sink, Source
from tests.helpers.faulty_unit import RECORD


def items(seed: int, count: int = 40) -> np.ndarray:
    rows = np.zeros(count, RECORD.dtype)
    rows["number"] = np.arange(count)
    rows["values"] = np.random.default_rng(seed).integers(-(2**20), 2**20, (count, 9))
    return rows


@cocotb.test()
async def every_pattern(dut):
    """The right rows under every pattern; with a fault in the unit the sink must complain."""
    cocotb.start_soon(Clock(dut.clk, 1, "ns").start())
    dut.key.value, dut.fault.value = 5, int(os.environ["UNIT_FAULT"])
    left, right = items(1), items(2)
    expected = pack(RECORD, left) ^ pack(RECORD, right)
    expected[:, 0] ^= 5
    for seed, pattern in enumerate(Pattern):
        dut.rst.value = 1
        await ClockCycles(dut.clk, 2)
        dut.rst.value = 0
        sources = [Source(dut, name, RECORD, pattern, seed + i) for i, name in enumerate(("left", "right"))]
        sink = Sink(dut, "out", RECORD, pattern, seed + 2)
        taking = cocotb.start_soon(sink.run())
        await Combine(*(cocotb.start_soon(source.send(rows)) for source, rows in zip(sources, (left, right), strict=True)))
        await ClockCycles(dut.clk, 300)
        taking.cancel()
        await ClockCycles(dut.clk, 1)
        assert [source.sent for source in sources] == [40, 40]
        rows = unpack(RECORD, expected)
        assert [RECORD.pack(row) for row in sink.rows] == [RECORD.pack(row) for row in rows], pattern
