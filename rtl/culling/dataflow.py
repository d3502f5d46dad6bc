"""A unit's arithmetic as a graph. The graph says what is computed from what and in which format, but not when, nor by which
operator instance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from amaranth.hdl import Const, Shape, ShapeCastable, ShapeLike, Value, ValueLike
from amaranth.lib import data

from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.float.unit import FloatUnit
from rtl.shapes import shape
from spec.formats import Fixed, Format, Rounding, SmallFloat

Logic = Callable[..., ValueLike]


@dataclass(frozen=True)
class Operator:
    """A kind of arithmetic unit: its class and formats.

    Attributes:
        unit: class of the unit.
        operands: formats of the operands, in the order of the unit's ports a, b.
        result: format of the result.
        rounding: rounding of FloatToFixed; None for other units.
        registered: whether the datapath has registers for the operands, behind the multiplexers of a shared instance.
    """

    unit: type[FloatUnit]
    operands: tuple[Format, ...]
    result: Format
    rounding: Rounding | None = None
    registered: bool = False

    @property
    def latency(self) -> int:
        """Cycles from operands to result."""
        return self.unit.latency + self.registered

    @property
    def ports(self) -> tuple[str, ...]:
        """The unit's operand ports."""
        return tuple("ab"[: len(self.operands)])

    @property
    def name(self) -> str:
        """The name of the unit's module: its class, and the formats by sign, width and fraction."""
        numbers = [f"{'s' if f.signed else 'u'}{f.width}_{f.frac_bits if isinstance(f, Fixed) else f'{f.exp_bits}_{f.bias}'}"
                   for f in (*self.operands, self.result)]
        suffix = [self.rounding.value] if self.rounding else []
        return "_".join([self.unit.__name__.lower(), *numbers, *suffix]).replace("-", "m")

    def make(self) -> FloatUnit:
        """A new instance of the unit."""
        options: dict[str, Any] = {"rounding": self.rounding} if self.rounding else {}
        operands: dict[str, Any] = dict(zip(self.ports, self.operands, strict=True))
        return self.unit(**operands, result=self.result, **options)


@dataclass(frozen=True, eq=False)
class Node:
    """A value of the graph.

    Attributes:
        name: name of its signals.
        to: format or shape of the value.
        operands: the nodes from which it is computed.
        operator: kind of arithmetic unit, for an operation.
        subtract: for an operation of FloatAdd, whether b is subtracted.
        fn: function that builds the logic, for logic and views; makes the constant, for constants.
        lets: whether the first argument of fn is `let`, which names intermediate values (`rtl.float.number.Let`).
        kind: "input", "setting", "constant", "operation", "logic" or "view".
    """

    name: str
    kind: str
    to: Format | ShapeLike
    operands: tuple[Node, ...] = ()
    operator: Operator | None = None
    subtract: bool = False
    fn: Any = None
    lets: bool = False

    @cached_property
    def shape(self) -> Shape | ShapeCastable:
        """The shape of its signals."""
        return shape(self.to) if isinstance(self.to, Format) else self.to if isinstance(
            self.to, ShapeCastable) else Shape.cast(self.to)

    @property
    def width(self) -> int:
        """Number of bits."""
        return Shape.cast(self.shape).width

    @property
    def steady(self) -> bool:
        """Whether it is constant during a frame: a setting, a constant, or a view of one."""
        return self.kind in ("setting", "constant") or (self.kind == "view" and self.operands[0].steady)

    @property
    def stored(self) -> Node:
        """The node whose registers hold it; a view is held by the registers of its operand."""
        return self.operands[0].stored if self.kind == "view" else self


def _number(name: str, node: Node, kind: type | tuple[type, ...] = SmallFloat) -> Any:
    if not isinstance(node, Node):
        raise TypeError(f"{name} must be a Node, not {node!r}")
    if not isinstance(node.to, kind):
        raise TypeError(f"{name} must have a number format, not {node.to!r}")
    return node.to


