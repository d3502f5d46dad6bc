"""The AXI4 master, which joins the memory ports of all units to one bus. Every transaction is a single beat."""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.axi import bus
from rtl.axi.arbiter import RoundRobin, selected
from rtl.shapes import layout
from rtl.stream import Buffer, Skid
from spec.config import AcceleratorConfig
from spec.memory import ADDRESS_BITS, BEAT_BITS, BEAT_BYTES, WORDS, read_data, read_request, write_request
from spec.queues import IN_FLIGHT


def id_bits(readers: int, writers: int) -> int:
    """Number of bits of the transaction IDs."""
    return max(1, (max(readers, writers) - 1).bit_length())


class AxiMaster(wiring.Component):
    """Read and write clients on an AXI4 master. The position of a client is the ID of its transactions.

    Clients are served round-robin. Reads of one client are answered in order, those of different clients in any order; the same
    holds for writes. The channels AW and W transfer independently, but in the same order. Every VALID and its payload come from
    registers and stay until they are taken. Answers on R and B are always taken at once. The `ready` of every client comes from
    a register of its own, so no client waits for the arbiter's choice in the same cycle.

    To cancel the clients' requests, raise `abort`, wait for `quiet`, reset the clients and their read queues, and lower
    `abort`. Requests that have been taken are completed on the bus, but their answers are dropped.

    Parameters:
        config: the machine.
        readers, writers: number of clients of each kind, 1..16.
        in_flight: most reads of all clients together, and most writes of each client, that may be issued and wait for answers;
            further requests wait. A power of two.

    Ports:
        reads: a stream of requests for each reader.
        beats: a stream of answers for each reader. `ready` is ignored: a client must have free space for the beats that it
            requests (`ReadQueue`). The error bit is set where the bus answers SLVERR or DECERR.
        writes: a stream of requests for each writer.
        writes_idle: one bit per writer: all writes that were taken from it have been answered. It is low from the cycle after
            a write was taken.
        read_errors, write_errors: one bit per client: an answer was an error; it stays until `clear_errors` or reset.
        clear_errors: strobe.
        read_beats, write_beats: one bit per client, strobes for counters: a beat arrived; a write left on AW. At most one bit
            of each in a cycle.
        abort: level: no request is taken, and answers are dropped.
        quiet: no request that was taken is outstanding.
        m_axi_*: the bus: 256 bits of data, INCR bursts of one beat, `bus.CACHE_NORMAL`.

    Storage: two requests per channel, a read for each reader, two writes for each writer, one answer, counters. Latency: one
    cycle from a read to AR, two from a write to AW and W, one from R to `beats`, one from B to `writes_idle`. Throughput: one
    read and one write per cycle.
    """

    def __init__(self, config: AcceleratorConfig, readers: int, writers: int, in_flight: int = IN_FLIGHT):
        for name, value, high in (("readers", readers, 16), ("writers", writers, 16), ("in_flight", in_flight, 1 << 16)):
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{name} must be an integer, not {value!r}")
            if not 1 <= value <= high:
                raise ValueError(f"{name} must be in 1..{high}, not {value!r}")
        if in_flight & (in_flight - 1):
            raise ValueError(f"in_flight must be a power of two, not {in_flight!r}")
        self.in_flight, self.id_bits = in_flight, id_bits(readers, writers)
        beats = stream.Signature(layout(read_data(config)))
        super().__init__({
            "reads": In(stream.Signature(layout(read_request(config)))).array(readers),
            "beats": Out(beats).array(readers),
            "writes": In(stream.Signature(layout(write_request(config)))).array(writers),
            "writes_idle": Out(writers), "read_errors": Out(readers), "write_errors": Out(writers), "clear_errors": In(1),
            "read_beats": Out(readers), "write_beats": Out(writers), "abort": In(1), "quiet": Out(1),
            **bus.axi_master_ports("m_axi", self.id_bits),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        reading = self._read(m)
        writing = self._write(m)
        m.d.comb += self.quiet.eq(~reading & ~writing)
        return m

    def _read(self, m: Module) -> Signal:
        """The read channels; returns whether any read that was taken is outstanding.

        A count never exceeds `in_flight`, which is a power of two, so its top bit alone says that no further transaction may
        start. A comparison of all its bits would make the arbiter's choice late, and tools for FPGAs would then copy the
        arbiter into every bit of the selected payload, with four times as many LUTs.
        """
        request = data.StructLayout({"id": self.id_bits, "beat": BEAT_BITS})
        m.submodules.read_turn = turn = RoundRobin(len(self.reads))
        m.submodules.ar = ar = Buffer(request)
        count = Signal(range(self.in_flight + 1))
        clients, free = self._clients(m, "read", Skid, self.reads)
        chosen = selected(m, "read", clients, turn.chosen)
        asking, open_ = Cat(port.valid for port in clients), Signal()
        m.d.comb += [
            open_.eq(~count[-1]),
            turn.asking.eq(asking), turn.served.eq(ar.sink.valid & ar.sink.ready),
            ar.sink.valid.eq(asking.any() & open_), ar.sink.payload.id.eq(turn.chosen), ar.sink.payload.beat.eq(chosen.beat),
            *(port.ready.eq(open_ & ar.sink.ready & (turn.chosen == i)) for i, port in enumerate(clients)),
        ]
        self._address(m, "ar", ar.source)

        arrived, beat = Signal(), Signal(self.beats[0].payload.shape(), reset_less=True)
        client = Signal(self.id_bits, reset_less=True)
        m.d.comb += self.m_axi_rready.eq(1)
        m.d.sync += arrived.eq(self.m_axi_rvalid)
        with m.If(self.m_axi_rvalid):
            m.d.sync += [client.eq(self.m_axi_rid), Cat(beat.word).eq(self.m_axi_rdata), beat.error.eq(self.m_axi_rresp[1])]
        for i, port in enumerate(self.beats):
            mine = arrived & (client == i)
            m.d.comb += [port.payload.eq(beat), port.valid.eq(mine & ~self.abort), self.read_beats[i].eq(mine)]
            self._sticky(m, self.read_errors[i], mine & beat.error)
        m.d.sync += count.eq(count + turn.served - arrived)
        return count.any() | ~free.all()

    def _write(self, m: Module) -> Signal:
        """The write channels; returns whether any write that was taken is outstanding."""
        request = data.StructLayout({"id": self.id_bits, "beat": BEAT_BITS})
        m.submodules.write_turn = turn = RoundRobin(len(self.writes))
        m.submodules.aw = aw = Buffer(request)
        m.submodules.w = w = Buffer(data.StructLayout({"data": 8 * BEAT_BYTES, "strobe": WORDS}))
        counts = [Signal(range(self.in_flight + 1), name=f"writes_{i}") for i in range(len(self.writes))]
        clients, _ = self._clients(m, "write", Buffer, self.writes)
        chosen, both = selected(m, "write", clients, turn.chosen), Signal()
        m.d.comb += [
            both.eq(aw.sink.ready & w.sink.ready),
            *(asks.eq(port.valid & ~count[-1])
              for asks, port, count in zip(turn.asking, clients, counts, strict=True)),
            turn.served.eq(turn.asking.any() & both), aw.sink.valid.eq(turn.served), w.sink.valid.eq(turn.served),
            aw.sink.payload.id.eq(turn.chosen), aw.sink.payload.beat.eq(chosen.beat),
            w.sink.payload.data.eq(Cat(chosen.word)), w.sink.payload.strobe.eq(chosen.strobe),
            self.m_axi_wdata.eq(w.source.payload.data),
            self.m_axi_wstrb.eq(Cat(bit.replicate(BEAT_BYTES // WORDS) for bit in w.source.payload.strobe)),
            self.m_axi_wlast.eq(1), self.m_axi_wvalid.eq(w.source.valid), w.source.ready.eq(self.m_axi_wready),
            self.m_axi_bready.eq(1),
        ]
        self._address(m, "aw", aw.source)
        for i, (port, count) in enumerate(zip(clients, counts, strict=True)):
            mine = self.m_axi_bvalid & (self.m_axi_bid == i)
            m.d.comb += [
                port.ready.eq(both & turn.asking[i] & (turn.chosen == i)),
                self.write_beats[i].eq(self.m_axi_awvalid & self.m_axi_awready & (self.m_axi_awid == i)),
                self.writes_idle[i].eq(~count.any() & ~port.valid)]
            m.d.sync += count.eq(count + (port.valid & port.ready) - mine)
            self._sticky(m, self.write_errors[i], mine & self.m_axi_bresp[1])
        return ~self.writes_idle.all()

    def _clients(
        self, m: Module, name: str, kind: type[Skid] | type[Buffer], ports: Sequence[stream.Interface],
    ) -> tuple[list[stream.Interface], Value]:
        """The clients' requests behind a register for each client, and one bit per client: its register has free space.

        The paths through the clients' queues are long, so the arbiter must not lie on them. Reads need their `ready` cut, and
        writes, whose payload is ten times as wide, their `valid` as well.
        """
        registers = [kind(port.payload.shape()) for port in ports]
        for i, (port, register) in enumerate(zip(ports, registers, strict=True)):
            m.submodules[f"{name}_{i}"] = register
            m.d.comb += [
                register.sink.payload.eq(port.payload), register.sink.valid.eq(port.valid & ~self.abort),
                port.ready.eq(register.sink.ready & ~self.abort)]
        return [register.source for register in registers], Cat(register.sink.ready for register in registers)

    def _address(self, m: Module, channel: str, source: stream.Interface) -> None:
        values = {
            "id": source.payload.id, "addr": source.payload.beat << (ADDRESS_BITS - BEAT_BITS), "len": 0,
            "size": BEAT_BYTES.bit_length() - 1, "burst": bus.BURST_INCR, "cache": bus.CACHE_NORMAL, "prot": 0,
            "valid": source.valid}
        m.d.comb += [getattr(self, f"m_axi_{channel}{name}").eq(value) for name, value in values.items()]
        m.d.comb += source.ready.eq(getattr(self, f"m_axi_{channel}ready"))

    def _sticky(self, m: Module, flag: Signal, error: Signal) -> None:
        with m.If(error):
            m.d.sync += flag.eq(1)
        with m.Elif(self.clear_errors):
            m.d.sync += flag.eq(0)
