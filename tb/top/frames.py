"""The cocotb side of `tb.top.player`: plays one frame after another in one simulation, and sleeps while the machine works.

This module runs in the simulator's process. It reads orders.json, which lists the frames, and writes their results to
report.json.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge, First, ReadOnly, RisingEdge, Timer
from cocotb.utils import get_sim_time
from tqdm import tqdm

from tb.common.runner import CLOCK_NS
from tb.top.progress import Pass, Progress

_PROGRESS_CYCLES = 5000
_PATIENCE = 1000
_POLL_CYCLES = 20
_COUNTERS = ("reads", "writes", "busy", "watched", "activates", "refreshes")


class Lite:
    """An AXI-Lite master that makes one access at a time. It runs no process between accesses."""

    def __init__(self, dut: object):
        self._dut = dut
        for name in ("awvalid", "wvalid", "bready", "arvalid", "rready", "awprot", "arprot"):
            self._port(name).value = 0

    def _port(self, name: str) -> object:
        return getattr(self._dut, f"s_axil_{name}")

    async def _offer(self, channels: tuple[str, ...], answer: str) -> None:
        """Holds valid on every channel until it is accepted, and ready until the answer comes. Returns when the answer was
        read."""
        waiting = set(channels)
        await FallingEdge(self._dut.clk)
        for channel in channels:
            self._port(f"{channel}valid").value = 1
        self._port(f"{answer}ready").value = 1
        answered = False
        for _ in range(_PATIENCE):
            await ReadOnly()
            taken = {channel for channel in waiting if self._port(f"{channel}ready").value}
            answered = bool(self._port(f"{answer}valid").value)
            self._answer = {name: int(self._port(f"{answer}{name}").value) for name in ("resp", *("data",) * (answer == "r"))}
            await FallingEdge(self._dut.clk)
            for channel in taken:
                self._port(f"{channel}valid").value = 0
            waiting -= taken
            if answered and not waiting:
                break
        assert answered and not waiting, f"no answer on channel {answer} in {_PATIENCE} cycles"
        self._port(f"{answer}ready").value = 0

    async def write(self, address: int, data: int) -> None:
        """Writes a register. Raises AssertionError where the write is refused."""
        for name, value in (("awaddr", address), ("wdata", data & 0xFFFFFFFF), ("wstrb", 15)):
            self._port(name).value = value
        await self._offer(("aw", "w"), "b")
        assert self._answer["resp"] == 0, f"write to {address:#x} answered with {self._answer['resp']}"

    async def read(self, address: int) -> int:
        """The value of a register. Raises AssertionError where the read is refused."""
        self._port("araddr").value = address
        await self._offer(("ar",), "r")
        assert self._answer["resp"] == 0, f"read from {address:#x} answered with {self._answer['resp']}"
        return self._answer["data"]


@cocotb.test()
async def frames(dut: object) -> None:
    """Plays all frames of the orders; the report has one item per frame."""
    folder = Path(os.environ["PLAYER_FOLDER"])
    orders = json.loads((folder / "orders.json").read_text())
    dut.rst.value, dut.load.value, dut.dump.value, dut.poison.value = 1, 0, 0, 0
    lite = Lite(dut)
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    expected = [Progress([Pass(**item) for item in frame["passes"]]) for frame in orders["frames"]]
    report, ended = [], 0.0
    with tqdm(total=sum(progress.total for progress in expected), disable=not orders["progress"], desc="RTL geometry ",
              mininterval=1, bar_format="{l_bar}{bar}| {elapsed}<{remaining}") as bar:
        for frame, progress in zip(orders["frames"], expected, strict=True):
            found, ended = await _frame(dut, lite, orders, frame, _Shown(bar, progress), ended)
            report.append(found)
    (folder / "report.json").write_text(json.dumps(report))


class _Shown:
    """The part of the progress bar that belongs to one frame."""

    def __init__(self, bar: tqdm, progress: Progress) -> None:
        self._bar, self._progress, self._shown = bar, progress, 0.0

    def see(self, beats: int, pixels: int) -> None:
        """Moves the bar to what memory has seen since the frame's start."""
        self._progress.see(beats, pixels)
        self._bar.set_description(f"RTL {self._progress.phase:<9}", refresh=False)
        self._move(self._progress.done)

    def end(self) -> None:
        """Moves the bar to the frame's end, however it ended."""
        self._move(self._progress.total)

    def _move(self, done: float) -> None:
        self._bar.update(done - self._shown)
        self._shown = done


