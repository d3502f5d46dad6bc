"""Computes spherical harmonics from a Gaussian's offset from the camera, as a graph of fixed-point products
(`spec.harmonics`)."""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Mux, Value, unsigned

from rtl.culling.dataflow import Dataflow, Node, Operator
from rtl.culling.fixed_multiply import FixedMul
from rtl.float.number import fields, widened
from spec import harmonics
from spec.config import AcceleratorConfig
from spec.formats import Fixed
from spec.harmonics import SEED_FRAC_BITS, SEED_INDEX_BITS

OFFSETS = ("dx", "dy", "dz")
"""Inputs of the graph, in the format `view`."""


def basis_name(term: int) -> str:
    """Name of the graph's output for basis function 1 + `term` in the order of 3DGS; its format is `sh_basis`."""
    return f"basis_{term}"


def harmonics_graph(config: AcceleratorConfig, sh_degree: int) -> Dataflow:
    """The graph of all basis functions up to degree 1, 2 or 3. It has 11, 18 or 30 products, all with the same formats."""
    return _Harmonics(config, sh_degree).graph


def _extended(x: Value, width: int) -> Value:
    """The signed x, sign-extended or cut to another width."""
    return Cat(x, x[-1].replicate(max(0, width - len(x))))[:width]


class _Harmonics:
    """The graph under construction."""

    def __init__(self, config: AcceleratorConfig, sh_degree: int) -> None:
        n = config.formats
        self.graph, self.formats, self.basis = Dataflow(), n, n.sh_basis
        self.first, self.second = harmonics.polynomial_format(n), harmonics.direction_format(n)
        self.product, factors = harmonics.product_format(n), harmonics.factors(n)
        self.factor = {
            name: self.graph.constant(float(self.second.to_float(raw)), self.second) for name, raw in factors._asdict().items()}
        x, y, z = self.direction()
        self.degree_1(x, y, z)
        if sh_degree > 1:
            self.degrees_2_and_3(x, y, z, sh_degree)

    def as_(self, to: Fixed, node: Node) -> Node:
        """A number at another width, which must hold its value."""
        return node if node.to == to else self.graph.view(
            f"{node.name}_as_{to.width}", to, lambda x: _extended(x, to.width), node)

    def times(self, name: str, a: Node, b: Node) -> Node:
        """a * b, rounded. All products have the same formats, so that they can share operators."""
        operands = self.as_(self.first, a), self.as_(self.second, b)
        operator = Operator(FixedMul, (self.first, self.second), self.product)
        return self.graph.operation(name, operator, *operands)

    def output(self, term: int, node: Node) -> None:
        self.graph.output(basis_name(term), self.as_(self.basis, node))

    def direction(self) -> tuple[Node, Node, Node]:
        """The scaled direction, with x and y negated."""
        aligned = self.aligned()
        squares = [self.times(f"square_{axis}", a, a) for axis, a in zip("xyz", aligned, strict=True)]
        root = self.scaled_root(*squares)
        x, y, z = (self.as_(self.second, self.times(axis, a, root)) for axis, a in zip("xyz", aligned, strict=True))
        return x, y, z

    def aligned(self) -> list[Node]:
        """The offsets divided by a common power of two, so that the largest magnitude lies in [1, 2), and truncated."""
        g, view, to = self.graph, self.formats.view, self.second
        offsets = [g.input(name, view) for name in OFFSETS]
        width = to.int_bits + to.frac_bits

        def largest(*offsets: Value) -> Value:
            a, b, c = (fields(x, view).exponent for x in offsets)
            ab = Mux(a > b, a, b)
            return Mux(ab > c, ab, c)

        def shifted(x: Value, places: Value, negate: bool) -> Value:
            x = fields(x, view)
            top = widened(x.significand, max(width, view.sig_bits))[-width:]
            steps = (width - 1).bit_length()
            magnitude = (top >> places[:steps]) & (~places[steps:].any()).replicate(width)
            return Mux(x.negative ^ negate, -magnitude, magnitude)

        exponent = g.logic("largest", unsigned(view.exp_bits), largest, *offsets)
        aligned = []
        for axis, offset in zip("xyz", offsets, strict=True):
            places = g.logic(
                f"places_{axis}", unsigned(view.exp_bits), lambda x, e: e - fields(x, view).exponent, offset, exponent)
            aligned.append(g.logic(
                f"aligned_{axis}", to, lambda x, n, negate=axis != "z": shifted(x, n, negate), offset, places))
        return aligned

    def scaled_root(self, xx: Node, yy: Node, zz: Node) -> Node:
        """DIRECTION_SCALE / sqrt(xx + yy + zz), by a table and one Newton step."""
        g, frac = self.graph, self.basis.frac_bits
        one, length_bits = 1 << frac, harmonics.length_format(self.formats).width - 1
        roots, inverses = harmonics.root_seeds(self.formats)
        root_bits, inverse_bits = int(max(roots)).bit_length(), int(max(inverses)).bit_length()

        def reduced(*squares: Value) -> Value:
            length = sum(squares)[:length_bits]
            large = length[frac + 2 :].any()
            return Cat(Mux(large, length[2:], length)[: frac + 2], large)

        def seed(square: Value) -> Value:
            upper = square[frac + 1]
            index = Cat(Mux(upper, square[frac + 1 - SEED_INDEX_BITS : frac + 1], square[frac - SEED_INDEX_BITS : frac]), upper)
            rows = zip(roots.tolist(), inverses.tolist(), strict=True)
            return Array(Const(inverse << root_bits | root, root_bits + inverse_bits) for root, inverse in rows)[index]

        def finish(seed: Value, step: Value, square: Value) -> Value:
            twice = Cat(Const(0, frac - SEED_FRAC_BITS + 1), seed[:root_bits], Const(0, 1)).as_signed() + step
            return Mux(square[-1], twice >> 2, twice >> 1)

        square = g.logic("length", unsigned(frac + 3), reduced, xx, yy, zz)
        start = g.logic("seed", unsigned(root_bits + inverse_bits), seed, square)
        length = g.view("reduced", self.first, lambda x: Cat(x[: frac + 2], Const(0, self.first.width - frac - 2)), square)
        inverse = g.view(
            "inverse", self.second, lambda x: Cat(x[root_bits:], Const(0, self.second.width - inverse_bits)), start)
        root = g.view("root_seed", self.first, lambda x: Cat(
            Const(0, frac - SEED_FRAC_BITS), x[:root_bits], Const(0, self.first.width))[: self.first.width], start)
        residual = g.logic("residual", self.second, lambda x: one - x, self.times("one", length, inverse))
        return g.logic("root", self.second, finish, start, self.times("step", root, residual), square)

    def degree_1(self, x: Node, y: Node, z: Node) -> None:
        for term, axis in enumerate((y, z, x)):
            self.output(term, self.times(f"linear_{term}", axis, self.factor["linear"]))

    def degrees_2_and_3(self, x: Node, y: Node, z: Node, sh_degree: int) -> None:
        g, first, factor = self.graph, self.first, self.factor
        xx, yy, zz = self.times("xx", x, x), self.times("yy", y, y), self.times("zz", z, z)
        both = g.logic("both", first, lambda xx, yy: xx + yy, xx, yy)
        difference = g.logic("difference", self.product, lambda xx, yy: xx - yy, xx, yy)
        half = g.view("half_difference", self.basis, lambda x: x[1 : self.basis.width + 1], difference)
        axial = g.logic("axial_sum", first, lambda zz, both: (zz << 1) - both, zz, both)
        xy = self.times("xy", x, y)
        self.output(3, xy)
        self.output(4, self.times("yz", y, z))
        self.output(5, self.times("axial", axial, factor["axial"]))
        self.output(6, self.times("xz", x, z))
        self.output(7, half)
        if sh_degree < 3:
            return
        cubic_y = g.logic("cubic_y_sum", first, lambda xx, difference: (xx << 1) + difference, xx, difference)
        cubic_x = g.logic("cubic_x_sum", first, lambda yy, difference: difference - (yy << 1), yy, difference)
        ring = g.logic("ring_sum", first, lambda zz, both: (zz << 2) - both, zz, both)
        polar = g.logic("polar_sum", first, lambda zz, both: (zz << 1) - (both << 1) - both, zz, both)
        twice_z = g.view("twice_z", first, lambda z: Cat(Const(0, 1), _extended(z, first.width - 1)), z)
        mixed, ring = self.times("mixed", twice_z, factor["mixed"]), self.times("ring", ring, factor["ring"])
        self.output(8, self.times("cubic_y", self.times("cubic_yy", cubic_y, y), factor["cubic"]))
        self.output(9, self.times("mixed_xy", mixed, xy))
        self.output(10, self.times("ring_y", ring, y))
        self.output(11, self.times("polar_z", self.times("polar", polar, factor["polar"]), z))
        self.output(12, self.times("ring_x", ring, x))
        self.output(13, self.times("mixed_difference", mixed, half))
        self.output(14, self.times("cubic_x", self.times("cubic_xx", cubic_x, x), factor["cubic"]))
