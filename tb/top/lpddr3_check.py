"""A cocotb test that offers requests to `memory.sv` in given cycles and records the cycles of their answers.

This module runs in the simulator's process. The simulated design is that of `memory_check.memory_design`. requests.json in
CHECK_FOLDER has `signals`, the values of the memory's ports, `reads` and `writes`, each a list of (cycle, client, byte
address) in the order of the cycles, and the number of `cycles`. answers.json then has `reads` and `writes`, each a list of
(cycle, client), and the counts of `activates` and `refreshes`. Cycle n ends with the n-th clock edge after the reset, from 0:
a request of that cycle is taken at this edge, and an answer of that cycle is put on the bus at it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge

from tb.common.runner import CLOCK_NS
from tb.top.device import SETTINGS

FIXED = {"arlen": 0, "arsize": 5, "arburst": 1, "arvalid": 0, "rready": 1, "awlen": 0, "awsize": 5, "awburst": 1, "awvalid": 0,
         "wdata": 0, "wstrb": (1 << 32) - 1, "wlast": 1, "wvalid": 0, "bready": 1}
"""Values of the bus where nothing is requested; answers are always taken."""


@cocotb.test()
async def requests_in_their_cycles(dut: object) -> None:
    """Plays requests.json; a request that the memory does not take in its cycle is an error."""
    folder = Path(os.environ["CHECK_FOLDER"])
    asked = json.loads((folder / "requests.json").read_text())
    for name in SETTINGS:
        getattr(dut, name).value = asked["signals"].get(name, 0)
    for name, value in FIXED.items():
        getattr(dut, f"axi_{name}").value = value
    reads, writes = ({cycle: rest for cycle, *rest in asked[kind]} for kind in ("reads", "writes"))
    answers = {"reads": [], "writes": []}
    dut.rst.value = 1
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    await ClockCycles(dut.clk, 3)
    await FallingEdge(dut.clk)
    dut.rst.value = 0
    for cycle in range(asked["cycles"]):
        _offer(dut, ("ar",), reads.get(cycle), cycle)
        _offer(dut, ("aw", "w"), writes.get(cycle), cycle)
        await FallingEdge(dut.clk)
        if dut.axi_rvalid.value:
            answers["reads"].append((cycle, int(dut.axi_rid.value)))
        if dut.axi_bvalid.value:
            answers["writes"].append((cycle, int(dut.axi_bid.value)))
    counts = {name: int(getattr(dut, name).value) for name in ("activates", "refreshes", "errors")}
    assert counts["errors"] == 0
    (folder / "answers.json").write_text(json.dumps(answers | counts))


def _offer(dut: object, channels: tuple[str, ...], request: list[int] | None, cycle: int) -> None:
    """Puts a request, or none, on its channels for the next clock edge."""
    for channel in channels:
        getattr(dut, f"axi_{channel}valid").value = int(request is not None)
        assert request is None or getattr(dut, f"axi_{channel}ready").value, f"{channel} is not ready in cycle {cycle}"
    if request is not None:
        client, address = request
        getattr(dut, f"axi_{channels[0]}id").value = client
        getattr(dut, f"axi_{channels[0]}addr").value = address
