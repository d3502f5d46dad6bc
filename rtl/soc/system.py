"""The machine in a system that an FPGA holds: a RISC-V core runs a driver in C from block RAM.

    firmware RAM ◄──┐                    ┌──► registers ─ AXI4-Lite ─► Machine
                    ├─ processor ─ bus ──┼──► serial line, status            │ AXI4
                                         └──► MemoryBridge ◄─────────────────┘
                                                   └──► memory_* : the port to main memory, one word at a time

The processor's addresses begin with 0 in the firmware RAM, with 1 in the machine's registers, with 2 in the system's own
registers, and with 4 in main memory, which the machine sees from address 0 on.

| address | register | |
|---|---|---|
| 0x20000000 | serial | write: a byte to send; read: 1 while one is under way |
| 0x20000004 | status | write: the port `status` |
"""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import ClockSignal, Instance, Module, Mux, ResetSignal, Signal
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import Out

from rtl.axi import bus
from rtl.soc.memory_bridge import MemoryBridge, word_port
from rtl.soc.register_bridge import RegisterBridge
from rtl.soc.serial import Sender
from rtl.top.machine import Machine
from spec.config import AcceleratorConfig

FIRMWARE_WORDS = 4096
"""Words of the firmware RAM: program, data and stack."""

STATUS_BITS = 8

_FIRMWARE, _REGISTERS, _OWN, _MAIN = 0, 1, 2, 4
"""What an address of the processor begins with."""


class System(wiring.Component):
    """The machine, a processor and what connects them.

    Parameters:
        config: the machine.
        firmware: words of the program, which is in the RAM from the start.
        divisor: cycles of a bit on the serial line.

    Ports:
        serial: the serial line.
        status: what the firmware has written there; 0 at the start.
        interrupt: that of the machine; the firmware polls its register.
        trapped: the processor has met an instruction that it does not know.
        memory_*: the port to main memory (`rtl.soc.memory_bridge.word_port`).
    """

    def __init__(self, config: AcceleratorConfig, firmware: Sequence[int], divisor: int):
        if len(firmware) > FIRMWARE_WORDS:
            raise ValueError(f"firmware must have at most {FIRMWARE_WORDS} words, not {len(firmware)!r}")
        self._machine, self._firmware, self._sender = Machine(config), firmware, Sender(divisor)
        super().__init__({
            "serial": Out(1), "status": Out(STATUS_BITS), "interrupt": Out(1), "trapped": Out(1),
            **{f"memory_{name}": member for name, member in word_port().items()}})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.machine = machine = self._machine
        m.submodules.memory = memory = MemoryBridge(len(machine.m_axi_arid))
        m.submodules.registers = registers = RegisterBridge()
        m.submodules.sender = sender = self._sender
        m.d.comb += [self.interrupt.eq(machine.interrupt), self.serial.eq(sender.line)]
        bus.join(m, self, memory, "memory")
        for left, right, prefix, other in ((machine, memory, "m_axi", "s_axi"), (registers, machine, "m_axil", "s_axil")):
            for name, member in left.signature.members.items():
                if name.startswith(f"{prefix}_"):
                    here, there = getattr(left, name), getattr(right, other + name.removeprefix(prefix))
                    m.d.comb += there.eq(here) if member.flow is Out else here.eq(there)

        valid, ready, address, data, write, answer = (
            Signal(), Signal(), Signal(32), Signal(32), Signal(4), Signal(32))
        m.submodules.processor = Instance(
            "picorv32", p_ENABLE_COUNTERS64=0, p_CATCH_MISALIGN=0, p_STACKADDR=4 * FIRMWARE_WORDS, i_clk=ClockSignal(),
            i_resetn=~ResetSignal(), o_trap=self.trapped, o_mem_valid=valid, i_mem_ready=ready, o_mem_addr=address,
            o_mem_wdata=data, o_mem_wstrb=write, i_mem_rdata=answer, i_irq=0, i_pcpi_wr=0, i_pcpi_rd=0, i_pcpi_wait=0,
            i_pcpi_ready=0)
        place = address[28:]
        chosen = {number: Signal(name=f"chosen{number}") for number in (_FIRMWARE, _REGISTERS, _OWN, _MAIN)}
        m.d.comb += [strobe.eq(valid & (place == number)) for number, strobe in chosen.items()]
        for port, strobe in ((registers, chosen[_REGISTERS]),):
            m.d.comb += [
                port.valid.eq(strobe), port.write.eq(write), port.address.eq(address[2:]), port.write_data.eq(data)]
        m.d.comb += [
            memory.processor_valid.eq(chosen[_MAIN]), memory.processor_write.eq(write),
            memory.processor_address.eq(address[2:28]), memory.processor_write_data.eq(data)]

        m.submodules.ram = ram = Memory(shape=32, depth=FIRMWARE_WORDS, init=self._firmware)
        read, written = ram.read_port(), ram.write_port(granularity=8)
        fetched = Signal()
        m.d.comb += [
            read.addr.eq(address[2:]), written.addr.eq(address[2:]), written.data.eq(data),
            written.en.eq(Mux(chosen[_FIRMWARE] & fetched, write, 0))]
        m.d.sync += fetched.eq(chosen[_FIRMWARE] & ~fetched)

        own = chosen[_OWN] & write.any() & ~(sender.busy & ~address[2])  # a byte waits until the line is free
        m.d.comb += [sender.valid.eq(own & ~address[2]), sender.byte.eq(data[:8])]
        with m.If(own & address[2]):
            m.d.sync += self.status.eq(data[:STATUS_BITS])
        m.d.comb += [
            ready.eq(fetched | registers.ready | memory.processor_ready | own | (chosen[_OWN] & ~write.any())),
            answer.eq(Mux(chosen[_FIRMWARE], read.data, Mux(
                chosen[_REGISTERS], registers.read_data, Mux(chosen[_MAIN], memory.processor_read_data, sender.busy))))]
        return m
