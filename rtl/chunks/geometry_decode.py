"""Turns compact geometry into the words with which projection works."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.chunks import decode
from rtl.chunks.decode_colour import opacity
from rtl.emit import add_shared
from rtl.float.add import FloatAdd
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import layout
from spec.chunks import coded_point
from spec.compact import COARSE_BOUND, check_formats
from spec.config import AcceleratorConfig
from spec.records import gaussian_point


def _adder(config: AcceleratorConfig) -> FloatAdd:
    """The sum of a chunk's corner and a coordinate relative to it."""
    position = config.formats.position
    return FloatAdd(a=position, b=decode.OPERAND, result=position, stalls=True)


class GeometryDecode(wiring.Component):
    """Decodes CompactGeometry records, in order; `spec.compact` defines the words bit by bit.

    Parameters:
        config: a machine with compact records.

    Ports:
        codes: CodedPoint items.
        points: GaussianPoint items. An item with `end` is decoded like any other, but means nothing.

    Throughput: one Gaussian per cycle. Latency: 6 cycles, one per stage. All stages stand still while an item that has left the
    last one is not taken:

    1. codes are brought to one width, coordinates to small floats, and scales' logarithms are found;
    2. the quaternion's components, and the first stage of FloatAdd for positions;
    3. squares of components;
    4. the square of the largest component;
    5. the straight line of its root;
    6. its value, the quaternion's order, scales, the opacity, and the last stage of FloatAdd.
    """

    latency = 1 + FloatAdd.latency

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.compact:
            raise ValueError(f"records must be 'compact' for this unit, not {config.records!r}")
        check_formats(config)
        self.config = config
        super().__init__({
            "codes": In(stream.Signature(layout(coded_point(config)))),
            "points": Out(stream.Signature(layout(gaussian_point(config))))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        codes, points = self.codes, self.points
        moves = Signal()
        m.d.comb += [moves.eq(points.ready | ~points.valid), codes.ready.eq(moves)]
        p = Pipeline(m, load=codes.valid, advance=moves)
        valid = p.control("valid", codes.valid)
        adders = [add_shared(m, platform, f"add_{i}", "position_add", _adder, self.config) for i in range(3)]
        for adder in adders:
            m.d.comb += [adder.valid.eq(valid.at(1)), adder.advance.eq(moves), adder.subtract.eq(0)]
        found = self._words(m, p, adders)
        m.d.comb += points.valid.eq(valid.at(self.latency))
        for name, value in found.items():
            m.d.comb += Value.cast(points.payload[name]).eq(Value.cast(value.at(self.latency)))
        return m

    def _words(self, m: Module, p: Pipeline, adders: list[FloatAdd]) -> dict[str, Staged]:
        """The fields of a point, at their stages."""
        def let(name: str, value: Value) -> Signal:
            wire = Signal(value.shape(), name=name)
            m.d.comb += wire.eq(value)
            return wire

        def reg(name: str, value: Value) -> Staged:
            return p.reg(name, lambda x: x, p.data(name, value))

        item = self.codes.payload
        fields = decode.geometry_codes(self.config, Value.cast(item.word), let("coarse", item.bound == COARSE_BOUND))
        for i, adder in enumerate(adders):
            m.d.comb += [
                adder.a.eq(reg(f"low_{i}", item.low[i]).value),
                adder.b.eq(reg(f"operand_{i}", decode.operand(let, fields.position[i], item.step[i])).value)]
        scales = [
            reg(f"logarithm_{i}", Cat(decode.scale_logarithm(code, item.scale_top), zero))
            for i, (code, zero) in enumerate(zip(fields.scale, fields.degenerate, strict=True))]
        last = self.latency - 1
        return {
            "mean": Staged(p, "mean", Cat(adder.result for adder in adders), self.latency, False),
            "scale": p.reg("scale", lambda *scales: Cat(decode.scale_word(c[:-1].as_signed(), c[-1]) for c in scales),
                           *(scale.to(last) for scale in scales)),
            "quat": self._quaternion(p, let, [reg(f"code_{i}", code) for i, code in enumerate(fields.quaternion)],
                                     reg("largest", fields.largest)),
            "log2_opacity": p.reg("log2_opacity", lambda x: opacity(self.config, x), reg("opacity", fields.opacity).to(last)),
            "bound": p.data("bound", item.bound), "index": p.data("index", item.index), "end": p.data("end", item.end)}

    def _quaternion(
        self, p: Pipeline, let: Callable[[str, Value], Value], codes: list[Staged], largest: Staged,
    ) -> Staged:
        """w, x, y, z, from the codes of three of them and the position of the fourth."""
        q = [p.reg(f"q_{i}", decode.component, code) for i, code in enumerate(codes)]
        squares = [p.reg(f"square_{i}", lambda q: decode.component_square(let, q), x) for i, x in enumerate(q)]
        x = p.reg("remainder", lambda *squares: decode.remainder(let, list(squares)), *squares)
        line = p.reg("line", lambda x: Cat(*decode.root_line(x)), x)

        def ordered(largest: Value, x: Value, line: Value, *q: Value) -> Value:
            root = let("largest_component", decode.root(let, x, line[:17], line[17:]))
            return Cat(
                Mux(largest == k, root, q[k] if k == 0 else q[k - 1] if k == 3 else Mux(largest < k, q[k - 1], q[k]))
                for k in range(4))

        return p.reg("quat", ordered, largest, x, line, *q)


