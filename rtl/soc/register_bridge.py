"""A processor's accesses to the machine's registers, as AXI4-Lite transactions."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.axi import bus
from spec.registers import REGISTER_ADDRESS_BITS


class RegisterBridge(wiring.Component):
    """A slave of words and a master of AXI4-Lite.

    Ports:
        valid, write, address, write_data, ready, read_data: a slave of words (`rtl.soc.memory_bridge.word_port`) whose address
            is that of a register in words. Every write must be of all four bytes.
        m_axil_*: AXI4-Lite master. An error in the answer is not passed on: the word that is read is then 0.

    Throughput: one access at a time, which takes as long as the slave takes.
    """

    def __init__(self) -> None:
        slave = bus.axi_lite_slave_ports("m_axil")
        super().__init__({
            "valid": In(1), "write": In(4), "address": In(REGISTER_ADDRESS_BITS - 2), "write_data": In(32), "ready": Out(1),
            "read_data": Out(32), **{name: member.flip() for name, member in slave.items()}})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        address = Cat(Const(0, 2), self.address)
        asked, given = Signal(), Signal()  # the address, and the word to write, have been taken
        writes = self.write.any()
        m.d.comb += [
            self.m_axil_araddr.eq(address), self.m_axil_awaddr.eq(address), self.m_axil_wdata.eq(self.write_data),
            self.m_axil_wstrb.eq(self.write), self.m_axil_rready.eq(1), self.m_axil_bready.eq(1),
            self.m_axil_arvalid.eq(self.valid & ~writes & ~asked), self.m_axil_awvalid.eq(self.valid & writes & ~asked),
            self.m_axil_wvalid.eq(self.valid & writes & ~given), self.read_data.eq(self.m_axil_rdata),
            self.ready.eq(self.m_axil_rvalid | self.m_axil_bvalid)]
        with m.If(self.ready):
            m.d.sync += [asked.eq(0), given.eq(0)]
        with m.Else():
            with m.If((self.m_axil_arvalid & self.m_axil_arready) | (self.m_axil_awvalid & self.m_axil_awready)):
                m.d.sync += asked.eq(1)
            with m.If(self.m_axil_wvalid & self.m_axil_wready):
                m.d.sync += given.eq(1)
        return m
