"""A unit's arithmetic as a graph: what is computed of what, and in which format; not when, nor by which operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

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
    """A kind of float unit: what one instance of it can do.

    Attributes:
        unit: class.
        operands: formats, in the order of the unit's ports a, b.
        result: format.
        rounding: of FloatToFixed.
    """

    unit: type[FloatUnit]
    operands: tuple[Format, ...]
    result: Format
    rounding: Rounding | None = None

    @property
    def latency(self) -> int:
        """Cycles from operands to result."""
        return self.unit.latency

    @property
    def ports(self) -> tuple[str, ...]:
        """The unit's operand ports."""
        return tuple("ab"[: len(self.operands)])

    @property
    def name(self) -> str:
        """A module name: kind, and formats by sign, width and fraction."""
        numbers = [f"{'s' if f.signed else 'u'}{f.width}_{f.frac_bits if isinstance(f, Fixed) else f'{f.exp_bits}_{f.bias}'}"
                   for f in (*self.operands, self.result)]
        suffix = [self.rounding.value] if self.rounding else []
        return "_".join([self.unit.__name__.lower(), *numbers, *suffix]).replace("-", "m")

    def make(self) -> FloatUnit:
        """An instance."""
        options = {"rounding": self.rounding} if self.rounding else {}
        return self.unit(**dict(zip(self.ports, self.operands, strict=True)), result=self.result, **options)


@dataclass(frozen=True, eq=False)
class Node:
    """A value of the graph.

    Attributes:
        name: for signals.
        to: format or shape.
        operands: what it is computed of.
        operator: the unit's kind, for an operation.
        subtract: of FloatAdd, whether b is taken away.
        fn: of logic and views.
        lets: fn's first argument is `let`, which names intermediate values (`rtl.float.number.Let`).
        kind: "input", "setting", "constant", "operation", "logic" or "view".
    """

    name: str
    kind: str
    to: Format | ShapeLike
    operands: tuple[Node, ...] = ()
    operator: Operator | None = None
    subtract: bool = False
    fn: Logic | None = None
    lets: bool = False

    @cached_property
    def shape(self) -> Shape | ShapeCastable:
        """Of its signals."""
        return shape(self.to) if isinstance(self.to, Format) else self.to if isinstance(
            self.to, ShapeCastable) else Shape.cast(self.to)

    @property
    def width(self) -> int:
        """Bits."""
        return Shape.cast(self.shape).width

    @property
    def steady(self) -> bool:
        """Constant during a frame: settings, constants, and views of them."""
        return self.kind in ("setting", "constant") or (self.kind == "view" and self.operands[0].steady)

    @property
    def stored(self) -> Node:
        """The node whose registers hold it: a view's is its operand's."""
        return self.operands[0].stored if self.kind == "view" else self


def _number(name: str, node: Node, kind: type | tuple[type, ...] = SmallFloat) -> Format:
    if not isinstance(node, Node):
        raise TypeError(f"{name} must be a Node, not {node!r}")
    if not isinstance(node.to, kind):
        raise TypeError(f"{name} must have a number format, not {node.to!r}")
    return node.to


