"""The queue before a unit's read port. It passes a request on only if there is free space for its answer."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import read_data, read_request


class ReadQueue(wiring.Component):
    """A queue between a unit, which may let its beats wait, and a bus, which must not wait.

    Every request that is passed on takes a credit, and every beat that the unit takes returns one. There are as many credits as
    the queue has places.

    Parameters:
        config: the machine.
        depth: number of beats that fit, and so of requests that may be outstanding; 3 or more. A depth of L + 5 allows one beat
            per cycle from a memory that answers the AXI master after L cycles.

    Ports:
        reads: the unit's requests.
        data: the beats in the order of the requests, held until the unit takes them.
        requests: the requests that have free space for their answers; each is held until it is taken.
        beats: the answers, in order; `ready` is always high.

    Storage: `depth` beats in memory and registers. Throughput: one request and one beat per cycle. Latency: none for requests
    (valid and ready pass through, gated by the credits), two cycles for beats::

        cycle        0    1    2    3    4
        beats      < A >< B >
        data                 < A >< B >< B >
        data.ready ~~~~~~~~~~~~~~~______~~~~~
    """

    def __init__(self, config: AcceleratorConfig, depth: int):
        if not isinstance(depth, int) or isinstance(depth, bool):
            raise TypeError(f"depth must be an integer, not {depth!r}")
        if depth < 3:  # the queue's last place is its output register, which a beat reaches a cycle later
            raise ValueError(f"depth must be at least 3, not {depth!r}")
        self.depth, self._record = depth, read_data(config)
        request, beat = layout(read_request(config)), layout(self._record)
        super().__init__({
            "reads": In(stream.Signature(request)), "data": Out(stream.Signature(beat)),
            "requests": Out(stream.Signature(request)), "beats": In(stream.Signature(beat)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.queue = queue = SyncFIFOBuffered(width=self._record.width, depth=self.depth)
        credits = Signal(range(self.depth + 1), init=self.depth)
        passed, returned = self.requests.valid & self.requests.ready, self.data.valid & self.data.ready
        m.d.comb += [
            self.requests.payload.eq(self.reads.payload),
            self.requests.valid.eq(self.reads.valid & credits.any()),
            self.reads.ready.eq(self.requests.ready & credits.any()),
            queue.w_data.eq(self.beats.payload), queue.w_en.eq(self.beats.valid), self.beats.ready.eq(1),
            self.data.payload.eq(queue.r_data), self.data.valid.eq(queue.r_rdy), queue.r_en.eq(self.data.ready),
        ]
        m.d.sync += credits.eq(credits - passed + returned)
        return m
