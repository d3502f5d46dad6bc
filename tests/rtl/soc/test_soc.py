"""The parts of the system around the machine, in Amaranth's own simulator: each against a plain model of what it must do."""

from __future__ import annotations

import random
from typing import Any

import pytest
from amaranth.lib import wiring
from amaranth.sim import Simulator

from rtl.axi.bus import axi_lite_slave_ports
from rtl.soc.memory_bridge import WORDS, MemoryBridge
from rtl.soc.register_bridge import RegisterBridge
from rtl.soc.serial import Sender
from rtl.soc.system import FIRMWARE_WORDS, System
from spec.config import FPGA

ID_BITS = 3
SPACE = 64
"""Words of the memory in the test of the bridge."""


def simulate(component: wiring.Component, *benches: Any) -> None:
    """Runs the first bench to its end and the others beside it."""
    simulator = Simulator(component)
    simulator.add_clock(1e-9)
    for number, bench in enumerate(benches):
        simulator.add_testbench(bench, background=number > 0)
    simulator.run()


@pytest.mark.parametrize("divisor", [2, 7])
def test_bytes_are_sent_as_a_terminal_reads_them(divisor: int) -> None:
    sender, wanted, seen = Sender(divisor), [0x00, 0xFF, 0xA5, 0x5A, 0x01], []

    async def write(ctx: Any) -> None:
        for byte in wanted:
            ctx.set(sender.byte, byte)
            ctx.set(sender.valid, 1)
            await ctx.tick().until(~sender.busy)
            ctx.set(sender.valid, 0)
        await ctx.tick().repeat(12 * divisor)

    async def terminal(ctx: Any) -> None:
        while True:
            await ctx.negedge(sender.line)
            await ctx.tick().repeat(divisor // 2)
            bits = [ctx.get(sender.line)]
            for _ in range(9):
                await ctx.tick().repeat(divisor)
                bits.append(ctx.get(sender.line))
            assert (bits[0], bits[9]) == (0, 1)
            seen.append(sum(bit << place for place, bit in enumerate(bits[1:9])))

    simulate(sender, write, terminal)
    assert seen == wanted


@pytest.mark.parametrize("divisor", [1, 0, True, 2.5])
def test_a_bit_takes_two_cycles_at_least(divisor: object) -> None:
    with pytest.raises(ValueError, match=rf"not {divisor!r}$"):
        Sender(divisor)


def test_registers_are_read_and_written_through_a_slow_slave() -> None:
    """Addresses and words are taken at different times, and answers come late; every access happens once, in order."""
    bridge, rng = RegisterBridge(), random.Random(3)
    accesses = [(rng.randrange(2), 4 * rng.randrange(64), rng.getrandbits(32)) for _ in range(40)]
    registers: dict[int, int] = {}
    assert set(axi_lite_slave_ports("m_axil")) < set(bridge.signature.members)

    async def processor(ctx: Any) -> None:
        wanted: dict[int, int] = {}
        for write, address, value in accesses:
            ctx.set(bridge.address, address // 4)
            ctx.set(bridge.write, 15 * write)
            ctx.set(bridge.write_data, value)
            ctx.set(bridge.valid, 1)
            *_, read = await ctx.tick().sample(bridge.read_data).until(bridge.ready)
            ctx.set(bridge.valid, 0)
            if write:
                wanted[address] = value
            else:
                assert read == wanted.get(address, 0)
            await ctx.tick().repeat(rng.randrange(1, 4))
        assert registers == wanted

    async def channel(ctx: Any, name: str, *fields: str) -> list[int]:
        """Takes a transfer of a channel, after some cycles of waiting."""
        await ctx.tick().repeat(rng.randrange(1, 4))
        ready = getattr(bridge, f"m_axil_{name}ready")
        ctx.set(ready, 1)
        found = await ctx.tick().sample(*(getattr(bridge, f"m_axil_{name}{field}") for field in fields)).until(
            getattr(bridge, f"m_axil_{name}valid"))
        ctx.set(ready, 0)
        return list(found)

    async def answer(ctx: Any, name: str) -> None:
        await ctx.tick().repeat(rng.randrange(1, 4))
        ctx.set(getattr(bridge, f"m_axil_{name}valid"), 1)
        await ctx.tick().until(getattr(bridge, f"m_axil_{name}ready"))
        ctx.set(getattr(bridge, f"m_axil_{name}valid"), 0)

    async def slave(ctx: Any) -> None:
        for write, *_ in accesses:
            if write:
                first = rng.randrange(2)
                parts = {}
                for name in (("aw", "w"), ("w", "aw"))[first]:
                    parts[name] = await channel(ctx, name, *(("addr",) if name == "aw" else ("data", "strb")))
                assert parts["w"][1] == 15
                registers[parts["aw"][0]] = parts["w"][0]
                await answer(ctx, "b")
            else:
                address, = await channel(ctx, "ar", "addr")
                ctx.set(bridge.m_axil_rdata, registers.get(address, 0))
                await answer(ctx, "r")

    simulate(bridge, processor, slave)


class Traffic:
    """Random beats and words on a bridge, its memory, and what that memory must hold at the end."""

    def __init__(self, seed: int):
        self.bridge, self.rng = MemoryBridge(ID_BITS), random.Random(seed)
        self.memory, self.wanted = [self.rng.getrandbits(32) for _ in range(SPACE)], []
        self.wanted = list(self.memory)
        self.done = {"words": False, "beats": False}

    def _mask(self, strobe: int) -> int:
        return sum(0xFF << 8 * lane for lane in range(4) if strobe >> lane & 1)

    def put(self, memory: list[int], word: int, value: int, strobe: int) -> None:
        mask = self._mask(strobe)
        memory[word] = memory[word] & ~mask | value & mask

    async def pause(self, ctx: Any) -> None:
        if self.rng.random() < 0.5:
            await ctx.tick().repeat(self.rng.randrange(1, 6))

    async def store(self, ctx: Any) -> None:
        """The memory: answers after up to four cycles."""
        b = self.bridge
        while True:
            await ctx.tick()
            if not ctx.get(b.memory_valid):
                continue
            await ctx.tick().repeat(self.rng.randrange(1, 4))
            assert ctx.get(b.memory_valid)
            word, strobe = ctx.get(b.memory_address), ctx.get(b.memory_write)
            if strobe:
                self.put(self.memory, word, ctx.get(b.memory_write_data), strobe)
            ctx.set(b.memory_read_data, self.memory[word])
            ctx.set(b.memory_ready, 1)
            await ctx.tick()
            ctx.set(b.memory_ready, 0)

    async def words(self, ctx: Any) -> None:
        """The processor, in the lower half."""
        b = self.bridge
        for _ in range(60):
            word, value, strobe = self.rng.randrange(SPACE // 2), self.rng.getrandbits(32), self.rng.choice((0, 0, 15, 4, 3))
            ctx.set(b.processor_address, word)
            ctx.set(b.processor_write, strobe)
            ctx.set(b.processor_write_data, value)
            ctx.set(b.processor_valid, 1)
            read, = await ctx.tick().sample(b.processor_read_data).until(b.processor_ready)
            ctx.set(b.processor_valid, 0)
            if strobe:
                self.put(self.wanted, word, value, strobe)
            else:
                assert read == self.wanted[word]
            await self.pause(ctx)
        self.done["words"] = True

    async def beats(self, ctx: Any) -> None:
        """The machine, in the upper half: beats of which words, or all, may be left out."""
        b = self.bridge
        for _ in range(40):
            beat, identity = self.rng.randrange(SPACE // 2 // WORDS, SPACE // WORDS), self.rng.randrange(1 << ID_BITS)
            if self.rng.random() < 0.5:
                ctx.set(b.s_axi_araddr, 32 * beat)
                ctx.set(b.s_axi_arid, identity)
                ctx.set(b.s_axi_arvalid, 1)
                await ctx.tick().until(b.s_axi_arready)
                ctx.set(b.s_axi_arvalid, 0)
                await self.pause(ctx)
                ctx.set(b.s_axi_rready, 1)
                data, said, last = await ctx.tick().sample(b.s_axi_rdata, b.s_axi_rid, b.s_axi_rlast).until(b.s_axi_rvalid)
                ctx.set(b.s_axi_rready, 0)
                held = self.wanted[WORDS * beat : WORDS * (beat + 1)]
                assert (said, last, data) == (identity, 1, sum(word << 32 * place for place, word in enumerate(held)))
            else:
                data, keep = self.rng.getrandbits(256), self.rng.choice((255, 0, self.rng.getrandbits(8)))
                ctx.set(b.s_axi_awaddr, 32 * beat)
                ctx.set(b.s_axi_awid, identity)
                ctx.set(b.s_axi_wdata, data)
                ctx.set(b.s_axi_wstrb, sum(15 << 4 * place for place in range(WORDS) if keep >> place & 1))
                ctx.set(b.s_axi_awvalid, 1)
                await self.pause(ctx)
                ctx.set(b.s_axi_wvalid, 1)
                await ctx.tick().until(b.s_axi_awready & b.s_axi_wready)
                ctx.set(b.s_axi_awvalid, 0)
                ctx.set(b.s_axi_wvalid, 0)
                ctx.set(b.s_axi_bready, 1)
                said, = await ctx.tick().sample(b.s_axi_bid).until(b.s_axi_bvalid)
                ctx.set(b.s_axi_bready, 0)
                assert said == identity
                for place in range(WORDS):
                    if keep >> place & 1:
                        self.put(self.wanted, WORDS * beat + place, data >> 32 * place & 0xFFFFFFFF, 15)
            await self.pause(ctx)
        self.done["beats"] = True

    async def until_done(self, ctx: Any) -> None:
        for _ in range(20000):
            if all(self.done.values()):
                return
            await ctx.tick()
        raise AssertionError(f"somebody waits for ever: {self.done}")


@pytest.mark.parametrize("seed", [1, 2])
def test_beats_and_words_take_turns_on_one_memory(seed: int) -> None:
    traffic = Traffic(seed)
    simulate(traffic.bridge, traffic.until_done, traffic.store, traffic.words, traffic.beats)
    assert traffic.memory == traffic.wanted


def test_a_firmware_that_is_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match=rf"^firmware must have at most {FIRMWARE_WORDS} words, not {FIRMWARE_WORDS + 1}$"):
        System(FPGA, [0] * (FIRMWARE_WORDS + 1), 434)
