"""Components that buffer a stream or send it to several consumers."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, ShapeLike, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out


def _check_count(count: int) -> None:
    """Raises TypeError or ValueError unless `count` is a number of consumers."""
    if not isinstance(count, int) or isinstance(count, bool):
        raise TypeError(f"count must be an integer, not {count!r}")
    if count < 1:
        raise ValueError(f"count must be 1 or more, not {count!r}")


def payload_register(m: Module, source: wiring.PureInterface) -> Signal | data.View:
    """The register behind the payload of a stream. It has no reset, because a payload means nothing while `valid` is low, and
    synthesis gates only the clocks of registers without one. Every bit must be assigned before `valid` rises: one that never is
    holds what power-up left in it. To be called outside of `m.If`, because it drives the payload."""
    held = Signal.like(source.payload, name="held_payload", reset_less=True)
    m.d.comb += source.payload.eq(held)
    return held


class Buffer(wiring.Component):
    """Two registers that cut the combinational paths of a stream in both directions.

    `sink.ready` and `source.valid` come from flip-flops. Throughput: one transfer per cycle. Latency: one cycle. The second
    register takes the word that the producer transfers in the cycle in which the consumer stops::

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

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sink, source = self.sink, self.source
        spare, spare_valid, held = Signal.like(sink.payload, reset_less=True), Signal(), payload_register(m, source)
        m.d.comb += sink.ready.eq(~spare_valid)
        with m.If(source.ready | ~source.valid):
            m.d.sync += [source.valid.eq(sink.valid | spare_valid), spare_valid.eq(0)]
            with m.If(spare_valid):
                m.d.sync += held.eq(spare)
            with m.Elif(sink.valid):
                m.d.sync += held.eq(sink.payload)
        with m.Elif(sink.valid & ~spare_valid):
            m.d.sync += [spare.eq(sink.payload), spare_valid.eq(1)]
        return m


class Skid(wiring.Component):
    """A register that cuts the combinational path of a stream's `ready`, and costs no cycle.

    `sink.ready` comes from a flip-flop; `source` is the sink as long as nothing is held. The register takes the word that the
    producer transfers in the cycle in which the consumer stops. Throughput: one transfer per cycle. Latency: none. Where
    `valid` is late as well, a `Buffer` cuts both::

        cycle            0      1      2      3      4
        sink         <  A  ><  B  ><  C  ><  C  ><  D  >
        sink.ready   ~~~~~~~~~~~~~~_______~~~~~~~~~~~~~~
        source       <  A  ><  B  ><  B  ><  C  ><  D  >
        source.ready ~~~~~~~_______~~~~~~~~~~~~~~~~~~~~~

    Parameters:
        shape: shape of the payload.
    """

    def __init__(self, shape: ShapeLike):
        super().__init__({"sink": In(stream.Signature(shape)), "source": Out(stream.Signature(shape))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sink, source = self.sink, self.source
        spare, held = Signal.like(sink.payload, reset_less=True), Signal()
        m.d.comb += [
            sink.ready.eq(~held), source.valid.eq(sink.valid | held), source.payload.eq(Mux(held, spare, sink.payload))]
        with m.If(source.ready):
            m.d.sync += held.eq(0)
        with m.Elif(sink.valid & ~held):
            m.d.sync += [spare.eq(sink.payload), held.eq(1)]
        return m


class Fork(wiring.Component):
    """Sends every item to each of several consumers, which take it at their own pace.

    Each consumer has a `Buffer`, so one may be two items ahead of another. All outputs come from flip-flops, except
    `sink.ready`, which is high when every buffer has free space. Throughput: one transfer per cycle. Latency: one cycle.

    Parameters:
        shape: shape of the payload.
        count: number of consumers, 1 or more.
    """

    def __init__(self, shape: ShapeLike, count: int = 2):
        _check_count(count)
        items = stream.Signature(shape)
        super().__init__({"sink": In(items), "sources": Out(items).array(count)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        buffers = [Buffer(self.sink.payload.shape()) for _ in self.sources]
        m.d.comb += self.sink.ready.eq(Cat(buffer.sink.ready for buffer in buffers).all())
        for number, (buffer, source) in enumerate(zip(buffers, self.sources, strict=True)):
            m.submodules[f"buffer_{number}"] = buffer
            m.d.comb += [buffer.sink.payload.eq(self.sink.payload), buffer.sink.valid.eq(self.sink.valid & self.sink.ready)]
            wiring.connect(m, buffer.source, wiring.flipped(source))
        return m


class Broadcast(wiring.Component):
    """Sends every item to each of several consumers without storing it: an item stays at the input until the last consumer has
    taken it.

    Throughput: one transfer per cycle. Latency: none. The `valid` of an output does not depend on any `ready`; `sink.ready`
    depends on the `ready` of all outputs.

    Parameters:
        shape: shape of the payload.
        count: number of consumers, 1 or more.

    Ports:
        sink, sources: the streams.
        wanted: one bit per consumer: whether it gets the items. It changes only while no item is offered.
    """

    def __init__(self, shape: ShapeLike, count: int = 2):
        _check_count(count)
        items = stream.Signature(shape)
        super().__init__({"sink": In(items), "sources": Out(items).array(count), "wanted": In(count)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        done, takes = Signal.like(self.wanted), Signal.like(self.wanted)
        m.d.comb += self.sink.ready.eq((done | takes | ~self.wanted).all())
        for number, source in enumerate(self.sources):
            m.d.comb += [
                source.payload.eq(self.sink.payload),
                source.valid.eq(self.sink.valid & self.wanted[number] & ~done[number]),
                takes[number].eq(source.ready & self.wanted[number])]
        with m.If(self.sink.valid):
            m.d.sync += done.eq(Mux(self.sink.ready, 0, done | takes))
        return m
