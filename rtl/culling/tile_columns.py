"""The ellipse test: finds the columns of a tile row that have pixels which a splat can change."""

from __future__ import annotations

from typing import NamedTuple, cast

from amaranth.hdl import Cat, Const, Mux, Value, signed

from rtl.culling.dataflow import Dataflow, Node
from spec import tables
from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import TILE, TILE_EDGE_MARGIN, TILE_REACH_MARGIN
from spec.formats import Fixed, SmallFloat
from spec.memory import frame_settings
from spec.records import TILE_BITS, uint

_TILE_PLACES = TILE.bit_length() - 1


def _ordered(x: Value) -> Value:
    """The pattern of a small float as a signed integer with the same order; a negative zero comes before zero."""
    return (x ^ Cat(x[-1].replicate(len(x) - 1), Const(0, 1))).as_signed()


def _larger(a: Value, b: Value) -> Value:
    return Mux(_ordered(a) < _ordered(b), b, a)


def _smaller(a: Value, b: Value) -> Value:
    return Mux(_ordered(a) > _ordered(b), b, a)


def falloff_format(config: AcceleratorConfig) -> Fixed:
    """Format of the tile test's falloff limit, which includes the margin and is positive."""
    n, support = config.formats, tables.support_exponent(config)
    strongest = n.log2_opacity.raw_max - tables.log2_alpha_min(n)
    most = (strongest if support is None else min(strongest, support)) + _raw(TILE_REACH_MARGIN, n.cut)
    return Fixed(max(0, most.bit_length() - n.cut.frac_bits), n.cut.frac_bits, False)


def _raw(x: float, number: Fixed) -> int:
    raw = int(number.quantise(x))
    if raw * 2.0**-number.frac_bits != x:
        raise ValueError(f"{number} must hold {x}, not {raw * 2.0**-number.frac_bits!r}")
    return raw


def _as(x: Value, number: SmallFloat, to: SmallFloat) -> Value:
    """x in another format, which must hold every number of its own."""
    if number.sig_bits > to.sig_bits or number.exp_min < to.exp_min or number.exp_max > to.exp_max:
        raise ValueError(f"{to} must hold every number of the format, not {number!r}")
    fraction, exponent = x[: number.sig_bits - 1], x[number.sig_bits - 1 : -1]
    biased = (exponent + (to.bias - number.bias))[: to.exp_bits] & exponent.any().replicate(to.exp_bits)
    return Cat(Const(0, to.sig_bits - number.sig_bits), fraction, biased, x[-1])


class SplatEllipse(NamedTuple):
    """What the test of a row needs of a splat.

    Attributes:
        mean_x, mean_y: its mean.
        l2, l3: Cholesky factors.
        limit, faint: the falloff limit, and whether the splat is too faint to be visible.
        narrow: 1 / l1.
        rim: how far the ellipse reaches along y.
        steep: y of its leftmost point.
    """

    mean_x: Node
    mean_y: Node
    l2: Node
    l3: Node
    limit: Node
    faint: Node
    narrow: Node
    rim: Node
    steep: Node


