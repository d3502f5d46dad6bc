"""The cocotb side of `tb.common.playback`: plays one recording after another in one simulation.

This module runs in the simulator's process. It reads orders.json, which lists the runs, and writes report.json with their
results (see `tb.common.player`).
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, First, RisingEdge, Timer
from tqdm import tqdm

from tb.common.runner import CLOCK_NS

_PROGRESS_CYCLES = 2000


@cocotb.test()
async def recordings(dut: object) -> None:
    """Plays all runs of the orders; the report has one item per run."""
    folder = Path(os.environ["PLAYBACK_FOLDER"])
    orders = json.loads((folder / "orders.json").read_text())
    dut.active.value, dut.rst.value, dut.watchdog.value = 0, 1, orders["watchdog"]
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    total = sum(sum(run["expected"].values()) for run in orders["runs"] if run["abort"] is None)
    report = []
    with tqdm(total=total, unit="item", disable=not orders["progress"], desc="RTL", mininterval=1) as bar:
        for number, run in enumerate(orders["runs"]):
            await start(dut, number, run)
            begin = time.perf_counter()
            if run["abort"] is None:
                await finish(dut, list(run["expected"]), bar)
            else:
                await ClockCycles(dut.clk, run["abort"])
                dut.rst.value = 1
                await ClockCycles(dut.clk, 1)
            report.append({**result(dut, orders["ports"], orders["observed"]), "seconds": time.perf_counter() - begin})
            dut.active.value = 0
            await ClockCycles(dut.clk, 1)
    (folder / "report.json").write_text(json.dumps(report))


async def start(dut: object, number: int, run: dict) -> None:
    """Begins a run: the reset if it has one, then its settings and its number, whose folder has its stimuli."""
    if run["reset"]:
        dut.rst.value = 1
        await ClockCycles(dut.clk, 3)
    dut.rst.value = 0
    for name, value in run["settings"].items():
        getattr(dut, name).value = value
    for name, count in run["expected"].items():
        getattr(dut, f"{name}_limit").value = count
    dut.run.value, dut.quiet.value, dut.active.value = number, run["quiet"], 1
    await ClockCycles(dut.clk, 2)  # the first edge samples `active`; `over` has fallen after the second


async def finish(dut: object, outputs: list[str], bar: tqdm | None = None) -> None:
    """Waits for the end of a run, and shows on the bar how many items of these outputs have come."""
    shown = 0
    while not dut.over.value:
        await First(RisingEdge(dut.over), Timer(_PROGRESS_CYCLES * CLOCK_NS, "ns"))
        items = sum(int(getattr(dut, f"{name}_items").value) for name in outputs)
        if bar is not None:
            bar.update(items - shown)
        shown = items


def result(dut: object, ports: list[str], observed: list[str]) -> dict:
    """What the testbench has counted and seen of a run."""
    def counters(what: str) -> dict[str, int]:
        return {name: int(getattr(dut, f"{name}_{what}").value) for name in ports}

    return {
        "cycles": int(dut.cycles.value), "errors": int(dut.errors.value),
        "items": counters("items"), "stalls": counters("stalls"),
        "observed": {name: int(getattr(dut, name).value) for name in observed},
    }
