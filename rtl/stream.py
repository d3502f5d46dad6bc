"""Stream helpers."""

from __future__ import annotations

from amaranth.hdl import Module, ShapeLike, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out


class Buffer(wiring.Component):
    """Two registers of storage that cut both directions of a stream.

    `sink.ready` and `source.valid` come from flip-flops. Throughput one transfer a cycle, latency one cycle. The second
    register takes the word that is on its way when the consumer stops::

        cycle            0      1      2      3      4
        sink         <  A  ><  B  ><  C  ><  C  ><  D  >
        sink.ready   ~~~~~~~~~~~~~~_______~~~~~~~~~~~~~~
        source              <  A  ><  A  ><  B  ><  C  >
        source.ready        _______~~~~~~~~~~~~~~~~~~~~~

    Parameters:
        shape: shape of the payload.
    """

    def __init__(self, shape: ShapeLike):
        super().__init__({"sink": In(stream.Signature(shape)), "source": Out(stream.Signature(shape))})

    def elaborate(self, platform) -> Module:
        m = Module()
        sink, source = self.sink, self.source
        spare, spare_valid = Signal.like(sink.payload, reset_less=True), Signal()
        m.d.comb += sink.ready.eq(~spare_valid)
        with m.If(source.ready | ~source.valid):
            m.d.sync += [source.valid.eq(sink.valid | spare_valid), spare_valid.eq(0)]
            with m.If(spare_valid):
                m.d.sync += source.payload.eq(spare)
            with m.Elif(sink.valid):
                m.d.sync += source.payload.eq(sink.payload)
        with m.Elif(sink.valid & ~spare_valid):
            m.d.sync += [spare.eq(sink.payload), spare_valid.eq(1)]
        return m