class Ellipse:
    """The graph under construction, and the steps from which it is built."""

    def __init__(self, config: AcceleratorConfig) -> None:
        self.config, self.formats, self.g = config, config.formats, Dataflow()
        self.work, self.view = config.formats.work, config.formats.view
        self.heights: dict[Node, tuple[Node, Node]] = {}
        self._wide: dict[Node, Node] = {}

    def wide(self, x: Node) -> Node:
        """x in the `view` format where operators are shared, so that operands of both formats can share one. Results do not
        change."""
        if x.to == self.view or self.config.point_interval == 1:
            return x
        if x not in self._wide:
            number = cast(SmallFloat, x.to)
            self._wide[x] = self.g.view(f"wide_{x.name}", self.view, lambda bits: _as(bits, number, self.view), x)
        return self._wide[x]

    def mul(self, a: Node, b: Node, to: SmallFloat) -> Node:
        """a * b."""
        return self.g.mul(self.wide(a), self.wide(b), to)

    def inverse(self, a: Node) -> Node:
        """1 / a."""
        return self.g.reciprocal(self.wide(a), self.view)

    def limit(self, opacity: Node, other: Node) -> tuple[Node, Node]:
        """The falloff limit of the larger opacity, in the `work` format, and whether that opacity is too faint to be
        visible."""
        g, n, number = self.g, self.formats, falloff_format(self.config)
        faintest, margin = tables.log2_alpha_min(n), _raw(TILE_REACH_MARGIN, n.cut)
        support = tables.support_exponent(self.config)
        most = number.raw_max - margin if support is None else support

        def bounded(x: Value) -> Value:
            return Mux(x[-1], margin, Mux(x > most, most + margin, x + margin))

        strongest = g.logic("strongest", n.log2_opacity, lambda a, b: Mux(a > b, a, b), opacity, other)
        falloff = g.logic("falloff", signed(n.log2_opacity.width + 1), lambda x: x - faintest, strongest)
        limit = g.to_float(g.logic("limit", number, bounded, falloff), self.work)
        return limit, g.logic("faint", 1, lambda x: x[-1], falloff)

    def rows(self, row: Node, mean_y: Node, height: Node) -> tuple[Node, Node]:
        """The y of the row's first and last pixel centres relative to the mean, widened by margins, in the `view` format."""
        g, n = self.g, self.formats
        frac, margin = n.mean2d.frac_bits, _raw(TILE_EDGE_MARGIN, n.mean2d)
        inset = (1 << frac - 1) - margin

        def low(row: Value, mean: Value) -> Value:
            return Cat(Const(0, frac + _TILE_PLACES), row, Const(0, 1)).as_signed() - mean + inset

        def end(row: Value, height: Value) -> Value:
            last = (row + 1) << _TILE_PLACES
            return Mux(last < height, last, height)

        after = g.logic("row_end", height.to, end, row, height)
        high = g.logic("high", n.reach, lambda after, mean: (after << frac) - mean - inset, after, mean_y)
        self.heights[row] = bottom, _ = g.logic("low", n.reach, low, row, mean_y), high
        return g.to_float(bottom, self.view), g.to_float(high, self.view)

    def halves(self, row: Node, mean_y: Node, height: Node, reach: Node) -> tuple[Node, Node]:
        """Whether the ellipse, which reaches to +-`reach` along y, meets the upper and the lower half of the row's tiles, after
        `rows` has been called for the row."""
        g, n, half = self.g, self.formats, TILE // 2
        frac = n.mean2d.frac_bits
        inset = (1 << frac - 1) - _raw(TILE_EDGE_MARGIN, n.mean2d)
        low, high = self.heights[row]

        def end(row: Value, height: Value) -> Value:
            last = (row << _TILE_PLACES) + half
            return Mux(last < height, last, height)

        middle = g.logic("middle", height.to, end, row, height)
        below = g.logic("half_high", n.reach, lambda middle, mean: (middle << frac) - mean - inset, middle, mean_y)
        above = g.logic("half_low", n.reach, lambda low: low + (half << frac), low)
        inside = g.logic("half_inside", 1, lambda row, height: (row << _TILE_PLACES) + half < height, row, height)
        upper = g.logic(
            "upper", 1, lambda low, high, reach: (low <= reach) & ~(high + reach)[-1], low, below, reach)
        lower = g.logic(
            "lower", 1, lambda low, high, reach, inside: (low <= reach) & ~(high + reach)[-1] & inside,
            above, high, reach, inside)
        return upper, lower

    def reach(self, y: Node, narrow: Node, l2: Node, l3: Node, limit: Node) -> Node:
        """The distance from the mean to the ellipse's left edge at height y, which is also that to its right edge at -y."""
        g, work, view = self.g, self.work, self.view
        v = self.mul(l3, y, work)
        u = g.sqrt(g.sub(limit, self.mul(v, v, work), work), work)
        return g.to_fixed(self.mul(g.add(u, self.mul(l2, y, view), view), narrow, view), self.formats.reach)

    def clamped(self, name: str, steep: Node, low: Node, high: Node) -> Node:
        """The height of the ellipse's leftmost (or rightmost) point, limited to the heights low..high of row and ellipse."""
        return self.g.logic(name, self.view, lambda x, low, high: Mux(
            _ordered(x) > _ordered(high), high, _larger(x, low)), steep, low, high)


    def splat(
        self, l1: Node, l2: Node, l3: Node, mean_x: Node, mean_y: Node, opacity: Node, other: Node,
    ) -> SplatEllipse:
        """What does not depend on the row."""
        g, work, view = self.g, self.work, self.view
        limit, faint = self.limit(opacity, other)
        root, rise, narrow = g.sqrt(limit, work), self.inverse(l3), self.inverse(l1)
        squares = g.add(self.mul(l2, l2, work), self.mul(l3, l3, work), work)
        slant = self.mul(self.mul(l2, g.rsqrt(squares, work), work), rise, work)
        rim, steep = self.mul(root, rise, view), self.mul(root, slant, view)
        return SplatEllipse(mean_x, mean_y, l2, l3, limit, faint, narrow, rim, steep)

    def edges(self, s: SplatEllipse, row: Node, height: Node) -> tuple[Node, Node, Node]:
        """The distances from the mean to the left and the right edge in a row, and whether nothing of it is met."""
        g, view = self.g, self.view
        bottom, top = self.rows(row, s.mean_y, height)
        missed = g.logic("missed", 1, lambda low, high, rim, below: (_ordered(low) > _ordered(rim)) | (
            _ordered(high) < _ordered(below)), bottom, top, s.rim, g.negative(s.rim))
        low = g.logic("lowest", view, _larger, bottom, g.negative(s.rim))
        high = g.logic("highest", view, _smaller, top, s.rim)
        left = self.reach(self.clamped("leftmost", s.steep, low, high), s.narrow, s.l2, s.l3, s.limit)
        right = self.reach(
            self.clamped("rightmost", s.steep, g.negative(high), g.negative(low)), s.narrow, s.l2, s.l3, s.limit)
        return left, right, g.logic("hidden", 1, lambda a, b: a | b, s.faint, missed)


