"""cocotb tests of `memory.sv` alone, with cocotbext-axi's AXI master, against a plain byte array.

This module runs in the simulator's process. The simulated design is that of `memory_design`.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, Combine, FallingEdge
from cocotb.utils import get_sim_time
from cocotbext.axi import AxiBus, AxiMaster, AxiResp

from spec.memory import BEAT_BYTES
from tb.common.runner import CLOCK_NS, Design
from tb.top.device import OBSERVED, SETTINGS
from tb.top.memory import SOURCES, MemorySpeed

BEATS, ID_BITS = 256, 3

_MASTER = {
    "awid": ID_BITS, "awaddr": 32, "awlen": 8, "awsize": 3, "awburst": 2, "awvalid": 1, "wdata": 256, "wstrb": 32, "wlast": 1,
    "wvalid": 1, "bready": 1, "arid": ID_BITS, "araddr": 32, "arlen": 8, "arsize": 3, "arburst": 2, "arvalid": 1, "rready": 1}
_SLAVE = {
    "awready": 1, "wready": 1, "bid": ID_BITS, "bresp": 2, "bvalid": 1, "arready": 1, "rid": ID_BITS, "rdata": 256, "rresp": 2,
    "rlast": 1, "rvalid": 1}


def memory_design() -> Design:
    """The memory, with its bus as ports that cocotbext-axi recognises."""
    bus = [("input", _MASTER), ("output", _SLAVE)]
    plain = [("input", SETTINGS), ("output", OBSERVED)]
    ports = [f"{way} [{bits - 1}:0] axi_{name}" for way, group in bus for name, bits in group.items()]
    ports += [f"{way} [{bits - 1}:0] {name}" for way, group in plain for name, bits in group.items()]
    wires = [f".{name}(axi_{name})" for _, group in bus for name in group]
    wires += [f".{name}({name})" for _, group in plain for name in group]
    text = (f"module tb (input clk, input rst, {', '.join(ports)});\n"
            f"  memory #(.ID_BITS({ID_BITS})) memory (.clk(clk), .rst(rst), {', '.join(wires)});\n"
            "endmodule\n")
    public = ("clk", "rst", *(f"axi_{name}" for _, group in bus for name in group), *SETTINGS, *OBSERVED)
    return Design("memory", "tb", (*SOURCES, ("tb.sv", text)), public)


def _sometimes(rng: random.Random, share: float) -> Iterator[bool]:
    while True:
        yield rng.random() < share


def _master(dut: object) -> AxiMaster:
    dut.rst.value = 1
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    return AxiMaster(AxiBus.from_prefix(dut, "axi"), dut.clk, dut.rst, max_burst_len=1)


async def _reset(dut: object, speed: MemorySpeed, first_writable: int = 0) -> None:
    for name in SETTINGS:
        getattr(dut, name).value = {**speed.signals, "first_writable": first_writable}.get(name, 0)
    dut.rst.value = 1
    await ClockCycles(dut.clk, 4)
    dut.rst.value = 0
    await ClockCycles(dut.clk, 2)


async def _fill(master: AxiMaster, rng: random.Random) -> bytearray:
    model = bytearray(rng.randbytes(BEAT_BYTES * BEATS))
    for place in range(0, len(model), BEAT_BYTES):
        await master.write(place, bytes(model[place : place + BEAT_BYTES]), awid=rng.randrange(1 << ID_BITS))
    return model


@cocotb.test()
async def random_traffic(dut: object) -> None:
    """Reads and writes whole beats and parts of beats, with pauses on every channel of both sides."""
    await _random_traffic(dut, _master(dut), MemorySpeed(latency=5, pauses=90))


@cocotb.test()
async def random_traffic_of_lpddr3(dut: object) -> None:
    """The same with the other kind of memory, beside a fast machine and beside a slow one."""
    master = _master(dut)
    for clock_ns in (0.7, 6.0):
        await _random_traffic(dut, master, MemorySpeed(pauses=90, kind="lpddr3", clock_ns=clock_ns))
        assert int(dut.activates.value) > 0 and int(dut.refreshes.value) > 0


async def _random_traffic(dut: object, master: AxiMaster, speed: MemorySpeed) -> None:
    rng = random.Random(1)
    await _reset(dut, speed)
    channels = (master.write_if.aw_channel, master.write_if.w_channel, master.write_if.b_channel, master.read_if.ar_channel,
                master.read_if.r_channel)
    for channel in channels:
        channel.set_pause_generator(_sometimes(rng, 0.3))
    model = await _fill(master, rng)
    for _ in range(25):
        beats = rng.sample(range(BEATS), 40)  # distinct, so that no beat is read while it is written
        jobs = []
        for beat in beats[:20]:
            data, place = rng.randbytes(rng.randint(1, BEAT_BYTES)), BEAT_BYTES * beat
            model[place : place + len(data)] = data
            jobs.append(cocotb.start_soon(master.write(place, data, awid=rng.randrange(1 << ID_BITS))))
        for beat in beats[20:]:
            place = BEAT_BYTES * beat
            jobs.append(cocotb.start_soon(_expect(master, place, bytes(model[place : place + BEAT_BYTES]), rng)))
        await Combine(*jobs)
    for beat in range(BEATS):
        await _expect(master, BEAT_BYTES * beat, bytes(model[BEAT_BYTES * beat : BEAT_BYTES * (beat + 1)]), rng)
    assert int(dut.errors.value) == 0
    assert int(dut.reads.value) == 25 * 20 + BEATS and int(dut.writes.value) == 25 * 20 + BEATS


async def _expect(master: AxiMaster, place: int, wanted: bytes, rng: random.Random) -> None:
    answer = await master.read(place, BEAT_BYTES, arid=rng.randrange(1 << ID_BITS))
    assert answer.resp == AxiResp.OKAY and answer.data == wanted, f"{place:#x}"


@cocotb.test()
async def latency_and_failing_addresses(dut: object) -> None:
    """A single read of the ideal memory takes `latency` cycles between its handshakes. In both kinds, failing addresses answer
    with an error and keep their content."""
    master = _master(dut)
    for latency in (1, 2, 30):
        await _reset(dut, MemorySpeed(latency=latency, bytes_per_cycle=None, failing=(64, 128)))
        await master.write(0, bytes(range(32)))
        reading = cocotb.start_soon(master.read(0, 32))
        while not (dut.axi_arvalid.value and dut.axi_arready.value):
            await FallingEdge(dut.clk)
        begin = get_sim_time("ns")
        while not (dut.axi_rvalid.value and dut.axi_rready.value):
            await FallingEdge(dut.clk)
        assert get_sim_time("ns") - begin == latency * CLOCK_NS
        assert (await reading).data == bytes(range(32))
    await _failing_addresses(dut, master)
    await _reset(dut, MemorySpeed(kind="lpddr3", failing=(64, 128)))
    await _failing_addresses(dut, master)


async def _failing_addresses(dut: object, master: AxiMaster) -> None:
    for place in (64, 96):
        assert (await master.write(place, bytes(32))).resp == AxiResp.SLVERR
        assert (await master.read(place, 32)).resp == AxiResp.SLVERR
    for place in (32, 128):
        assert (await master.write(place, bytes(32))).resp == AxiResp.OKAY
        assert (await master.read(place, 32)).resp == AxiResp.OKAY
    dut.error_end.value = 0
    assert (await master.read(64, 32)).data != bytes(32)
    assert int(dut.errors.value) == 0


@cocotb.test()
async def broken_rules(dut: object) -> None:
    """The memory reports transactions that are not one aligned beat, addresses outside memory, and writes below
    `first_writable`."""
    master = _master(dut)
    for place, size, bit in ((4, 4, 2), (32 * BEATS, 32, 4), (96, 32, 8)):
        await _reset(dut, MemorySpeed(latency=1), 128 if bit == 8 else 0)
        await master.write(128, bytes(32))
        assert int(dut.errors.value) == 0
        await master.write(place, bytes(size))
        assert int(dut.errors.value) == bit, (place, int(dut.errors.value))
