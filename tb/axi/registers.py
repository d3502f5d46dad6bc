"""Test scenarios of the register file. This module runs in the simulator's process, where a host accesses the registers
through cocotbext-axi's AXI4-Lite master."""

from __future__ import annotations

import json
import logging
import os
import random
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import Combine, FallingEdge, ReadOnly, SimTimeoutError, with_timeout
from cocotb.utils import get_sim_time
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiResp

from rtl.axi.registers import counters_layout
from spec import host_settings, registers
from spec.codes import ErrorCode, Phase
from spec.config import AcceleratorConfig
from spec.memory import frame_settings
from spec.overrides import config_from_record
from spec.register_fields import Access, Register
from tb.common.runner import CLOCK_NS

START, ABORT, RESET, CLEAR, ENABLE_DONE, ENABLE_ERROR = 1, 2, 4, 8, 0x100, 0x200
BUSY, DONE, ERROR = 1, 2, 4

PATIENCE = 20_000
"""Number of cycles within which accesses that were issued together must be answered."""


class Host:
    """A host that reads and writes registers and records what the register file tells the machine.

    Attributes:
        starts: the packed frame settings at every `start` pulse.
        aborts, clears: the numbers of `abort` and `clear` pulses.
    """

    def __init__(self, dut: object, bus: AxiLiteMaster, config: AcceleratorConfig, pauses: float, seed: int):
        self.dut, self._bus, self.config, self.rng = dut, bus, config, random.Random(seed)
        self.map = {r.name: r for r in registers.register_map(config)}
        self.starts: list[int] = []
        self.aborts = self.clears = 0
        for side in (bus.read_if, bus.write_if):
            side.log.setLevel(logging.WARNING)
            for channel in ("ar", "r", "aw", "w", "b"):
                if hasattr(side, f"{channel}_channel"):
                    getattr(side, f"{channel}_channel").set_pause_generator(self._flags(pauses))

    def _flags(self, share: float) -> Iterator[bool]:
        return cycle([self.rng.random() < share for _ in range(997)])

    async def watch(self) -> None:
        """Counts the pulses, and checks that an answer stays unchanged until it is accepted. It never ends."""
        dut, held = self.dut, {"b": None, "r": None}
        while True:
            await FallingEdge(dut.clk)
            await ReadOnly()
            if dut.start.value:
                self.starts.append(int(dut.settings.value))
            self.aborts += int(dut.abort.value)
            self.clears += int(dut.clear.value)
            for channel, wires in (("b", ("bresp",)), ("r", ("rresp", "rdata"))):
                valid = bool(getattr(dut, f"s_axi_{channel}valid").value)
                offer = tuple(int(getattr(dut, f"s_axi_{wire}").value) for wire in wires) if valid else None
                assert held[channel] in (None, offer), f"{channel.upper()} was changed or withdrawn before it was taken"
                held[channel] = None if getattr(dut, f"s_axi_{channel}ready").value else offer

    async def write_at(self, address: int, value: bytes) -> AxiResp:
        """Writes up to four bytes within one word; returns the answer."""
        return (await self._bus.write(address, value)).resp

    async def write(self, name: str, value: int) -> None:
        """Writes a register by name; the write must be answered OKAY."""
        resp = await self.write_at(self.map[name].offset, value.to_bytes(4, "little"))
        assert resp == AxiResp.OKAY, (name, resp)

    async def read(self, name: str) -> int:
        """Reads a register by name; the read must be answered OKAY."""
        resp, value = await self.answer(self.map[name].offset)
        assert resp == AxiResp.OKAY, name
        return value

    async def answer(self, address: int) -> tuple[AxiResp, int]:
        """The answer to a read and the value read; the value is 0 where the read is refused."""
        answer = await self._bus.read(address, 4)
        return answer.resp, 0 if answer.resp != AxiResp.OKAY else int.from_bytes(answer.data, "little")

    async def wait(self, cycles: int = 8) -> None:
        """Waits until a write has taken effect."""
        for _ in range(cycles):
            await FallingEdge(self.dut.clk)

    async def write_settings(self, patterns: dict[str, int]) -> None:
        """Writes all settings in random order, with random values in the unused upper bits."""
        for name in self.rng.sample(list(patterns), len(patterns)):
            width = self.map[name].format.width
            await self.write(name, patterns[name] | self.rng.getrandbits(32 - width) << width if width < 32 else patterns[name])

    async def finish(self, code: ErrorCode) -> None:
        """Signals that the machine has finished its frame with this error code."""
        await FallingEdge(self.dut.clk)
        self.dut.error.value, self.dut.finished.value = int(code), 1
        await FallingEdge(self.dut.clk)
        self.dut.error.value, self.dut.finished.value, self.dut.busy.value = 0, 0, 0


