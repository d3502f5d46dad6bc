"""Projection: turns a Gaussian in front of the camera into a splat with its conic and the box of tiles that it may touch."""

from __future__ import annotations

from typing import Any, cast

from amaranth.hdl import Cat, Module, Mux, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.dataflow import Dataflow, Node
from rtl.culling.datapath import Datapath
from rtl.culling.eyes import judged_splat
from rtl.culling.frame import COUNTER_BITS, connect_settings, count_items, flatten, setting_ports
from rtl.culling.near import limit_format, survivor_layout
from rtl.culling.saturations import at_limit
from rtl.culling.shared_datapath import DatapathSide, SharedDatapath
from rtl.culling.values import at_least_smallest, clamp, doubled, rescale, widen
from rtl.fixed import as_integer, saturate
from rtl.shapes import layout
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import EXTENT_SHARE, TILE, TILE_EDGE_MARGIN
from spec.formats import SQ, UQ, SmallFloat
from spec.memory import frame_settings
from spec.records import TILE_BITS, projected_splat

SETTINGS = ("rotation", "turn", "centre", "limits", "near", "width", "height")
Triple = tuple[Node, ...]
"""The components of a vector."""


class _Projection:
    """The graph under construction: each method is a step of the arithmetic."""

    def __init__(self, config: AcceleratorConfig) -> None:
        self.config, self.n, self.g = config, config.formats, Dataflow()
        fields = {f.name: f for f in frame_settings(config).fields}
        self.settings: dict[str, Any] = {
            name: self.g.settings(name, fields[name].format, fields[name].count) if fields[name].count > 1 else
            self.g.setting(name, fields[name].format) for name in SETTINGS}

    def build(self) -> Dataflow:
        g, n = self.g, self.n
        offset = tuple(g.input(f"offset_{i}", n.view) for i in range(3))
        z, scale = g.input("z", n.view), [g.input(f"scale_{i}", n.scale) for i in range(3)]
        quat = [g.input(f"quat_{i}", n.quaternion) for i in range(4)]
        limit = g.to_float(g.input("limit", limit_format(n)), n.work)

        inverse = g.reciprocal(z, n.view)
        slopes = [g.mul(g.dot3(n.view, self.row("rotation", i), offset), inverse, n.view) for i in range(2)]
        rows = [self.jacobian_row(i, slope) for i, slope in enumerate(slopes)]
        near = self.narrow("near_inverse", inverse)
        axes = [self.splatted_axis(rows, column, length, near) for column, length in zip(
            self.rotation_columns(quat), scale, strict=True)]
        variances = self.conic(axes)
        means = [self.pixels(i, slope) for i, slope in enumerate(slopes)]
        for i, (mean, variance) in enumerate(zip(means, variances, strict=True)):
            self.box(i, mean, g.mul(variance, limit, n.work))
        g.output("beyond", g.logic("beyond", 1, lambda x, y: at_limit(x, n.mean2d) | at_limit(y, n.mean2d), *means))
        g.output("depth_key", g.logic("depth_key", n.depth_key, self.depth_key, z, self.settings["near"]))
        return g

    def row(self, name: str, i: int) -> Triple:
        """Row i of a setting that is a 3x3 matrix."""
        return self.settings[name][3 * i : 3 * i + 3]

    def narrow(self, name: str, x: Node) -> Node:
        """x in the `work` format."""
        number = cast(SmallFloat, x.to)
        return self.g.logic(name, self.n.work, lambda let, v: rescale(let, v, number, self.n.work), x, lets=True)

    def jacobian_row(self, i: int, slope: Node) -> Triple:
        """Row i of z J R, where J is the Jacobian of the projection and R the rotation from world to camera."""
        g, work = self.g, self.n.work
        low, high = self.settings["limits"][2 * i : 2 * i + 2]
        held = self.narrow(f"slope_{i}", g.logic(f"clamped_{i}", self.n.view, clamp, slope, low, high))
        return tuple(g.sub(along, g.mul(held, forward, work), work) for along, forward in zip(
            self.row("turn", i), self.row("turn", 2), strict=True))

    def rotation_columns(self, quat: list[Node]) -> tuple[Triple, Triple, Triple]:
        """The columns of the rotation matrix of a quaternion."""
        g, work = self.g, self.n.work
        one = g.constant(1.0, work)
        w, x, y, z = (g.to_float(q, work) for q in quat)
        x2, y2, z2 = (g.logic("twice", work, lambda v: doubled(v, work), q) for q in (x, y, z))
        xx, xy, xz, wx = (g.mul(x2, q, work) for q in (x, y, z, w))
        yy, yz, wy = (g.mul(y2, q, work) for q in (y, z, w))
        zz, wz = (g.mul(z2, q, work) for q in (z, w))

        def rest(a: Node, b: Node) -> Node:
            return g.sub(one, g.add(a, b, work), work)

        return ((rest(yy, zz), g.add(xy, wz, work), g.sub(xz, wy, work)),
                (g.sub(xy, wz, work), rest(xx, zz), g.add(yz, wx, work)),
                (g.add(xz, wy, work), g.sub(yz, wx, work), rest(xx, yy)))

    def splatted_axis(self, rows: list[Triple], column: Triple, scale: Node, near: Node) -> tuple[Node, ...]:
        """The x and y component, on the image plane, of one scaled axis of the ellipsoid."""
        g, work = self.g, self.n.work
        if self.config.point_interval != 1:  # shared operators need operands of one format
            scale = g.view("length", work, lambda v: widen(v, self.n.scale, work), scale)
        length = g.mul(scale, near, work)
        return tuple(g.mul(g.dot3(work, row, column), length, work) for row in rows)

    def conic(self, axes: list[tuple[Node, ...]]) -> tuple[Node, Node]:
        """Outputs the Cholesky factors of the conic. Returns the variances along x and y, including the low-pass."""
        g, work, to = self.g, self.n.work, self.n.conic
        p, t = zip(*axes, strict=True)
        low_pass = g.constant(tables.scaled_low_pass(self.n), work)
        bare_xx, bare_yy, cov_xy = g.dot3(work, p, p), g.dot3(work, t, t), g.dot3(work, p, t)
        cov_xx, cov_yy = g.add(bare_xx, low_pass, work), g.add(bare_yy, low_pass, work)
        minors = tuple(g.sub(g.mul(p[i], t[j], work), g.mul(p[j], t[i], work), work) for i, j in ((0, 1), (0, 2), (1, 2)))
        det = g.add(g.dot3(work, minors, minors), g.mul(low_pass, g.add(bare_xx, cov_yy, work), work), work)
        root_yy = g.rsqrt(cov_yy, work)
        factor = g.mul(root_yy, g.rsqrt(det, work), work)

        def narrowed(i: int, x: Node) -> Node:
            return g.logic(f"narrow_l{i + 1}", to, lambda let, v: rescale(let, v, work, to, negate=i == 1), x, lets=True)

        def positive(x: Value) -> Value:
            return at_least_smallest(x, to)

        # The conversion is registered before the output, because outputs are written to a memory, whose inputs need time.
        for i, x in enumerate((g.mul(cov_yy, factor, work), g.mul(cov_xy, factor, work), root_yy)):
            g.output(f"conic_{i}", g.logic(f"l{i + 1}", to, (lambda x: x) if i == 1 else positive, narrowed(i, x)))
        return cov_xx, cov_yy

    def pixels(self, i: int, slope: Node) -> Node:
        """Outputs one coordinate of the projected mean: the slope, in fixed point with one more bit, plus the principal
        point."""
        g, to = self.g, self.n.mean2d
        raw = g.to_fixed(slope, SQ(to.int_bits + 1, to.frac_bits))
        mean = g.logic(
            f"mean2d_{i}", to, lambda let, x, c: saturate(let("total", x + c), to), raw, self.settings["centre"][i], lets=True)
        g.output(f"mean2d_{i}", mean)
        return mean

    def box(self, i: int, mean: Node, square: Node) -> None:
        """Outputs the first and the last tile along one axis, and whether the splat touches no tile of the frame there."""
        g, to = self.g, self.n.mean2d
        size, frac = self.settings[("width", "height")[i]], to.frac_bits
        margin, half, axis = int(to.quantise(TILE_EDGE_MARGIN)), 1 << (frac - 1), "xy"[i]
        raw = g.to_fixed(g.sqrt(square, self.n.extent), UQ(to.int_bits + 1, frac))
        extent = g.logic(f"extent_{axis}", raw.width + 1, lambda x: x + (x >> EXTENT_SHARE) + margin, raw)
        first = g.logic(f"first_pixel_{axis}", SQ(to.int_bits + 3, 0), lambda m, e: (
            m - as_integer(e) + (half - 1)) >> frac, mean, extent)
        last = g.logic(f"last_pixel_{axis}", SQ(to.int_bits + 3, 0), lambda m, e: (
            m + as_integer(e) - half) >> frac, mean, extent)
        # Where an end of the interval lies off the frame, the frame's edge replaces it.
        edge = g.logic(f"edge_{axis}", size.to, lambda size: size - 1, size)
        shift = TILE.bit_length() - 1
        ends = g.logic(f"tiles_{axis}", 2 * TILE_BITS + 1, lambda first, last, edge: Cat(
            (Mux(first < 0, 0, first) >> shift)[:TILE_BITS], (Mux(last > edge, edge, last) >> shift)[:TILE_BITS],
            (first > last) | (first > edge) | (last < 0)), first, last, edge)
        for name, low in (("first", 0), ("last", TILE_BITS)):
            g.output(f"{name}_{axis}", g.view(name, TILE_BITS, lambda x, low=low: x[low : low + TILE_BITS], ends))
        g.output(f"outside_{axis}", g.view("outside", 1, lambda x: x[-1], ends))

    def depth_key(self, z: Value, near: Value) -> Value:
        """The number of ulps between the near plane and z, saturating."""
        ulps, largest = z[:-1] - near[:-1], self.n.depth_key.raw_max
        return Mux(ulps > largest, largest, ulps)


