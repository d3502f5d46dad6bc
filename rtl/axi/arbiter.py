"""A round-robin arbiter."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out


class RoundRobin(wiring.Component):
    """Chooses the first client that asks, counted from the one that was served last. So a client waits for at most one turn of
    each other client.

    Parameters:
        count: number of clients.

    Ports:
        asking: one bit per client.
        served: the chosen client is served in this cycle.
        chosen: number of the client to serve; combinational, and undefined unless a client asks.
    """

    def __init__(self, count: int):
        if not isinstance(count, int) or isinstance(count, bool):
            raise TypeError(f"count must be an integer, not {count!r}")
        if count < 1:
            raise ValueError(f"count must be at least 1, not {count!r}")
        self.count = count
        super().__init__({"asking": In(count), "served": In(1), "chosen": Out(range(max(2, count)))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        last = Signal(self.chosen.shape())
        m.d.comb += self.chosen.eq(last)
        with m.Switch(last):
            for i in range(self.count):
                with m.Case(i):
                    for k in range(self.count, 0, -1):  # the nearest client comes last, because the last assignment wins
                        following = (i + k) % self.count
                        with m.If(self.asking[following]):
                            m.d.comb += self.chosen.eq(following)
        with m.If(self.served):
            m.d.sync += last.eq(self.chosen)
        return m


def selected(m: Module, name: str, ports: list[stream.Interface], chosen: Signal) -> Signal:
    """The payload of the chosen port."""
    payload = Signal(ports[0].payload.shape(), name=name)
    with m.Switch(chosen):
        for i, port in enumerate(ports):
            with m.Case(i):
                m.d.comb += payload.eq(port.payload)
    return payload
