"""The cocotb side of `tb.top.overlap_player`: plays frames in a row, each of which starts as soon as the machine takes it.

This module runs in the simulator's process. It reads orders.json, which lists rows of frames, and writes their results to
report.json.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge, First, RisingEdge, Timer
from cocotb.utils import get_sim_time

from tb.common.runner import CLOCK_NS
from tb.top.frames import Lite, numbers, transfer

_POLL_CYCLES = 8


@cocotb.test()
async def rows(dut: object) -> None:
    """Plays all rows of the orders; the report has one item per row."""
    folder = Path(os.environ["PLAYER_FOLDER"])
    orders = json.loads((folder / "orders.json").read_text())
    dut.rst.value, dut.load.value, dut.dump.value, dut.poison.value = 1, 0, 0, 0
    lite = Lite(dut)
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    report = [await _Row(dut, lite, orders, row).play() for row in orders["rows"]]
    (folder / "report.json").write_text(json.dumps(report))


class _Row:
    """A row of frames under way."""

    def __init__(self, dut: object, lite: Lite, orders: dict, row: dict) -> None:
        self._dut, self._lite, self._orders, self._row = dut, lite, orders, row
        self._started: list[int] = []
        self._ended: dict[int, dict] = {}
        self._flight: list[int] = []

    async def play(self) -> dict:
        """Plays the row. Returns the results of its frames in their order, and what memory has counted."""
        dut, row = self._dut, self._row
        for name, value in row["memory"].items():
            getattr(dut, name).value = value
        if row["reset"]:
            dut.rst.value = 1
            await ClockCycles(dut.clk, 3)
        dut.rst.value = 0
        before = numbers(dut)
        for address, value in row["first_writes"]:
            await self._lite.write(address, value)
        await self._settings(0)
        while len(self._ended) < len(row["frames"]):
            if not await self._collect() and not await self._begin():
                await self._wait()
            if row["cut"] is not None and len(self._started) == len(row["frames"]):
                await ClockCycles(dut.clk, row["cut"])
                break
        after = numbers(dut)
        return {"frames": [self._ended.get(i) for i in range(len(row["frames"]))], "errors": after["errors"],
                **{name: (after[name] - before[name]) % (1 << 32) for name in ("reads", "writes")}}

    async def _settings(self, number: int) -> None:
        """Writes the settings of a frame, which the machine copies when the frame starts."""
        if number < len(self._row["frames"]):
            for address, value in self._row["frames"][number]["settings"]:
                await self._lite.write(address, value)

    async def _begin(self) -> bool:
        """Starts the next frame if the machine takes it, and writes what the host writes while it runs."""
        number, reads, row = len(self._started), self._orders["reads"], self._row
        if number == len(row["frames"]) or not await self._lite.read(reads["status"]) & self._orders["ready"]:
            return False
        if number >= 2 and number - 2 not in self._ended:
            return False  # the frame that has the place in memory has ended, and its pixels are read first
        frame = row["frames"][number]
        for load in frame["loads"]:
            await transfer(self._dut, self._dut.load, *load)
        await FallingEdge(self._dut.clk)
        ran = not frame["refused"]
        await self._lite.write(*row["start_write"])
        self._started.append(number)
        begun = get_sim_time("ns")
        if ran:
            self._flight.append(number)
        else:
            await ClockCycles(self._dut.clk, 4)
            await self._end(number, begun, 0, 0)
        frame["begun"] = begun
        await self._settings(number + 1)
        if frame["abort"] is not None:
            await ClockCycles(self._dut.clk, frame["abort"])
            await self._lite.write(*row["abort_write"])
        return True

    async def _collect(self) -> bool:
        """Takes the results of frames that have ended. Two end together where one has failed."""
        reads = self._orders["reads"]
        count = await self._lite.read(reads["frames"])
        known = sum(not frame["refused"] for i, frame in enumerate(self._row["frames"]) if i in self._ended)
        if count == known:
            return False
        for place in range(count - known):
            number = self._flight.pop(0)
            await self._end(number, self._row["frames"][number]["begun"], place, count - known)
        for address, value in self._row["last_writes"]:
            await self._lite.write(address, value)
        assert count == await self._lite.read(reads["frames"]), "frames ended faster than their results are read"
        return True

    async def _end(self, number: int, begun: float, place: int, together: int) -> None:
        """Reads the registers and dumps the pixels of a frame, which has ended as number `place` of so many together."""
        reads = self._orders["reads"]
        registers = {name: await self._lite.read(address) for name, address in reads.items()}
        await FallingEdge(self._dut.clk)
        await transfer(self._dut, self._dut.dump, *self._row["frames"][number]["dump"])
        self._ended[number] = {
            "registers": registers, "begun": round(begun / CLOCK_NS), "place": place, "together": together}

    async def _wait(self) -> None:
        """Waits until a frame may have ended, or for a few cycles where one is to start."""
        starts = len(self._started) < len(self._row["frames"])
        patience = _POLL_CYCLES if starts else self._orders["watchdog"]
        if not self._dut.interrupt.value:
            await First(RisingEdge(self._dut.interrupt), Timer(patience * CLOCK_NS, "ns"))
        assert int(self._dut.idle.value) <= self._orders["watchdog"], "nothing moved on the bus"