def projection_graph(config: AcceleratorConfig) -> Dataflow:
    """The graph of a splat's mean, conic, sort key and box."""
    return _Projection(config).build()


def _carried(config: AcceleratorConfig) -> data.StructLayout:
    """What passes beside projection."""
    survivor = survivor_layout(config)
    return data.StructLayout({
        name: survivor[name].shape for name in ("index", "bound", "log2_opacity", "offset", "depth", "end", *(
            ("eye", "behind", "faint") if config.joint else ()), *(("alone",) if config.warps_joint else ()))})


def projection_shared(config: AcceleratorConfig) -> SharedDatapath:
    """The datapath of the projections of both phases, in machines whose phases overlap."""
    return SharedDatapath(projection_graph(config), interval=config.point_interval, carried=_carried(config))


class Projection(wiring.Component):
    """Turns survivors of the near test into splats, and drops splats whose box lies outside the frame or whose mean lies beyond
    the guard band (`spec.guard_band`). In machines with joint frames it drops none and gives the tests' results.

    Parameters:
        config: the machine; a Gaussian enters every `point_interval` cycles.
        side: this unit's side of a datapath that it shares; None where it has its own.

    Ports:
        sink: `survivor_layout` items; a frame ends with an item with `end`.
        source: ProjectedSplat items, in order, and every item with `end`, whose other fields are 0; in machines with joint
            frames `judged_splat` items.
        rotation, turn, centre, limits, near, width, height: settings; near and the sizes are positive, and the lower of two
            limits comes first.
        culled_outside: number of the frame's Gaussians that were culled here, among those that have left the unit. The count
            stays until the first item of the next frame leaves.
        saturated_means: the same of those whose box meets the frame: they were culled because of their mean alone. Machines
            with joint frames have no counts here.

    Throughput: one Gaussian every `point_interval` cycles, culled or not. Latency and storage: those of the datapath of
    `projection_graph`.
    """

    def __init__(self, config: AcceleratorConfig, side: DatapathSide | None = None) -> None:
        self._splat, self._joint = layout(projected_splat(config)), config.joint
        super().__init__({
            **setting_ports(config, SETTINGS),
            "sink": In(stream.Signature(survivor_layout(config))),
            "source": Out(stream.Signature(judged_splat(config) if config.joint else self._splat)),
            **({} if config.joint else {"culled_outside": Out(COUNTER_BITS), "saturated_means": Out(COUNTER_BITS)})})
        self._carried = _carried(config)
        self.datapath = side or Datapath(projection_graph(config), interval=config.point_interval, carried=self._carried)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        path = self.datapath
        if isinstance(path, Datapath):
            m.submodules.datapath = path
        connect_settings(m, self, path)
        point, entry = self.sink.payload, path.sink.payload
        found, splat = path.source.payload, self.source.payload.splat if self._joint else self.source.payload
        computed = {name: point[name] for name in ("offset", "z", "scale", "quat", "limit")}
        for name, value in flatten(computed).items():
            m.d.comb += entry[name].eq(value)
        end, boxed = found.carried.end, ~(found.outside_x | found.outside_y)
        inside = boxed & ~found.beyond
        passes = end | inside
        for name, _ in self._carried:
            m.d.comb += entry.carried[name].eq(point[name])
        with m.If(~end):  # the other fields of an item with `end` are 0
            for name, _ in self._carried:
                if name in self._splat.members:
                    m.d.comb += splat[name].eq(found.carried[name])
            others = {name: splat[name] for name, _ in self._splat
                      if name not in self._carried.members and name not in ("none", "wanted")}
            for name, value in flatten(others).items():
                m.d.comb += value.eq(found[name])
        m.d.comb += [
            splat.end.eq(end),
            path.sink.valid.eq(self.sink.valid), self.sink.ready.eq(path.sink.ready)]
        if self._joint:
            judged = self.source.payload
            with m.If(~end):
                m.d.comb += [judged.behind.eq(found.carried.behind), judged.faint.eq(found.carried.faint),
                             judged.unboxed.eq(~boxed), judged.beyond.eq(found.beyond)]
            m.d.comb += [self.source.valid.eq(path.source.valid), path.source.ready.eq(self.source.ready)]
            return m
        m.d.comb += [
            self.source.valid.eq(path.source.valid & passes), path.source.ready.eq(self.source.ready | ~passes)]
        count_items(m, path.source.valid & path.source.ready, end, (self.culled_outside, ~inside),
                    (self.saturated_means, boxed & found.beyond))
        return m
