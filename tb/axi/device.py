"""The designs under test: the AXI master with a read queue in front of every reader, and the register file."""

from __future__ import annotations

import re
from functools import cache

from amaranth.hdl import Module, ResetInserter
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.axi import bus
from rtl.axi.master import AxiMaster, id_bits
from rtl.axi.read_port import ReadQueue
from rtl.emit import to_verilog
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import read_data, read_request, write_request
from tb.common.emission import emitted
from tb.common.runner import Design

READERS, WRITERS = 5, 3
"""Numbers of reading and writing clients in the test bench. They differ, and neither is a power of two."""

DEPTH = 32
"""Capacity of a read queue in beats."""

IN_FLIGHT = 64
"""Reads that the master may have in flight. This is fewer than the read queues together request."""


class AxiBench(wiring.Component):
    """The AXI master and its read queues in one module.

    Its ports are `read_I`, `data_I` and `write_I` for client number I, and the AXI ports of the bus. `restart` resets the read
    queues. Bit I of `delivered` is high when the queue of reader I receives a beat.
    """

    def __init__(self, config: AcceleratorConfig):
        self._config = config
        requests, beats = stream.Signature(layout(read_request(config))), stream.Signature(layout(read_data(config)))
        writes = stream.Signature(layout(write_request(config)))
        super().__init__({
            **{f"read_{i}": In(requests) for i in range(READERS)}, **{f"data_{i}": Out(beats) for i in range(READERS)},
            **{f"write_{i}": In(writes) for i in range(WRITERS)},
            "abort": In(1), "restart": In(1), "clear_errors": In(1), "quiet": Out(1), "idle": Out(WRITERS),
            "read_errors": Out(READERS), "write_errors": Out(WRITERS),
            "read_beats": Out(READERS), "write_beats": Out(WRITERS), "delivered": Out(READERS),
            **bus.axi_master_ports("m_axi", id_bits(READERS, WRITERS)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.master = master = AxiMaster(self._config, READERS, WRITERS, IN_FLIGHT)
        bus.join(m, self, master, "m_axi")
        for i in range(READERS):
            queue = ReadQueue(self._config, DEPTH)
            m.submodules[f"queue_{i}"] = ResetInserter(self.restart)(queue)
            wiring.connect(m, wiring.flipped(getattr(self, f"read_{i}")), queue.reads)
            wiring.connect(m, queue.data, wiring.flipped(getattr(self, f"data_{i}")))
            wiring.connect(m, queue.requests, master.reads[i])
            wiring.connect(m, master.beats[i], queue.beats)
            m.d.comb += self.delivered[i].eq(queue.beats.valid)
        for i in range(WRITERS):
            wiring.connect(m, wiring.flipped(getattr(self, f"write_{i}")), master.writes[i])
        m.d.comb += [
            master.abort.eq(self.abort), master.clear_errors.eq(self.clear_errors), self.quiet.eq(master.quiet),
            self.idle.eq(master.writes_idle), self.read_errors.eq(master.read_errors),
            self.write_errors.eq(master.write_errors), self.read_beats.eq(master.read_beats),
            self.write_beats.eq(master.write_beats)]
        return m


def _design(name: str, module: str, verilog: str) -> Design:
    """A design in which Python can access every port of the module."""
    listed = re.search(rf"^module {module}\((.*?)\);", verilog, re.DOTALL | re.MULTILINE)
    return Design(name, module, ((f"{module}.v", verilog),), tuple(re.findall(r"\w+", listed[1])))


@cache
def master_design(config: AcceleratorConfig) -> Design:
    """The test bench of the master. `tb.common.emission` does not cache it: its key covers rtl/ and spec/ only, not this
    file."""
    return _design("axi-master", "axi_bench", to_verilog(AxiBench(config), "axi_bench"))


@cache
def register_design(config: AcceleratorConfig) -> Design:
    """The register file of a configuration."""
    name = f"axi-registers{'' if config.counters else '-without-counters'}{'-stereo' if config.stereo else ''}"
    return _design(name, "register_file", emitted("register_file", config))
