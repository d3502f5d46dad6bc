"""The base class of the units, with their ports and the valid pipeline."""

from __future__ import annotations

from collections.abc import Mapping

from amaranth.hdl import Module, Shape, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.float.number import Let
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import Fixed, Format, SmallFloat


def check_kind(name: str, number: object, kind: type[Format]) -> None:
    """Raises TypeError unless `number` is a format of that kind."""
    if not isinstance(number, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, not {number!r}")


class FloatUnit(wiring.Component):
    """A pipelined operation, by default without back-pressure, for units with a fixed schedule. Throughput: one operation per
    cycle.

    Operands are taken in every cycle in which `valid` is high. Their `result` and `saturated` come `latency` cycles later, in
    order, when `result_valid` is high::

        cycle          0      1      2      3      4
        valid        ~~~~~~~~~~~~~~_______~~~~~~~_______
        operands     <  A  ><  B  >       <  C  >
        result_valid ______________~~~~~~~~~~~~~~_______~~~    (latency 2)
        result                     <  A  ><  B  >       <  C  >

    Cycles without operands clock no data register. Reset drops operations that are in the pipeline; data registers have no
    reset.

    A unit that `stalls` has the port `advance`: in cycles in which it is low, nothing moves.

    Attributes:
        latency: cycles from operands to result.

    `saturated` is high where the result's magnitude was too large for its format, or a negative result met an unsigned format.
    """

    latency: int

    def __init__(self, operands: Mapping[str, Shape], result: Fixed | SmallFloat, *, stalls: bool = False) -> None:
        super().__init__({
            "valid": In(1), **({"advance": In(1)} if stalls else {}), **{name: In(of) for name, of in operands.items()},
            "result_valid": Out(1), "result": Out(shape(result)), "saturated": Out(1),
        })

    def stages(self, p: Pipeline, let: Let) -> Staged:
        """Builds the registers of the operation. Returns the result's bits and, above them, `saturated`, at stage `latency`."""
        raise NotImplementedError

    def elaborate(self, platform: object) -> Module:
        m = Module()
        p = Pipeline(m, load=self.valid, advance=self.advance if "advance" in self.signature.members else 1)

        def let(name: str, value: Value) -> Signal:
            wire = Signal(value.shape(), name=name)
            m.d.comb += wire.eq(value)
            return wire

        valid, outcome = p.control("valid", self.valid), self.stages(p, let)
        m.d.comb += [
            self.result_valid.eq(valid.at(self.latency)),
            self.result.eq(outcome.at(self.latency)[:-1]),
            self.saturated.eq(outcome.at(self.latency)[-1]),
        ]
        return m