@dataclass
class Dataflow:
    """A graph under construction. Nodes are in an order in which operands come before their users.

    Attributes:
        nodes: all nodes.
        inputs, outputs: nodes by name.
        ports: for every setting, by name, the nodes of its numbers.
        registered: whether operands are registered before they enter an operator. This takes a cycle for each operation, and
            keeps the multiplexers of many operations that share an instance out of its first stage.
    """

    nodes: list[Node] = field(default_factory=list)
    inputs: dict[str, Node] = field(default_factory=dict)
    ports: dict[str, tuple[Node, ...]] = field(default_factory=dict)
    outputs: dict[str, Node] = field(default_factory=dict)
    registered: bool = False

    def _new(self, *args: Any, **options: Any) -> Node:
        node = Node(*args, **options)
        self.nodes.append(node)
        return node

    def input(self, name: str, to: Format | ShapeLike) -> Node:
        """A new field of the sink's payload."""
        self._unused(name, self.inputs)
        self.inputs[name] = node = self._new(name, "input", to)
        return node

    def setting(self, name: str, to: Format | ShapeLike) -> Node:
        """A new port, whose value is constant during a frame."""
        self._unused(name, self.ports)
        node = self._new(name, "setting", to)
        self.ports[name] = (node,)
        return node

    def settings(self, name: str, to: Format, count: int) -> tuple[Node, ...]:
        """A new port with an array of `count` numbers, like a field of `frame_settings`."""
        self._unused(name, self.ports)
        self.ports[name] = tuple(self._new(f"{name}_{i}", "setting", to) for i in range(count))
        return self.ports[name]

    def constant(self, value: float | int, to: Format) -> Node:
        """A number that is known when the hardware is made. Raises ValueError where the format does not hold it exactly."""
        exact = to.round(value) if isinstance(to, SmallFloat) else to.to_float(to.quantise(value))
        if exact != value:
            raise ValueError(f"value must be representable in {to}, not {value!r}")
        bits = int(to.quantise(value))
        return self._new("constant", "constant", to, fn=lambda: Const(bits, shape(to)))

    def add(self, a: Node, b: Node, to: SmallFloat) -> Node:
        """a + b."""
        return self._sum(a, b, to, False)

    def sub(self, a: Node, b: Node, to: SmallFloat) -> Node:
        """a - b."""
        return self._sum(a, b, to, True)

    def mul(self, a: Node, b: Node, to: SmallFloat) -> Node:
        """a * b."""
        return self._operation(FloatMul, (a, b), to)

    def divide(self, a: Node, b: Node, to: SmallFloat) -> Node:
        """a / b. Division by zero gives the largest number with a's sign, or zero where a is zero."""
        return self._operation(FloatDivide, (a, b), to)

    def reciprocal(self, a: Node, to: SmallFloat) -> Node:
        """1 / a. For zero the result is the largest number."""
        return self._operation(FloatReciprocal, (a,), to)

    def rsqrt(self, a: Node, to: SmallFloat) -> Node:
        """1 / sqrt(a). For zero and negative numbers the result is the largest number."""
        return self._operation(FloatRsqrt, (a,), to)

    def sqrt(self, a: Node, to: SmallFloat) -> Node:
        """sqrt(a). For negative numbers the result is zero."""
        return self._operation(FloatSqrt, (a,), to)

    def to_fixed(self, a: Node, to: Fixed, rounding: Rounding = Rounding.HALF_UP) -> Node:
        """a as a fixed-point number, saturating."""
        return self._operation(FloatToFixed, (a,), to, rounding=rounding)

    def to_float(self, a: Node, to: SmallFloat) -> Node:
        """The fixed-point number a as a small float."""
        return self._operation(FixedToFloat, (a,), to, of=Fixed)

    def logic(self, name: str, to: Format | ShapeLike, fn: Logic, *operands: Node, lets: bool = False) -> Node:
        """Combinational `fn` of the operands' Values, with a register at its output. Fixed-point numbers are integers in fn.

        With `lets`, fn is called with `let` before the operands. It should name values that it uses more than once.
        """
        return self._new(name, "logic", to, operands, fn=fn, lets=lets)

    def view(self, name: str, to: Format | ShapeLike, fn: Logic, operand: Node) -> Node:
        """`fn` of the operand's Value. It must be wiring only: it takes no register and no cycle, and is repeated for each
        user."""
        return self._new(name, "view", to, (operand,), fn=fn)

    def operation(self, name: str, operator: Operator, *operands: Node) -> Node:
        """An operation by any FloatUnit whose ports a, b have the operands' formats. Raises ValueError for other formats."""
        formats = tuple(_number(port, node, (SmallFloat, Fixed)) for port, node in zip("ab", operands, strict=False))
        if formats != operator.operands:
            raise ValueError(f"operands must be of {operator.operands}, not {formats!r}")
        return self._new(name, "operation", operator.result, operands, operator)

    def negative(self, a: Node) -> Node:
        """-a of a small float: its sign bit is flipped. A zero stays zero, because its sign is ignored."""
        _number("a", a)
        return self.view(f"minus_{a.name}", a.to, lambda x: x ^ (1 << (len(x) - 1)), a)

    def dot3(self, to: SmallFloat, a: tuple[Node, ...], b: tuple[Node, ...]) -> Node:
        """The scalar product a . b. Every product and every sum is rounded; sums are taken from left to right."""
        x, y, z = (self.mul(i, j, to) for i, j in zip(a, b, strict=True))
        return self.add(self.add(x, y, to), z, to)

    def output(self, name: str, node: Node) -> None:
        """Makes a node a field of the source's payload. Raises ValueError where it depends on no input."""
        self._unused(name, self.outputs)
        if node.stored.steady:
            raise ValueError(f"output {name} must depend on an input, not {node.name!r}")
        self.outputs[name] = node

    def _sum(self, a: Node, b: Node, to: SmallFloat, subtract: bool) -> Node:
        for name, node in (("a", a), ("b", b)):
            if _number(name, node).sig_bits > to.sig_bits:  # else float64 and the unit could round differently
                raise ValueError(f"{name} must have no more significand bits than {to}, not {node.to!r}")
        return self._operation(FloatAdd, (a, b), to, subtract=subtract)

    def _operation(
        self, unit: type[FloatUnit], operands: tuple[Node, ...], to: Format, *, subtract: bool = False,
        rounding: Rounding | None = None, of: type[Format] = SmallFloat,
    ) -> Node:
        formats = tuple(_number(name, node, of) for name, node in zip("ab", operands, strict=False))
        name = {FloatAdd: "difference" if subtract else "sum", FloatMul: "product", FloatDivide: "quotient",
                FloatReciprocal: "reciprocal", FloatRsqrt: "rsqrt", FloatSqrt: "root", FloatToFixed: "fixed",
                FixedToFloat: "number"}[unit]
        return self._new(name, "operation", to, operands, Operator(unit, formats, to, rounding, self.registered), subtract)

    @staticmethod
    def _unused(name: str, names: Mapping[str, object]) -> None:
        if name in names or name == "carried":
            raise ValueError(f"name must be a new one, not {name!r}")

    def input_layout(self, carried: ShapeLike | None = None) -> data.StructLayout:
        """The payload of the sink."""
        return _layout(self.inputs, carried)

    def output_layout(self, carried: ShapeLike | None = None) -> data.StructLayout:
        """The payload of the source."""
        return _layout(self.outputs, carried)


def _layout(nodes: dict[str, Node], carried: ShapeLike | None) -> data.StructLayout:
    return data.StructLayout({
        **{name: node.shape for name, node in nodes.items()}, **({} if carried is None else {"carried": carried})})


def as_value(x: ValueLike) -> Value:
    """x as an Amaranth Value; a data.View is returned unchanged."""
    return x if isinstance(x, data.View) else Value.cast(x)