def legal(host: Host) -> dict[str, int]:
    """Random bit patterns of all settings within their limits."""
    limits = {limit.setting: limit for limit in host_settings.limits(host.config)}
    patterns = {}
    for s in host_settings.settings(host.config):
        limit, width = limits.get(s.name), s.field.format.width
        if not limit:
            patterns[s.name] = host.rng.getrandbits(width)
            continue
        below = 1 << width if limit.low > limit.high else 0  # the lower limit of a signed number has a larger pattern
        between = host.rng.randint(limit.low - below, limit.high) & (1 << width) - 1
        patterns[s.name] = host.rng.choice((limit.low, limit.high, between))
    return patterns


def packed(host: Host, patterns: dict[str, int]) -> int:
    """The patterns packed into a record of frame settings."""
    bits, offset = 0, 0
    for f in frame_settings(host.config).fields:
        for i in range(f.count):
            bits |= patterns[f"{f.name}_{i}" if f.count > 1 else f.name] << offset
            offset += f.format.width
    return bits


def read_back(register: Register, pattern: int) -> int:
    """The 32 bits that a read returns for a setting with this pattern: a negative value is sign-extended."""
    width = register.format.width
    negative = registers.is_signed(register.format) and pattern >> width - 1
    return pattern | (0xFFFFFFFF >> width << width if negative else 0)


async def identity(host: Host) -> None:
    """The identity registers have their values and cannot be written."""
    for name, value in registers.identity(host.config).items():
        assert await host.read(name) == value, name
    for r in host.map.values():
        if r.access is Access.READ_ONLY:
            assert await host.write_at(r.offset, b"\xff" * 4) == AxiResp.SLVERR, r.name
    for name, value in registers.identity(host.config).items():
        assert await host.read(name) == value, name


async def unmapped(host: Host) -> None:
    """Accesses to addresses without a register are refused."""
    mapped = {r.offset for r in host.map.values()}
    free = [address for address in range(0, 1 << registers.REGISTER_ADDRESS_BITS, 4) if address not in mapped]
    for address in (*host.rng.sample(free, 40), free[0], free[-1]):
        assert (await host.answer(address))[0] == AxiResp.SLVERR, address
        assert await host.write_at(address, b"\x01\0\0\0") == AxiResp.SLVERR, address
    assert not host.starts


async def settings(host: Host) -> None:
    """Settings read back as they were written, in whole words and in single bytes. A reset clears them, but not where the host
    reads them from a memory."""
    patterns = {s.name: host.rng.getrandbits(s.field.format.width) for s in host_settings.settings(host.config)}
    await host.write_settings(patterns)
    for name, pattern in patterns.items():
        assert await host.read(name) == read_back(host.map[name], pattern), name
    for _ in range(40):
        name = host.rng.choice(list(patterns))
        first = host.rng.randrange(4)
        data = host.rng.randbytes(host.rng.randint(1, 4 - first))
        assert await host.write_at(host.map[name].offset + first, data) == AxiResp.OKAY
        mask = (1 << 8 * len(data)) - 1 << 8 * first
        merged = patterns[name] & ~mask | int.from_bytes(data, "little") << 8 * first
        patterns[name] = merged & (1 << host.map[name].format.width) - 1
        assert await host.read(name) == read_back(host.map[name], patterns[name]), name
    await restart(host.dut)
    for name, pattern in patterns.items():
        assert await host.read(name) == read_back(host.map[name], pattern if host.config.bank_memories else 0), name


async def crowd(host: Host) -> None:
    """Many reads and writes are issued at once and their answers accepted late: each gets its own answer, in order."""
    numbers = {s.name: host.rng.getrandbits(s.field.format.width) for s in host_settings.settings(host.config)}
    readable = {**registers.identity(host.config), "status": 0}
    wrong = 1 << registers.REGISTER_ADDRESS_BITS
    writing = [(host.map[name].offset, AxiResp.OKAY, name) for name in numbers]
    writing += [(host.map[name].offset, AxiResp.SLVERR, name) for name in readable] + [(wrong - 4, AxiResp.SLVERR, "")] * 9
    host.rng.shuffle(writing)
    reading = [(host.map[name].offset, AxiResp.OKAY, value) for name, value in readable.items()] * 6
    reading += [(wrong - 8, AxiResp.SLVERR, 0)] * 20
    host.rng.shuffle(reading)
    writes = [cocotb.start_soon(host.write_at(at, numbers.get(name, 0).to_bytes(4, "little"))) for at, _, name in writing]
    reads = [cocotb.start_soon(host.answer(at)) for at, _, _ in reading]
    for tasks in (writes, reads):
        try:
            await with_timeout(Combine(*tasks), PATIENCE * CLOCK_NS, "ns")
        except SimTimeoutError:
            raise AssertionError(f"{sum(not task.done() for task in tasks)} accesses were never answered") from None
    assert [task.result() for task in writes] == [resp for _, resp, _ in writing]
    assert [task.result() for task in reads] == [(resp, value) for _, resp, value in reading]
    for name, pattern in numbers.items():
        assert await host.read(name) == read_back(host.map[name], pattern), name


