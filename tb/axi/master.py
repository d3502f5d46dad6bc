"""Test scenarios of the AXI master. This module runs in the simulator's process: it reads orders and writes a report for
`tb.axi.suite`."""

from __future__ import annotations

import json
import logging
import os
import random
from collections.abc import Awaitable, Callable
from functools import partial
from itertools import cycle
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.task import Task
from cocotb.triggers import Combine, FallingEdge, ReadOnly
from cocotb.utils import get_sim_time
from cocotbext.axi import AxiBus, AxiRam

from spec.config import TINY
from spec.memory import BEAT_BYTES, WORDS, read_data, read_request, write_request
from tb.axi.device import READERS, WRITERS
from tb.axi.memory import Memory, Temper, fresh, merged
from tb.axi.watch import Watch
from tb.common.patterns import Pattern
from tb.common.runner import CLOCK_NS
from tb.common.streams import Sink, Source

REQUEST, BEAT, WRITE = read_request(TINY), read_data(TINY), write_request(TINY)
READ_BASE, WRITE_BASE, REGION = 1 << 13, 1 << 12, 24
"""Beat addresses. Readers read from READ_BASE on, where nobody writes. Writer i writes to the REGION beats from
WRITE_BASE + i REGION on."""

READ_BEATS = 1 << 13
"""Number of beats in the range that readers read."""

PATIENCE = 30_000
"""Limit on the number of cycles of a scenario."""


def words_of(beat: int) -> list[int]:
    """A beat's 32-bit words, lowest first."""
    return [beat >> 32 * word & 0xFFFFFFFF for word in range(WORDS)]


class Traffic:
    """The test clients and their requests.

    Attributes:
        reads: the beat addresses that each reader requests.
        writes: the requests of each writer.
        sinks: the receivers of the readers' data.
    """

    def __init__(self, dut: object, order: dict, seed: int):
        rng, self._dut, self._pattern, self._seed = random.Random(seed), dut, Pattern(order["pattern"]), seed
        counts = order["reads"]
        self.reads = [[READ_BASE + rng.randrange(READ_BEATS) for _ in range(count)] for count in counts]
        self.writes = [
            [{"beat": WRITE_BASE + REGION * i + rng.randrange(REGION), "word": words_of(rng.getrandbits(8 * BEAT_BYTES)),
              "strobe": rng.choice((0xFF, rng.getrandbits(WORDS)))} for _ in range(count)]
            for i, count in enumerate(order["writes"])]
        self.sinks: list[Sink] = []
        self._tasks: list[Task] = []

    def start(self) -> list[Task]:
        """Starts the clients; returns the tasks that end by themselves."""
        seeds = cycle(range(self._seed, self._seed + 100))
        self.sinks = [Sink(self._dut, f"data_{i}", BEAT, self._pattern, next(seeds)) for i in range(READERS)]
        endless = [cocotb.start_soon(sink.run()) for sink in self.sinks]
        ending = [
            cocotb.start_soon(Source(self._dut, f"read_{i}", REQUEST, self._pattern, next(seeds)).send(
                [{"beat": beat} for beat in beats])) for i, beats in enumerate(self.reads) if beats]
        ending += [
            cocotb.start_soon(Source(self._dut, f"write_{i}", WRITE, self._pattern, next(seeds)).send(writes))
            for i, writes in enumerate(self.writes) if writes]
        self._tasks = endless + ending
        return ending

    def stop(self) -> None:
        """Stops the clients in whatever state they are."""
        for task in self._tasks:
            task.cancel()
        for i in range(READERS):
            getattr(self._dut, f"read_{i}__valid").value = 0
        for i in range(WRITERS):
            getattr(self._dut, f"write_{i}__valid").value = 0

    async def finish(self, ending: list[Task]) -> None:
        """Waits until every request has been answered."""
        if ending:
            await Combine(*ending)
        for _ in range(PATIENCE):
            await FallingEdge(self._dut.clk)
            await ReadOnly()
            if self._dut.quiet.value and all(
                    len(sink.rows) >= len(beats) for sink, beats in zip(self.sinks, self.reads, strict=True)):
                return
        raise AssertionError(f"not done {PATIENCE} cycles after the last request")

    def problems(self, stored: dict[int, int], temper: Temper) -> list[str]:
        """Descriptions of all differences between the received or stored data and what is correct."""
        found = []
        for i, (sink, beats) in enumerate(zip(self.sinks, self.reads, strict=True)):
            got = [None if row["error"] else row["word"] for row in sink.rows]
            if got != [None if temper.fails(beat) else words_of(fresh(beat)) for beat in beats]:
                found.append(f"reader {i} did not get its beats in their order")
        wanted: dict[int, int] = {}
        for write in (write for writes in self.writes for write in writes):
            if not temper.fails(write["beat"]):
                words = sum(word << 32 * place for place, word in enumerate(write["word"]))
                strobe = sum(0xF << 4 * place for place in range(WORDS) if write["strobe"] >> place & 1)
                wanted[write["beat"]] = merged(wanted.get(write["beat"], fresh(write["beat"])), words, strobe)
        if stored != wanted:
            found.append("memory does not hold what was written")
        return found


