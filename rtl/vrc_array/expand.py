"""Expands one polynomial into the exponents of a whole row: the first row of cores needs every column at once.

A polynomial e + x s + x (x - 1) / 2 c splits into the polynomial through its even points, (e, 2 s + c, 4 c), and the one
through its odd points, (e + s, 2 s + 3 c, 4 c). Each stage of splitting doubles the number of columns, so that 4 stages give
16. Only additions are needed. They are exact modulo the width of the format, hence exact wherever the exponents fit it. Slopes
along y, which are linear in x, are expanded in the same way.
"""

from __future__ import annotations

from amaranth.hdl import Module, Value, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.fixed import modular
from rtl.pipeline import Pipeline, Staged
from rtl.vrc_array.row import op_layout
from spec.config import AcceleratorConfig


def latency(config: AcceleratorConfig) -> int:
    """Cycles through the unit: one for each doubling of the columns."""
    return (config.array_x - 1).bit_length()


def issue_layout(config: AcceleratorConfig) -> data.StructLayout:
    """An op at the array's first pixel: the fields that the rows pass on, and those that only the expansion uses."""
    n = config.formats
    return data.StructLayout({
        "op": op_layout(config),
        "exponent": signed(n.exponent.width),
        "slope_x": signed(n.slope.width),
        "slope_y": signed(n.slope.width),
        "curve_xx": signed(n.curvature.width),
        "curve_xy": signed(n.curvature.width),
    })


class Expand(wiring.Component):
    """Computes exponents and slopes along y at the first row, for every column.

    Parameters:
        config: the machine; `cores_x` (a power of two, because it divides the tile) and the formats are used.

    Ports:
        issue: an op; `issue.op.valid` low is a bubble.
        op, exponents, slopes: the inputs of the first row, `latency(config)` cycles later.

    Throughput: one op per cycle, without back-pressure. Latency: `latency(config)` cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        n, columns = config.formats, config.array_x
        super().__init__({
            "issue": In(issue_layout(config)),
            "op": Out(op_layout(config)),
            "exponents": Out(data.ArrayLayout(signed(n.exponent.width), columns)),
            "slopes": Out(data.ArrayLayout(signed(n.slope.width), columns)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        issue, end = self.issue, latency(self.config)
        p = Pipeline(m, load=issue.op.valid)
        for x, (exponent, slope) in self._columns(p).items():
            m.d.comb += [self.exponents[x].eq(exponent.at(end)), self.slopes[x].eq(slope.at(end))]
        for name in self.op.shape().members:
            field = p.control(name, issue.op[name]) if name == "valid" else p.data(name, issue.op[name])
            m.d.comb += self.op[name].eq(field.at(end))
        return m

    def _columns(self, p: Pipeline) -> dict[int, tuple[Staged, Staged]]:
        """Exponent and slope along y of each column, after one stage for each doubling."""
        n, issue = self.config.formats, self.issue
        curve_x, curve_y = p.data("curve_xx", issue.curve_xx), p.data("curve_xy", issue.curve_xy)
        exponents = {0: (p.data("exponent", issue.exponent), p.data("slope_x", issue.slope_x))}
        slopes = {0: p.data("slope_y", issue.slope_y)}
        for doubling in range(latency(self.config)):
            stride = 1 << doubling

            def even(s: Value, c: Value, shift: int = 2 * doubling) -> Value:
                return modular((s << 1) + (c << shift), n.exponent)

            def odd(s: Value, c: Value, shift: int = 2 * doubling) -> Value:
                return modular((s << 1) + (c << shift + 1) + (c << shift), n.exponent)

            def forward(e: Value, s: Value) -> Value:
                return modular(e + s, n.exponent)

            def along_y(s: Value, c: Value, shift: int = doubling) -> Value:
                return modular(s + (c << shift), n.slope)

            for x, (e, s) in list(exponents.items()):
                beyond = x + stride
                exponents[x] = e, p.reg(f"step_{x}", even, s, curve_x)
                exponents[beyond] = p.reg(f"exponent_{beyond}", forward, e, s), p.reg(f"step_{beyond}", odd, s, curve_x)
            for x, s in list(slopes.items()):
                slopes[x + stride] = p.reg(f"slope_{x + stride}", along_y, s, curve_y)
        return {x: (exponents[x][0], slopes[x]) for x in exponents}