async def frames(host: Host) -> None:
    """Several frames run one after another. Each uses the settings from when it started, whatever is written while it runs."""
    patterns, busy = legal(host), 0
    await host.write_settings(patterns)
    for number in range(4):
        await host.write("control", START | (CLEAR if number == 2 else 0))
        await host.wait()
        assert host.starts[number:] == [packed(host, patterns)]
        host.dut.busy.value, host.dut.phase.value = number % 2, int(Phase.RENDER)
        assert await host.read("status") == BUSY | int(Phase.RENDER) << 8
        following = legal(host)
        await host.write_settings(following)
        await host.write("control", START)
        await host.wait()
        assert len(host.starts) == number + 1, "a start while busy must be ignored"
        assert int(host.dut.settings.value) == packed(host, patterns), "settings must stay while a frame is under way"
        await host.finish(ErrorCode.NONE)
        host.dut.phase.value = 0
        assert await host.read("status") == DONE and await host.read("error") == 0
        patterns = following
        busy += 1
    host.dut.busy.value = 1
    assert await host.read("status") == BUSY | DONE
    await host.write("control", START)
    await host.wait()
    assert len(host.starts) == busy and (host.aborts, host.clears) == (0, 1)


async def bad_settings(host: Host) -> None:
    """Each limit is violated on both sides, alone and together with another. The first violated setting is named, and no frame
    starts."""
    names = [s.name for s in host_settings.settings(host.config)]
    limits = host_settings.limits(host.config)
    good = legal(host)
    await host.write_settings(good)
    trials = [(limit.setting, value) for limit in limits for value in (limit.low - 1, limit.high + 1)
              if 0 <= value < 1 << host.map[limit.setting].format.width]
    assert {name for name, _ in trials} == {limit.setting for limit in limits}
    last = [limit for limit in limits if not limit.where][-1]
    also = last.setting, last.high + 1
    where = {limit.setting: limit.where for limit in limits if limit.where}
    for several in (False, True):
        for name, value in trials:
            wrong = good | ({also[0]: also[1]} if several else {}) | ({where[name]: 1} if name in where else {}) | {name: value}
            different = [changed for changed in wrong if wrong[changed] != good[changed]]
            for changed in different:
                await host.write(changed, wrong[changed])
            await host.write("control", START)
            await host.wait()
            assert await host.read("status") == ERROR and await host.read("error") == ErrorCode.BAD_SETTING
            assert names[await host.read("bad_setting")] == names[host_settings.first_illegal(host.config, wrong)], name
            assert await host.read("interrupt") == 2 and not host.starts
            await host.write("interrupt", 2)
            for changed in different:
                await host.write(changed, good[changed])
    await host.write("control", START)
    await host.wait()
    assert host.starts == [packed(host, good)] and await host.read("status") == BUSY and await host.read("error") == 0


async def interrupts(host: Host) -> None:
    """An interrupt becomes pending whether or not it is enabled, drives the line only where enabled, and is cleared by
    writing 1."""
    await host.write_settings(legal(host))
    cases = [(enabled, code) for enabled in (0, ENABLE_DONE, ENABLE_ERROR, ENABLE_DONE | ENABLE_ERROR)
             for code in (ErrorCode.NONE, ErrorCode.READ_ERROR, ErrorCode.WATCHDOG)]
    for enabled, code in cases:
        await host.write("control", enabled | START)
        await host.wait()
        assert await host.read("control") == enabled
        await host.finish(code)
        pending = 1 if code is ErrorCode.NONE else 2
        await host.wait(3)
        assert int(host.dut.interrupt.value) == bool(enabled >> 8 & pending)
        assert await host.read("interrupt") == pending and await host.read("error") == code
        assert await host.write_at(host.map["interrupt"].offset + 1, b"\xff") == AxiResp.OKAY
        await host.write("interrupt", 3 ^ pending)
        assert await host.read("interrupt") == pending
        await host.write("interrupt", pending)
        assert await host.read("interrupt") == 0 and not host.dut.interrupt.value
        assert await host.read("status") == (DONE if code is ErrorCode.NONE else ERROR)
    assert await host.write_at(host.map["control"].offset + 1, b"\x00") == AxiResp.OKAY
    assert await host.read("control") == 0
    assert await host.write_at(host.map["control"].offset + 1, b"\xff") == AxiResp.OKAY
    assert await host.read("control") == ENABLE_DONE | ENABLE_ERROR
    assert await host.write_at(host.map["control"].offset, bytes([CLEAR])) == AxiResp.OKAY
    assert await host.read("control") == ENABLE_DONE | ENABLE_ERROR and host.clears == 1