@dataclass
class Dataflow:
    """A graph under construction; nodes are in an order in which operands come first.

    Attributes:
        nodes: all of them.
        inputs, ports, outputs: nodes by name; of a setting port its numbers.
    """

    nodes: list[Node] = field(default_factory=list)
    inputs: dict[str, Node] = field(default_factory=dict)
    ports: dict[str, tuple[Node, ...]] = field(default_factory=dict)
    outputs: dict[str, Node] = field(default_factory=dict)

    def _new(self, *args: object, **options: object) -> Node:
        node = Node(*args, **options)
        self.nodes.append(node)
        return node

    def input(self, name: str, to: Format | ShapeLike) -> Node:
        """A field of the sink's payload."""
        self._unused(name, self.inputs)
        self.inputs[name] = node = self._new(name, "input", to)
        return node

    def setting(self, name: str, to: Format | ShapeLike) -> Node:
        """A port that is constant during a frame."""
        self._unused(name, self.ports)
        node = self._new(name, "setting", to)
        self.ports[name] = (node,)
        return node

    def settings(self, name: str, to: Format, count: int) -> tuple[Node, ...]:
        """A port of several numbers, an array, as a field of `frame_settings`."""
        self._unused(name, self.ports)
        self.ports[name] = tuple(self._new(f"{name}_{i}", "setting", to) for i in range(count))
        return self.ports[name]

    def constant(self, value: float | int, to: Format) -> Node:
        """A number known when the hardware is made; it must be one of the format's."""
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
        """a / b; by zero: the largest number of a's sign, or zero for zero."""
        return self._operation(FloatDivide, (a, b), to)

    def reciprocal(self, a: Node, to: SmallFloat) -> Node:
        """1 / a; of zero the largest number."""
        return self._operation(FloatReciprocal, (a,), to)

    def rsqrt(self, a: Node, to: SmallFloat) -> Node:
        """1 / sqrt(a); of zero and of negative numbers the largest number."""
        return self._operation(FloatRsqrt, (a,), to)

    def sqrt(self, a: Node, to: SmallFloat) -> Node:
        """sqrt(a); of negative numbers zero."""
        return self._operation(FloatSqrt, (a,), to)

    def to_fixed(self, a: Node, to: Fixed, rounding: Rounding = Rounding.HALF_UP) -> Node:
        """a in fixed point, saturating."""
        return self._operation(FloatToFixed, (a,), to, rounding=rounding)

    def to_float(self, a: Node, to: SmallFloat) -> Node:
        """Fixed-point a as a small float."""
        return self._operation(FixedToFloat, (a,), to, of=Fixed)

    def logic(self, name: str, to: Format | ShapeLike, fn: Logic, *operands: Node, lets: bool = False) -> Node:
        """Combinational `fn` of the operands' Values, registered at its end. Numbers of fixed point are integers there.

        With `lets`, fn is called with `let` before the operands: what it uses more than once it should name.
        """
        return self._new(name, "logic", to, operands, fn=fn, lets=lets)

    def view(self, name: str, to: Format | ShapeLike, fn: Logic, operand: Node) -> Node:
        """`fn` of the operand's Value wherever it is wanted: wiring, without a register and without a cycle."""
        return self._new(name, "view", to, (operand,), fn=fn)

    def operation(self, name: str, operator: Operator, *operands: Node) -> Node:
        """An operator of one's own: a FloatUnit with ports a, b of the operands' formats."""
        formats = tuple(_number(port, node, (SmallFloat, Fixed)) for port, node in zip("ab", operands, strict=False))
        if formats != operator.operands:
            raise ValueError(f"operands must be of {operator.operands}, not {formats!r}")
        return self._new(name, "operation", operator.result, operands, operator)

    def negative(self, a: Node) -> Node:
        """-a of a small float: its sign flipped, which zero does not mind."""
        _number("a", a)
        return self.view(f"minus_{a.name}", a.to, lambda x: x ^ (1 << (len(x) - 1)), a)

    def dot3(self, to: SmallFloat, a: tuple[Node, Node, Node], b: tuple[Node, Node, Node]) -> Node:
        """a . b with every product and sum rounded, left to right."""
        x, y, z = (self.mul(i, j, to) for i, j in zip(a, b, strict=True))
        return self.add(self.add(x, y, to), z, to)

    def output(self, name: str, node: Node) -> None:
        """A field of the source's payload."""
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
        return self._new(name, "operation", to, operands, Operator(unit, formats, to, rounding), subtract)

    @staticmethod
    def _unused(name: str, names: dict[str, object]) -> None:
        if name in names or name == "carried":
            raise ValueError(f"name must be a new one, not {name!r}")

    def input_layout(self, carried: ShapeLike | None = None) -> data.StructLayout:
        """Payload of the sink."""
        return _layout(self.inputs, carried)

    def output_layout(self, carried: ShapeLike | None = None) -> data.StructLayout:
        """Payload of the source."""
        return _layout(self.outputs, carried)


def _layout(nodes: dict[str, Node], carried: ShapeLike | None) -> data.StructLayout:
    return data.StructLayout({
        **{name: node.shape for name, node in nodes.items()}, **({} if carried is None else {"carried": carried})})


def as_value(x: ValueLike) -> Value:
    """A Value of anything that stands for one; views stay what they are."""
    return x if isinstance(x, data.View) else Value.cast(x)