async def reset(dut: object) -> None:
    """Sets all inputs to their idle values and holds reset for three cycles."""
    await FallingEdge(dut.clk)
    for name in ("abort", "restart", "clear_errors", "m_axi_rvalid", "m_axi_bvalid"):
        getattr(dut, name).value = 0
    for port in (*(f"read_{i}" for i in range(READERS)), *(f"write_{i}" for i in range(WRITERS))):
        getattr(dut, f"{port}__valid").value = 0
    for i in range(READERS):
        getattr(dut, f"data_{i}__ready").value = 0
    dut.rst.value = 1
    for _ in range(3):
        await FallingEdge(dut.clk)
    dut.rst.value = 0


async def until_quiet(dut: object) -> int:
    """Waits until no transaction is in flight; returns the number of cycles waited."""
    for waited in range(PATIENCE):
        await FallingEdge(dut.clk)
        await ReadOnly()
        if dut.quiet.value:
            return waited
    raise AssertionError(f"not quiet after {PATIENCE} cycles")


async def cut_off(dut: object, order: dict, traffic: Traffic) -> list[str]:
    """Starts traffic and aborts it halfway, in the way that `AxiMaster` describes. Returns the problems that it found.
    Afterwards the clients are ready for new traffic."""
    traffic.start()
    for _ in range(order["cut"]):
        await FallingEdge(dut.clk)
    dut.abort.value = 1
    waited = await until_quiet(dut)
    await FallingEdge(dut.clk)
    traffic.stop()
    dut.restart.value = 1
    await FallingEdge(dut.clk)
    dut.restart.value, dut.abort.value = 0, 0
    for sink, beats in zip(traffic.sinks, traffic.reads, strict=True):
        got = [row["word"] for row in sink.rows]
        if got != [words_of(fresh(beat)) for beat in beats[: len(got)]]:
            return ["wrong beats before the abort"]
    return [] if waited else ["the abort found nothing on its way"]


async def broken_off(dut: object, order: dict, temper: Temper) -> list[str]:
    """Starts traffic and stops it without waiting for answers, because master and memory are reset next. Returns problems."""
    memory = Memory(dut, temper, order["seed"] + 1, {"ar": READERS, "aw": WRITERS})
    traffic = Traffic(dut, order, order["seed"] + 1)
    task = cocotb.start_soon(memory.run())
    traffic.start()
    for _ in range(order["reset_at"]):
        await FallingEdge(dut.clk)
    under_way = not dut.quiet.value
    traffic.stop()
    task.cancel()
    return memory.problems + ([] if under_way else ["the reset found nothing on its way"])


async def clear_errors(dut: object) -> None:
    """Pulses `clear_errors` for one cycle and waits until its effect is visible."""
    for value in (1, 0):
        await FallingEdge(dut.clk)
        dut.clear_errors.value = value
    await FallingEdge(dut.clk)


def unfair(turns: dict[str, list[int]], order: dict) -> list[str]:
    """Descriptions of every round in which clients with equally many requests were not each served exactly once."""
    found = []
    for channel, counts in (("ar", order["reads"]), ("aw", order["writes"])):
        rounds = [turns[channel][i : i + len(counts)] for i in range(0, len(turns[channel]), len(counts))]
        if any(sorted(served) != list(range(len(counts))) for served in rounds):
            found.append(f"{channel.upper()} does not serve everybody in turn")
    return found