async def _frame(
    dut: object, lite: Lite, orders: dict, frame: dict, shown: _Shown, ended: float,
) -> tuple[dict, float]:
    """Plays a frame, after one that ended at the time `ended`. Returns its results and the time at which it ends.

    The machine begins half a cycle after the answer to the start command was read, and the interrupt comes a cycle after its
    end.
    """
    for name, value in frame["memory"].items():
        getattr(dut, name).value = value
    if frame["reset"]:
        dut.rst.value = 1
        await ClockCycles(dut.clk, 3)
        ended = get_sim_time("ns")
    dut.rst.value = 0
    for number, first, beats, poison in frame["loads"]:
        dut.poison.value = poison
        await transfer(dut, dut.load, number, first, beats)
    await ClockCycles(dut.clk, frame["settle"] + 1)
    await FallingEdge(dut.clk)
    before = numbers(dut)
    begin, clock = get_sim_time("ns"), time.perf_counter()
    cpu = time.process_time()
    for address, value in frame["writes"]:
        await lite.write(address, value)
    started, end = get_sim_time("ns"), "cut off"
    if frame["late"] is not None:
        await _second_pass(dut, lite, frame["late"])
    if frame["abort"] is not None:
        await ClockCycles(dut.clk, frame["abort"])
        await lite.write(*frame["abort_write"])
    if frame["cut"] is None:
        end = await _finish(dut, orders["watchdog"], before, frame["pixel_bytes"], shown)
    else:
        await ClockCycles(dut.clk, frame["cut"])
    last, seconds = get_sim_time("ns"), time.perf_counter() - clock
    cycles = (last - started) / CLOCK_NS
    cpu_seconds = time.process_time() - cpu
    after = numbers(dut)
    shown.end()
    registers = {name: await lite.read(address) for name, address in orders["reads"].items()} if end != "cut off" else {}
    for address, value in frame["last_writes"]:
        await lite.write(address, value)
    await FallingEdge(dut.clk)
    await transfer(dut, dut.dump, *frame["dump"])
    return {
        "end": end, "cycles": round(cycles), "host_cycles": round((started - begin) / CLOCK_NS),
        "idle_cycles": round((started - ended) / CLOCK_NS + 0.5), "seconds": seconds,
        "cpu_seconds": cpu_seconds, "registers": registers, "errors": after["errors"],
        **{name: (after[name] - before[name]) % (1 << 32) for name in _COUNTERS}}, last - CLOCK_NS


async def _second_pass(dut: object, lite: Lite, counter: int) -> None:
    """Waits until the target eye's pass runs: until its cycle counter is no longer zero."""
    while not await lite.read(counter):
        assert not dut.interrupt.value, "the frame ended before its second pass"
        await ClockCycles(dut.clk, _POLL_CYCLES)


async def transfer(dut: object, strobe: object, number: int, first: int, beats: int) -> None:
    """Copies a file to memory or memory to a file, depending on the strobe."""
    dut.file_number.value, dut.file_first.value, dut.file_beats.value = number, first, beats
    strobe.value = 1
    await ClockCycles(dut.clk, 2)
    strobe.value = 0
    await ClockCycles(dut.clk, 2)


def numbers(dut: object) -> dict[str, int]:
    return {name: int(getattr(dut, name).value) for name in (*_COUNTERS, "errors")}


async def _finish(dut: object, watchdog: int, before: dict[str, int], pixel_bytes: int, shown: _Shown) -> str:
    """Waits for the interrupt; returns "interrupt", or "stuck" when nothing has moved on the bus for `watchdog` cycles."""
    while not dut.interrupt.value:
        await First(RisingEdge(dut.interrupt), Timer(_PROGRESS_CYCLES * CLOCK_NS, "ns"))
        reads, writes, watched = (
            (int(getattr(dut, name).value) - before[name]) % (1 << 32) for name in ("reads", "writes", "watched"))
        shown.see(reads + writes, watched // pixel_bytes)
        if int(dut.idle.value) > watchdog:
            return "stuck"
    return "interrupt"