def tile_columns(config: AcceleratorConfig) -> Dataflow:
    """The graph of the ellipse test; each slot is one run of tiles.

    Inputs: l1, l2, l3: Cholesky factors of the conic; mean_x, mean_y; row: the tile row; opacity, other_opacity: the larger of
    the two counts.
    Settings: width, height of the frame.
    Outputs: first, last: tile columns, inside the frame; none: high where the ellipse contains no pixel centre of the row.

    The ellipse is u^2 + v^2 <= limit with u = l1 x + l2 y, v = l3 y. Along y it reaches to +-sqrt(limit) / l3. Its leftmost
    point lies at y = sqrt(limit) l2 / (l3 sqrt(l2^2 + l3^2)), its rightmost point opposite. At height y its left edge lies at a
    distance of (u + l2 y) / l1 from the mean, with u = sqrt(limit - v^2).
    """
    e = Ellipse(config)
    g, n = e.g, e.formats
    splat_inputs = _splat_inputs(g, n)
    row = g.input("row", uint(TILE_BITS))
    opacity, other = g.input("opacity", n.log2_opacity), g.input("other_opacity", n.log2_opacity)
    width, height = _size_settings(g, config)
    splat = e.splat(*splat_inputs, opacity, other)
    _columns(g, n.mean2d, width, splat.mean_x, *e.edges(splat, row, height))
    return g


def _splat_inputs(g: Dataflow, n: NumberFormats) -> tuple[Node, Node, Node, Node, Node]:
    """The inputs l1, l2, l3, mean_x and mean_y."""
    l1, l2, l3 = (g.input(name, n.conic) for name in ("l1", "l2", "l3"))
    return l1, l2, l3, g.input("mean_x", n.mean2d), g.input("mean_y", n.mean2d)


def _size_settings(g: Dataflow, config: AcceleratorConfig) -> tuple[Node, Node]:
    """The settings width and height."""
    size = {field.name: field.format for field in frame_settings(config).fields}
    return g.setting("width", size["width"]), g.setting("height", size["height"])


def row_columns(config: AcceleratorConfig, rows: int) -> Dataflow:
    """The graph of the same test for neighbouring rows of tiles, which share all that does not depend on the row. Each slot is
    a splat.

    Inputs: l1, l2, l3, mean_x, mean_y as above; row_0, row_1, ...: the rows; opacity: the opacity in tiles of any level.
    Settings: width, height.
    Outputs: first_0, last_0, none_0, first_1, ...: as above for each of the rows. With streams, columns are those of halves of
    tiles, and upper_0, lower_0, upper_1, ... say whether the ellipse reaches into the upper and the lower half of the row.
    """
    e = Ellipse(config)
    g, n = e.g, e.formats
    splat_inputs = _splat_inputs(g, n)
    at = [g.input(f"row_{i}", uint(TILE_BITS)) for i in range(rows)]
    opacity = g.input("opacity", n.log2_opacity)
    width, height = _size_settings(g, config)
    splat = e.splat(*splat_inputs, opacity, opacity)
    for i, row in enumerate(at):
        _columns(g, n.mean2d, width, splat.mean_x, *e.edges(splat, row, height), suffix=f"_{i}", split=config.split)
    if config.streams > 1:
        reach = g.to_fixed(splat.rim, n.reach)
        for i, row in enumerate(at):
            for name, met in zip(("upper", "lower"), e.halves(row, splat_inputs[-1], height, reach), strict=True):
                g.output(f"{name}_{i}", met)
    return g


def _columns(
    g: Dataflow, mean2d: Fixed, width: Node, mean: Node, left: Node, right: Node, hidden: Node, *, suffix: str = "",
    split: int = 1,
) -> None:
    """Makes the outputs from the distances between the mean and the ellipse's left and right edges. Columns are those of tiles
    divided into `split` parts."""
    places = _TILE_PLACES - (split.bit_length() - 1)
    column = uint(TILE_BITS + split.bit_length() - 1)
    frac, margin, pixel = mean2d.frac_bits, _raw(TILE_EDGE_MARGIN, mean2d), uint(width.to.width)
    half, whole = 1 << frac - 1, mean2d.int_bits + 3  # enough for a signed sum of three such numbers
    first = g.logic("first_pixel", Fixed(whole, 0, True), lambda mean, x: (mean - x + (half - 1 - margin)) >> frac, mean, left)
    last = g.logic("last_pixel", Fixed(whole, 0, True), lambda mean, x: (mean + x - (half - margin)) >> frac, mean, right)
    edge = g.logic("edge", pixel, lambda last, width: Mux(last < width, last, width - 1)[: pixel.width], last, width)
    g.output(f"none{suffix}", g.logic("none", 1, lambda first, last, hidden, width: (
        hidden | (first > last) | (first >= width) | last[-1]), first, last, hidden, width))
    g.output(f"first{suffix}", g.logic("first", column, lambda x: Mux(x[-1], 0, x[places:][: column.width]), first))
    g.output(f"last{suffix}", g.view("last", column, lambda x: x[places:][: column.width], edge))
