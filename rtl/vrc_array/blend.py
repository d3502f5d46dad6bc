"""Level blending: mixes the two level banks of a row of pixels into one (docs/array.md).

`BlendWeights` evaluates the tile's plane along a row. It runs ahead of the pixels, because these are a hundred times wider and
would be expensive to delay. `Blend` mixes them::

    stage of Blend      0           1                    2
                        b - a       (b - a) * weight     a + rounded

A weight of 0 gives bank 0 exactly; this is how tiles without blending pass.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Module, Mux, Value, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from rtl.vrc_array.pixel_core import pixel_layout
from spec.config import AcceleratorConfig
from spec.tables import BLEND_INDEX_BITS, smoothstep_table

BLEND_LATENCY = 3
"""Cycles through `Blend`."""


def weights_latency(config: AcceleratorConfig) -> int:
    """Cycles through `BlendWeights`: one for the products, two for sums, one per bit of the column index, one for the table."""
    return 4 + (config.array_x - 1).bit_length()


def check(config: AcceleratorConfig) -> None:
    """Raises TypeError or ValueError if there are no two levels to blend or the table cannot be addressed."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    if config.level_banks != 2:
        raise ValueError(f"config.levels must be at least 2, not {config.levels!r}")
    if config.formats.plane.frac_bits < BLEND_INDEX_BITS:
        raise ValueError(f"plane must have at least {BLEND_INDEX_BITS} fraction bits, not {config.formats.plane!r}")


class BlendWeights(wiring.Component):
    """The blend weights of the outer level for `cores_x` neighbouring pixels.

    Parameters:
        config: the machine; it must have two level banks.

    Ports:
        valid: a row's plane and place are at the input.
        blend, plane, row, column: the fields of the tile's header, and the place of the row's first pixel in the tile.
        weights: a raw `blend_weight` per column, `weights_latency(config)` cycles later; 0 if `blend` is not set.

    Throughput: one row per cycle. Latency: `weights_latency(config)` cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        check(config)
        self.config = config
        n = config.formats
        super().__init__({
            "valid": In(1),
            "blend": In(1),
            "plane": In(data.ArrayLayout(shape(n.plane), 3)),
            "row": In(4),
            "column": In(4),
            "weights": Out(data.ArrayLayout(shape(n.blend_weight), config.array_x)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        p = Pipeline(m, load=self.valid)
        start, along_x, along_y = (p.data(f"plane_{i}", self.plane[i]) for i in range(3))
        down = p.reg("down", lambda y, slope: y * slope, p.data("row", self.row), along_y)
        across = p.reg("across", lambda x, slope: x * slope, p.data("column", self.column), along_x)
        moved = p.reg("moved", lambda a, b: a + b, down, across)
        values = {0: p.reg("t_0", lambda t, plane: t + plane, moved, start)}
        stride = 1
        while stride < self.config.array_x:
            shift = stride.bit_length() - 1
            for x, t in list(values.items()):
                values[x + stride] = p.reg(f"t_{x + stride}", lambda t, s, shift=shift: t + (s << shift), t, along_x)
            stride *= 2
        blend, end = p.data("blend", self.blend), weights_latency(self.config)
        for x, t in values.items():
            m.d.comb += self.weights[x].eq(p.reg(f"weight_{x}", self._weight, t.to(end - 1), blend).at(end))
        return m

    def _weight(self, t: Value, blend: Value) -> Value:
        """The smoothstep of t, clamped to 0..1; 0 if `blend` is not set."""
        n = self.config.formats
        table = Array(Const(int(w), shape(n.blend_weight)) for w in smoothstep_table(n))
        inside = table[t[n.plane.frac_bits - BLEND_INDEX_BITS : n.plane.frac_bits]]
        beyond = t[n.plane.frac_bits : -1].any()
        return Mux(blend & ~t[-1], Mux(beyond, 1 << n.blend_weight.frac_bits, inside), 0)


class Blend(wiring.Component):
    """Mixes two level banks.

    Parameters:
        config: the machine; it must have two level banks.

    Ports:
        valid: a row is at the input.
        pixels: bank 0 and bank 1 of each column; depth is mixed only with `config.depth`.
        weights: the weight of bank 1 for each column.
        mixed: the mixed pixel of each column, BLEND_LATENCY cycles later.

    Throughput: one row per cycle. Latency: BLEND_LATENCY cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        check(config)
        self.config = config
        lanes = config.array_x
        super().__init__({
            "valid": In(1),
            "pixels": In(data.ArrayLayout(data.ArrayLayout(pixel_layout(config), 2), lanes)),
            "weights": In(data.ArrayLayout(shape(config.formats.blend_weight), lanes)),
            "mixed": Out(data.ArrayLayout(pixel_layout(config), lanes)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        p = Pipeline(m, load=self.valid)
        for x in range(self.config.array_x):
            weight = p.data(f"weight_{x}", self.weights[x])
            inner, outer, mixed = self.pixels[x][0], self.pixels[x][1], self.mixed[x]
            for c in range(3):
                m.d.comb += mixed.colour[c].eq(self._mix(p, f"colour_{x}_{c}", inner.colour[c], outer.colour[c], weight))
            m.d.comb += mixed.transmittance.eq(self._mix(p, f"t_{x}", inner.transmittance, outer.transmittance, weight))
            if self.config.depth:
                m.d.comb += mixed.depth.eq(self._mix(p, f"depth_{x}", inner.depth, outer.depth, weight))
        return m

    def _mix(self, p: Pipeline, name: str, inner: Value, outer: Value, weight: Staged) -> Value:
        """inner + rs((outer - inner) * weight), always between the two; the rounding constant is part of the one addition."""
        frac = self.config.formats.blend_weight.frac_bits
        a = p.data(f"{name}_inner", inner)
        difference = p.reg(f"{name}_difference", lambda a, b: b - a, a, p.data(f"{name}_outer", outer))
        part = p.reg(f"{name}_part", lambda d, w: d * w, difference, weight)
        half = Const(1 << (frac - 1), unsigned(frac))
        return p.reg(name, lambda part, a: (part + Cat(half, a))[frac : frac + len(a)], part, a).at(BLEND_LATENCY)