async def aborts(host: Host) -> None:
    """Abort and reset are written while a frame runs and while none does. A frame that was reset leaves no trace when it
    ends."""
    patterns = legal(host)
    await host.write_settings(patterns)
    await host.write("control", ABORT)
    await host.write("control", RESET)
    await host.wait()
    assert host.aborts == 0
    await host.write("control", START)
    await host.write("control", ABORT)
    await host.wait()
    assert len(host.starts) == host.aborts == 1 and await host.read("status") == BUSY
    await host.finish(ErrorCode.ABORTED)
    assert await host.read("status") == ERROR and await host.read("error") == ErrorCode.ABORTED
    await host.write("control", RESET)
    assert await host.read("status") == 0 and await host.read("error") == 0 and await host.read("interrupt") == 0
    for code in (ErrorCode.ABORTED, ErrorCode.NONE):
        await host.write("control", START)
        await host.write("control", RESET)
        await host.wait()
        assert await host.read("status") == BUSY
        await host.finish(code)
        assert await host.read("status") == 0 and await host.read("interrupt") == 0
    assert (len(host.starts), host.aborts) == (3, 3)
    await host.write("control", START)
    await host.wait()
    await host.finish(ErrorCode.NONE)
    assert await host.read("status") == DONE and host.starts[-1] == packed(host, patterns)


async def counters(host: Host) -> None:
    """Counters read by name; both halves of a 64-bit counter come from the same moment. Also reads the clients' errors."""
    layout = counters_layout(host.config)
    for _ in range(2):
        values = {c.name: host.rng.getrandbits(c.width) for c in registers.counters(host.config)}
        if host.config.counters:
            host.dut.counters.value = sum(value << layout[name].offset for name, value in values.items())
        else:
            values = dict.fromkeys(values, 0)
        for c in registers.counters(host.config):
            if c.width == 32:
                assert await host.read(c.name) == values[c.name], c.name
                continue
            low = await host.read(f"{c.name}_low")
            if host.config.counters:
                host.dut.counters.value = (1 << layout.size) - 1 - int(host.dut.counters.value)
                await host.wait(2)
            high = await host.read(f"{c.name}_high")
            if host.config.counters:
                host.dut.counters.value = (1 << layout.size) - 1 - int(host.dut.counters.value)
                await host.wait(2)
            assert high << 32 | low == values[c.name], c.name
    clients = registers.read_clients(host.config), registers.write_clients(host.config)
    reads, writes = (host.rng.getrandbits(len(names)) for names in clients)
    host.dut.read_errors.value, host.dut.write_errors.value = reads, writes
    assert await host.read("error_clients") == reads | writes << 16


SCENARIOS = {f.__name__: f for f in (identity, unmapped, settings, crowd, frames, bad_settings, interrupts, aborts, counters)}


async def restart(dut: object) -> None:
    """Sets all inputs to their idle values and resets the register file."""
    dut.rst.value = 1
    for name in ("finished", "error", "busy", "phase", "read_errors", "write_errors"):
        getattr(dut, name).value = 0
    for _ in range(4):
        await FallingEdge(dut.clk)
    dut.rst.value = 0
    await FallingEdge(dut.clk)


@cocotb.test()
async def scenarios(dut: object) -> None:
    """Runs the scenarios of the orders and writes the report to a file beside them."""
    folder, report = Path(os.environ["AXI_FOLDER"]), []
    orders = json.loads((folder / "orders.json").read_text())
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    bus = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), dut.clk, dut.rst)
    for order in orders:
        config = config_from_record(order["config"])
        await restart(dut)
        host = Host(dut, bus, config, order["pauses"], order["seed"])
        watching, begin = cocotb.start_soon(host.watch()), get_sim_time("ns")
        problems = []
        try:
            await SCENARIOS[order["scenario"]](host)
        except AssertionError as error:
            problems = [str(error) or repr(error)]
        watching.cancel()
        cycles = round(get_sim_time("ns") - begin) // CLOCK_NS
        report.append({"name": order["name"], "problems": problems, "cycles": cycles, "beats": 0})
    (folder / "registers.json").write_text(json.dumps(report))
