"""A delay of some cycles through a memory that is written as a ring, which takes far less area than registers."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, ShapeLike, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out


class Delay(wiring.Component):
    """`late` is the value that `early` had `cycles` cycles ago if `load` was high then; otherwise it is undefined.

    Parameters:
        shape: shape of the values.
        cycles: the delay; 2 or more.

    Storage: one word per cycle of delay. Throughput: one value per cycle, without back-pressure. Latency: `cycles` cycles.
    """

    def __init__(self, shape: ShapeLike, cycles: int):
        if not isinstance(cycles, int) or isinstance(cycles, bool):
            raise TypeError(f"cycles must be an integer, not {cycles!r}")
        if cycles < 2:
            raise ValueError(f"cycles must be 2 or more, not {cycles!r}")
        self._shape, self._cycles = shape, cycles
        super().__init__({"load": In(1), "early": In(shape), "late": Out(shape)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.ring = ring = memory.Memory(shape=self._shape, depth=self._cycles, init=[])
        write, read = ring.write_port(), ring.read_port()
        place, after = Signal(range(self._cycles)), Signal(range(self._cycles))
        m.d.comb += [
            after.eq(Mux(place == self._cycles - 1, 0, place + 1)),
            write.en.eq(self.load), write.addr.eq(place), write.data.eq(self.early),
            read.addr.eq(after), self.late.eq(read.data)]
        m.d.sync += place.eq(after)
        return m
