"""Every floating-point unit in the formats in which the machine uses it, side by side, each with a stream of operands and one
of results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.float.unit import FloatUnit
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.formats import SQ, Fixed, Format, Rounding, SmallFloat
from spec.records import Field, Record, uint


@dataclass(frozen=True)
class Operation:
    """A unit in particular formats.

    Attributes:
        kind: the class of the unit.
        operands: the formats of the operands, by port.
        result: the format of the result.
        exact: the operation in float64; it takes real operands by port.
        rounding: the rounding of conversions to fixed point; None for other operations.
    """

    kind: type[FloatUnit]
    operands: Mapping[str, Format]
    result: Fixed | SmallFloat
    exact: Callable[..., np.ndarray]
    rounding: Rounding | None = None

    def make(self) -> FloatUnit:
        """A new unit of this kind and these formats."""
        formats = {name: number for name, number in self.operands.items() if name != "subtract"}
        options = {} if self.rounding is None else {"rounding": self.rounding}
        return self.kind(**formats, result=self.result, **options)

    def records(self, name: str) -> tuple[Record, Record]:
        """The records of the streams: that of the operands, and that of the result with its saturation flag."""
        fields = tuple(Field(port, number, "") for port, number in self.operands.items())
        return Record(f"{name}_in", "", fields), Record(
            f"{name}_out", "", (Field("result", self.result, ""), Field("saturated", uint(1), "")))


def _sum(a: np.ndarray, b: np.ndarray, subtract: np.ndarray) -> np.ndarray:
    """a + b or a - b in float64, rounded to odd, so that a second rounding to any shorter format is still correct.

    The nearest float64 would not do where an operand has more bits than the result: rounding could turn a sum between two
    neighbours into an exact tie.
    """
    b = np.where(subtract, -b, b)
    total = a + b
    rest = (a - (total - (total - a))) + (b - (total - a))  # the exact rounding error, by Knuth
    even = total.view(np.int64) & 1 == 0
    return np.where((rest != 0) & even, np.nextafter(total, np.where(rest > 0, np.inf, -np.inf)), total)


def _quotient(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(a == 0, 0.0, a / b)


def operations(config: AcceleratorConfig) -> dict[str, Operation]:
    """The tested operations, by name."""
    n = config.formats
    v, w, one = n.view, n.work, uint(1)
    pixels = SQ(n.mean2d.int_bits + 1, n.mean2d.frac_bits)
    found = {
        f"add_{name}": Operation(FloatAdd, {"a": a, "b": b, "subtract": one}, to, _sum)
        for name, a, b, to in (("view", v, v, v), ("work", w, w, w), ("view_work", v, w, w))}
    found |= {
        f"mul_{name}": Operation(FloatMul, {"a": a, "b": b}, to, lambda a, b: a * b)
        for name, a, b, to in (("view", v, v, v), ("work", w, w, w), ("view_work", v, v, w), ("conic", w, w, n.conic),
                               ("scale", w, n.scale, w))}
    return found | {
        "divide_work": Operation(FloatDivide, {"a": w, "b": w}, w, _quotient),
        "reciprocal_view": Operation(FloatReciprocal, {"a": v}, v, lambda a: 1.0 / a),
        "rsqrt_work": Operation(FloatRsqrt, {"a": w}, w, lambda a: 1.0 / np.sqrt(np.maximum(a, 0.0))),
        "rsqrt_view": Operation(FloatRsqrt, {"a": v}, v, lambda a: 1.0 / np.sqrt(np.maximum(a, 0.0))),
        "sqrt_work": Operation(FloatSqrt, {"a": w}, w, lambda a: np.sqrt(np.maximum(a, 0.0))),
        "from_fixed": Operation(FixedToFloat, {"a": SQ(1, 2 * n.quaternion.frac_bits)}, w, lambda a: a),
        "to_pixels": Operation(FloatToFixed, {"a": v}, pixels, lambda a: a, Rounding.HALF_UP),
        "to_colour": Operation(FloatToFixed, {"a": w}, n.colour, lambda a: a, Rounding.HALF_UP),
        "to_floor": Operation(FloatToFixed, {"a": w}, pixels, lambda a: a, Rounding.FLOOR),
    }


class FloatBench(wiring.Component):
    """All operations of a configuration. The bench accepts operands whenever they are offered; results cannot wait, so sinks
    must not pause."""

    def __init__(self, config: AcceleratorConfig) -> None:
        self._operations = operations(config)
        records = {name: operation.records(name) for name, operation in self._operations.items()}
        super().__init__({
            **{f"{name}_in": In(stream.Signature(layout(pair[0]))) for name, pair in records.items()},
            **{f"{name}_out": Out(stream.Signature(layout(pair[1]))) for name, pair in records.items()},
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        for name, operation in self._operations.items():
            m.submodules[name] = unit = operation.make()
            self._connect(m, unit, operation, getattr(self, f"{name}_in"), getattr(self, f"{name}_out"))
        return m

    @staticmethod
    def _connect(
        m: Module, unit: FloatUnit, operation: Operation, operands: stream.Interface, result: stream.Interface,
    ) -> None:
        m.d.comb += [getattr(unit, port).eq(operands.payload[port]) for port in operation.operands]
        m.d.comb += [
            unit.valid.eq(operands.valid), operands.ready.eq(1), result.valid.eq(unit.result_valid),
            result.payload.result.eq(unit.result), result.payload.saturated.eq(unit.saturated),
        ]
