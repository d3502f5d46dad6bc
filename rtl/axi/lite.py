"""An AXI4-Lite slave that turns bus transactions into accesses of single registers."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.axi import bus
from spec.registers import REGISTER_ADDRESS_BITS

INDEX_BITS = REGISTER_ADDRESS_BITS - 2
"""Bits of a register's index, which counts words of 32 bits."""


class LiteSlave(wiring.Component):
    """An AXI4-Lite slave with one outstanding access in each direction. Address and data of a write may come in any order.

    Ports:
        s_axi_*: the bus.
        write: strobe: a register is written. `write_index` is its index, `write_data` the word, `write_bytes` has one bit per
            byte that is written. In the same cycle `write_refused` must say whether the write is answered with SLVERR.
        read: strobe: the register `read_index` is read. In the same cycle `read_data` must have its value, and `read_refused`
            must say whether the read is answered with SLVERR.

    All outputs on the bus come from registers. Latency: two cycles from the last of AW and W to B, two from AR to R.
    Throughput: one access every three cycles in each direction::

        cycle       0    1    2    3    4
        ARVALID   ~~~~~______~~~~~______
        ARREADY   ~~~~~______~~~~~______
        read      _____~~~~~______~~~~~_
        RVALID    __________~~~~~______~   RREADY high
    """

    def __init__(self) -> None:
        super().__init__({
            **bus.axi_lite_slave_ports("s_axi"),
            "write": Out(1), "write_index": Out(INDEX_BITS), "write_data": Out(32), "write_bytes": Out(4),
            "write_refused": In(1),
            "read": Out(1), "read_index": Out(INDEX_BITS), "read_data": In(32), "read_refused": In(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        address, words, asked = Signal(), Signal(), Signal()
        m.d.comb += [
            self.s_axi_awready.eq(~address), self.s_axi_wready.eq(~words), self.s_axi_arready.eq(~asked),
            self.write.eq(address & words & ~self.s_axi_bvalid), self.read.eq(asked & ~self.s_axi_rvalid),
        ]
        for held, valid in ((address, self.s_axi_awvalid), (words, self.s_axi_wvalid)):
            m.d.sync += held.eq(Mux(held, ~self.write, valid))
        m.d.sync += asked.eq(Mux(asked, ~self.read, self.s_axi_arvalid))
        with m.If(~address):
            m.d.sync += self.write_index.eq(self.s_axi_awaddr[2:])
        with m.If(~words):
            m.d.sync += [self.write_data.eq(self.s_axi_wdata), self.write_bytes.eq(self.s_axi_wstrb)]
        with m.If(~asked):
            m.d.sync += self.read_index.eq(self.s_axi_araddr[2:])

        with m.If(self.write):
            m.d.sync += [self.s_axi_bvalid.eq(1), self.s_axi_bresp.eq(_response(self.write_refused))]
        with m.Elif(self.s_axi_bready):
            m.d.sync += self.s_axi_bvalid.eq(0)
        with m.If(self.read):
            m.d.sync += [
                self.s_axi_rvalid.eq(1), self.s_axi_rresp.eq(_response(self.read_refused)), self.s_axi_rdata.eq(self.read_data)]
        with m.Elif(self.s_axi_rready):
            m.d.sync += self.s_axi_rvalid.eq(0)
        return m


def _response(refused: Signal) -> Value:
    return Mux(refused, bus.Response.SLVERR, bus.Response.OKAY)
