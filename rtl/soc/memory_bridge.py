"""Two masters on one memory of 32-bit words: the machine's AXI4 port, and a processor.

The machine moves single beats of 32 bytes. A beat becomes eight accesses of a word, one after the other. Beats and the
processor's accesses take turns, so that neither waits for more than one of the other.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Member, Out

from rtl.axi import bus
from spec.memory import ADDRESS_BITS, BEAT_BYTES

WORDS = BEAT_BYTES // 4


def word_port() -> dict[str, Member]:
    """Members of a master of a memory of words. An access is valid until the cycle in which `ready` is high; a word that is
    read is on `read_data` in that cycle."""
    return {
        "valid": Out(1), "write": Out(4), "address": Out(ADDRESS_BITS - 2), "write_data": Out(32), "ready": In(1),
        "read_data": In(32)}


class MemoryBridge(wiring.Component):
    """An AXI4 slave of single beats and a slave of words, on a memory of words.

    Parameters:
        id_bits: width of the AXI IDs.

    Ports:
        s_axi_*: AXI4 slave, 256 bits; every transaction must be a single aligned beat.
        processor_*: slave of words, see `word_port`; `write` has a bit for each byte that is written, 0 for a read.
        memory_*: master of words.

    Throughput: a beat takes three cycles and eight accesses; words of which no byte is written take a cycle and no access.
    Order: transactions are answered one at a time, in the order in which they are taken.
    """

    def __init__(self, id_bits: int):
        master, words = bus.axi_master_ports("s_axi", id_bits), word_port()
        super().__init__({
            **{name: member.flip() for name, member in master.items()},
            **{f"processor_{name}": member.flip() for name, member in words.items()},
            **{f"memory_{name}": member for name, member in words.items()},
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        writing, number, processor_was = Signal(), Signal(range(WORDS)), Signal()
        identity, beat = Signal.like(self.s_axi_arid), Signal(ADDRESS_BITS - 5)
        data, strobe = Signal(8 * BEAT_BYTES), Signal(BEAT_BYTES)
        m.d.comb += [
            self.s_axi_rid.eq(identity), self.s_axi_bid.eq(identity), self.s_axi_rdata.eq(data), self.s_axi_rlast.eq(1),
            self.processor_read_data.eq(self.memory_read_data)]
        with m.FSM():
            with m.State("idle"):
                asked = self.s_axi_arvalid | (self.s_axi_awvalid & self.s_axi_wvalid)
                with m.If(self.processor_valid & ~(processor_was & asked)):
                    m.next = "processor"
                with m.Elif(self.s_axi_arvalid):
                    m.d.comb += self.s_axi_arready.eq(1)
                    m.d.sync += [identity.eq(self.s_axi_arid), beat.eq(self.s_axi_araddr[5:]), writing.eq(0), number.eq(0)]
                    m.next = "beat"
                with m.Elif(self.s_axi_awvalid & self.s_axi_wvalid):
                    m.d.comb += [self.s_axi_awready.eq(1), self.s_axi_wready.eq(1)]
                    m.d.sync += [
                        identity.eq(self.s_axi_awid), beat.eq(self.s_axi_awaddr[5:]), writing.eq(1), number.eq(0),
                        data.eq(self.s_axi_wdata), strobe.eq(self.s_axi_wstrb)]
                    m.next = "beat"
            with m.State("processor"):
                m.d.sync += processor_was.eq(1)
                m.d.comb += [
                    self.memory_valid.eq(self.processor_valid), self.memory_write.eq(self.processor_write),
                    self.memory_address.eq(self.processor_address), self.memory_write_data.eq(self.processor_write_data),
                    self.processor_ready.eq(self.memory_ready)]
                with m.If(self.memory_ready):
                    m.next = "idle"
            with m.State("beat"):
                skipped = writing & ~strobe[:4].any()
                m.d.sync += processor_was.eq(0)
                m.d.comb += [
                    self.memory_valid.eq(~skipped), self.memory_write.eq(strobe[:4] & writing.replicate(4)),
                    self.memory_address.eq(Cat(number, beat)), self.memory_write_data.eq(data[:32])]
                with m.If(skipped | self.memory_ready):
                    m.d.sync += [number.eq(number + 1), data.eq(Cat(data[32:], self.memory_read_data)), strobe.eq(strobe[4:])]
                    with m.If(number == WORDS - 1):
                        m.next = "answer"
            with m.State("answer"):
                m.d.comb += [self.s_axi_rvalid.eq(~writing), self.s_axi_bvalid.eq(writing)]
                with m.If((self.s_axi_rvalid & self.s_axi_rready) | (self.s_axi_bvalid & self.s_axi_bready)):
                    m.next = "idle"
        return m