async def scenario(dut: object, order: dict) -> dict:
    """Runs one scenario on `Memory`; returns its report."""
    temper = Temper(**{**order["temper"], "latency": tuple(order["temper"]["latency"])})
    problems = []
    if order["reset_at"]:
        await reset(dut)
        problems += await broken_off(dut, order, temper)
    await reset(dut)
    memory, watch = Memory(dut, temper, order["seed"], {"ar": READERS, "aw": WRITERS}), Watch(dut)
    background = [cocotb.start_soon(memory.run()), cocotb.start_soon(watch.run())]
    if order["cut"]:
        problems += await cut_off(dut, order, Traffic(dut, order, order["seed"] + 1))
        memory.stored.clear()
    begin, traffic = memory.cycle, Traffic(dut, order, order["seed"])
    await traffic.finish(traffic.start())
    cycles = max([*memory.reads, *memory.writes]) - begin
    problems += traffic.problems(memory.stored, temper)
    if order["fair"]:
        problems += unfair(memory.turns, order)
    await clear_errors(dut)
    traffic.stop()
    for task in background:
        task.cancel()
    return {"name": order["name"], "problems": list(dict.fromkeys([*problems, *memory.problems, *watch.problems])),
            "cycles": cycles, "beats": sum(order["reads"]) + sum(order["writes"])}


async def scenario_ram(dut: object, order: dict, ram: AxiRam) -> dict:
    """Runs one scenario on the AXI memory of cocotbext-axi; returns its report."""
    await reset(dut)
    for beat in (*range(WRITE_BASE, WRITE_BASE + REGION * WRITERS), *range(READ_BASE, READ_BASE + READ_BEATS)):
        ram.write(beat * BEAT_BYTES, fresh(beat).to_bytes(BEAT_BYTES, "little"))
    rng, share = random.Random(order["seed"]), order["temper"]["pauses"]
    for side in (ram.read_if, ram.write_if):
        side.log.setLevel(logging.WARNING)
        for channel in ("ar", "r", "aw", "w", "b"):
            if hasattr(side, f"{channel}_channel"):
                flags = [rng.random() < share.get(channel, 0) for _ in range(997)]
                getattr(side, f"{channel}_channel").set_pause_generator(cycle(flags))
    watch, traffic = Watch(dut), Traffic(dut, order, order["seed"])
    watching, begin = cocotb.start_soon(watch.run()), get_sim_time("ns")
    await traffic.finish(traffic.start())
    written = {write["beat"] for writes in traffic.writes for write in writes}
    stored = {beat: int.from_bytes(ram.read(beat * BEAT_BYTES, BEAT_BYTES), "little") for beat in written}
    problems = [*traffic.problems(stored, Temper()), *watch.problems]
    await FallingEdge(dut.clk)
    traffic.stop()
    watching.cancel()
    cycles = round(get_sim_time("ns") - begin) // CLOCK_NS
    return {"name": order["name"], "problems": list(dict.fromkeys(problems)), "cycles": cycles,
            "beats": sum(order["reads"]) + sum(order["writes"])}


async def play(dut: object, kind: str, one: Callable[[dict], Awaitable[dict]]) -> None:
    """Runs all scenarios of a kind and writes the report to a file beside the orders."""
    folder = Path(os.environ["AXI_FOLDER"])
    orders = [order for order in json.loads((folder / "orders.json").read_text()) if order["kind"] == kind]
    (folder / f"{kind}.json").write_text(json.dumps([await one(order) for order in orders]))


@cocotb.test()
async def on_memory(dut: object) -> None:
    """Runs the scenarios that use this project's own memory model."""
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    await play(dut, "memory", partial(scenario, dut))


@cocotb.test()
async def on_ram(dut: object) -> None:
    """Runs the scenarios that use the memory model of cocotbext-axi."""
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    ram = AxiRam(AxiBus.from_prefix(dut, "m_axi"), dut.clk, dut.rst, size=(READ_BASE + READ_BEATS) * BEAT_BYTES)
    await play(dut, "ram", partial(scenario_ram, dut, ram=ram))
