"""The cocotb side of `tb.top.axi_small`. This module runs in the simulator's process."""

from __future__ import annotations

import json
import logging
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, First, RisingEdge, Timer
from cocotb.utils import get_sim_time
from cocotbext.axi import AxiBus, AxiLiteBus, AxiLiteMaster, AxiRam, AxiResp

from spec.memory import BEAT_BYTES
from tb.common.runner import CLOCK_NS


def _pauses(seed: int, of_256: int) -> Iterator[bool]:
    rng = random.Random(seed)
    while True:
        yield rng.randrange(256) < of_256


@cocotb.test()
async def frames(dut: object) -> None:
    """Plays all frames of the orders; the report has one item per frame."""
    folder = Path(os.environ["PLAYER_FOLDER"])
    orders = json.loads((folder / "orders.json").read_text())
    dut.rst.value = 1
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    size = BEAT_BYTES * max(frame["dump"][1] + frame["dump"][2] for frame in orders["frames"])
    ram = AxiRam(AxiBus.from_prefix(dut, "m_axi"), dut.clk, dut.rst, size=size, mem=bytearray(size))
    host = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axil"), dut.clk, dut.rst)
    for part in (ram.write_if, ram.read_if, host.write_if, host.read_if):
        part.log.setLevel(logging.WARNING)
    await ClockCycles(dut.clk, 3)
    report = [await _frame(dut, ram, host, orders, frame, folder) for frame in orders["frames"]]
    (folder / "report.json").write_text(json.dumps(report))


async def _frame(dut: object, ram: AxiRam, host: AxiLiteMaster, orders: dict, frame: dict, folder: Path) -> dict:
    channels = (ram.write_if.aw_channel, ram.write_if.w_channel, ram.write_if.b_channel, ram.read_if.ar_channel,
                ram.read_if.r_channel)
    for seed, channel in enumerate(channels):
        channel.set_pause_generator(_pauses(seed, frame["memory"]["pauses"]))
    if frame["reset"]:
        dut.rst.value = 1
        await ClockCycles(dut.clk, 3)
    dut.rst.value = 0
    for number, first, _, poison in frame["loads"]:
        if poison:
            ram.write(0, random.Random(number).randbytes(len(ram.mem)))
        rows = np.fromfile(folder / f"{number}.bin", np.uint8).reshape(-1, BEAT_BYTES)
        ram.write(BEAT_BYTES * first, rows[:, ::-1].tobytes())
    await ClockCycles(dut.clk, 2)
    clock = time.perf_counter()
    cpu = time.process_time()
    for address, value in frame["writes"]:
        await _write(host, address, value)
    started, end = get_sim_time("ns"), "cut off"
    if frame["abort"] is not None:
        await ClockCycles(dut.clk, frame["abort"])
        await _write(host, *frame["abort_write"])
    if frame["cut"] is None:
        end = await _finish(dut, orders["watchdog"])
    else:
        await ClockCycles(dut.clk, frame["cut"])
    cycles, seconds = round((get_sim_time("ns") - started) / CLOCK_NS), time.perf_counter() - clock
    cpu_seconds = time.process_time() - cpu
    registers = {}
    if end != "cut off":
        registers = {name: await _read(host, address) for name, address in orders["reads"].items()}
        for address, value in frame["last_writes"]:
            await _write(host, address, value)
    number, first, beats = frame["dump"]
    (folder / f"{number}.dump").write_bytes(ram.read(BEAT_BYTES * first, BEAT_BYTES * beats))
    return {"end": end, "cycles": cycles, "seconds": seconds, "cpu_seconds": cpu_seconds, "registers": registers,
            "errors": 0, "reads": 0, "writes": 0, "busy": 0, "activates": 0, "refreshes": 0, "idle_cycles": 0}


async def _write(host: AxiLiteMaster, address: int, value: int) -> None:
    answer = await host.write(address, (value & 0xFFFFFFFF).to_bytes(4, "little"))
    assert answer.resp == AxiResp.OKAY, f"write to {address:#x} answered with {answer.resp}"


async def _read(host: AxiLiteMaster, address: int) -> int:
    answer = await host.read(address, 4)
    assert answer.resp == AxiResp.OKAY, f"read from {address:#x} answered with {answer.resp}"
    return int.from_bytes(answer.data, "little")


async def _finish(dut: object, watchdog: int) -> str:
    """Waits for the interrupt; returns "interrupt", or "stuck" when nothing has moved on the bus for `watchdog` cycles."""
    while not dut.interrupt.value:
        quiet = Timer(watchdog * CLOCK_NS, "ns")
        moved = await First(
            RisingEdge(dut.interrupt), RisingEdge(dut.m_axi_arvalid), RisingEdge(dut.m_axi_awvalid), quiet)
        if moved is quiet:
            return "stuck"
    return "interrupt"
