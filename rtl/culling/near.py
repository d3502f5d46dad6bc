"""The near test: computes the offset of every Gaussian from the camera and its depth, and culls Gaussians that lie at or before
the near plane or are too faint."""

from __future__ import annotations

from functools import reduce

from amaranth.hdl import Module, Mux, ShapeLike, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.dataflow import Dataflow
from rtl.culling.datapath import Datapath
from rtl.culling.frame import COUNTER_BITS, connect_settings, count_items, flatten, setting_ports
from rtl.culling.shared_datapath import DatapathSide, SharedDatapath
from rtl.culling.values import order
from rtl.fixed import as_integer
from rtl.shapes import layout, shape
from spec import tables
from spec.config import AcceleratorConfig, NumberFormats
from spec.constants import MAX_LEVELS, TILE_REACH_MARGIN
from spec.formats import UQ, Fixed
from spec.joint import eye_point
from spec.records import Record, gaussian_point, opacities_carried

_SETTINGS = ("position", "rotation", "near", "depth_scale")


def settings(config: AcceleratorConfig) -> tuple[str, ...]:
    """The settings of the near test; in machines with joint frames every Gaussian brings its position."""
    return _SETTINGS[1:] if config.joint else _SETTINGS


def point_record(config: AcceleratorConfig) -> Record:
    """What the near test takes."""
    return eye_point(config) if config.joint else gaussian_point(config)


def limit_format(formats: NumberFormats) -> Fixed:
    """Format of the falloff limit: log2 of the largest opacity over the faintest visible one, plus the margin."""
    return UQ(formats.log2_opacity.int_bits + 1, formats.log2_opacity.frac_bits)


def near_graph(config: AcceleratorConfig) -> Dataflow:
    """The graph of a Gaussian's offset, depth and falloff limit, and of whether it is at or before the near plane or too
    faint."""
    n, g = config.formats, Dataflow()
    view = n.view
    position = tuple(g.input(f"position_{i}", view) for i in range(3)) if config.joint else g.settings("position", view, 3)
    rotation = g.settings("rotation", view, 9)
    near, depth_scale = g.setting("near", view), g.setting("depth_scale", view)
    mean, alone = [g.input(f"mean_{i}", n.position) for i in range(3)], opacities_carried(config) == 1
    names = ["log2_opacity"] if alone else [f"log2_opacity_{i}" for i in range(MAX_LEVELS)]
    opacity = [g.input(name, n.log2_opacity) for name in names]
    bound = [] if alone else [g.input("bound", unsigned(2))]

    offset = tuple(g.sub(a, b, view) for a, b in zip(mean, position, strict=True))
    z = g.dot3(view, rotation[6:], offset)
    strongest = opacity[0] if alone else g.logic("strongest", n.log2_opacity, _strongest, *bound, *opacity)
    faintest, widest = tables.log2_alpha_min(n), tables.support_exponent(config)
    room = g.logic("room", n.log2_opacity.width + 1, lambda x: as_integer(x) - faintest, strongest)

    def limit(room: Value) -> Value:
        reach = room[:-1] if widest is None else Mux(room > widest, widest, room)
        return reach + int(n.log2_opacity.quantise(TILE_REACH_MARGIN))

    for i, number in enumerate(offset):
        g.output(f"offset_{i}", number)
    g.output("z", z)
    g.output("depth", g.to_fixed(g.mul(z, depth_scale, view), n.depth))
    g.output("limit", g.logic("limit", limit_format(n), limit, room))
    g.output("behind", g.logic("behind", 1, lambda z, near: order(z) <= order(near), z, near))
    g.output("faint", g.logic("faint", 1, lambda x: as_integer(x) < faintest, strongest))
    return g


def _strongest(bound: Value, *opacity: Value) -> Value:
    """The largest opacity of the levels that use the Gaussian."""
    used = [opacity[0], *(Mux(bound >= level, x, opacity[0]) for level, x in enumerate(opacity) if level)]
    pairs = [Mux(a > b, a, b) for a, b in zip(used[::2], used[1::2], strict=True)]
    return reduce(lambda a, b: Mux(a > b, a, b), pairs)


def survivor_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A Gaussian that passed the near test: the rest of its record, and the results of the near test. In machines with joint
    frames all Gaussians pass, and these are the tests, too."""
    n = config.formats
    tests: dict[str, ShapeLike] = {"behind": 1, "faint": 1} if config.joint else {}
    return data.StructLayout({
        **_kept(config), **tests, "offset": data.ArrayLayout(shape(n.view), 3), "z": shape(n.view), "depth": shape(n.depth),
        "limit": shape(limit_format(n))})


def _kept(config: AcceleratorConfig) -> dict[str, ShapeLike]:
    """What passes beside the near test."""
    return {name: field.shape for name, field in layout(point_record(config)) if name not in ("mean", "position")}


def near_shared(config: AcceleratorConfig) -> SharedDatapath:
    """The datapath of the near tests of both phases, in machines whose phases overlap."""
    return SharedDatapath(near_graph(config), interval=config.point_interval, carried=data.StructLayout(_kept(config)))


class NearTest(wiring.Component):
    """Passes on the Gaussians that may be visible, and drops the others. In machines with joint frames it passes on all of
    them, with the tests' results, because what becomes of a Gaussian depends on both eyes (`rtl.culling.eyes`).

    Parameters:
        config: the machine; a Gaussian enters every `point_interval` cycles.
        side: this unit's side of a datapath that it shares; None where it has its own.

    Ports:
        sink: GaussianPoint items, in machines with joint frames EyePoint items; a frame ends with an item with `end`.
        source: `survivor_layout` items of the Gaussians that pass, in order, and every item with `end`.
        position, rotation, near, depth_scale: settings; near is positive. Machines with joint frames have no `position` and
            no counts here.
        culled_near, culled_faint: number of the frame's Gaussians that were culled for each reason, among those that have left
            the test. The counts stay until the first Gaussian of the next frame leaves. A Gaussian that is culled for both
            reasons counts as near.

    Throughput: one Gaussian every `point_interval` cycles, culled or not. Latency and storage: those of the datapath of
    `near_graph`.
    """

    def __init__(self, config: AcceleratorConfig, side: DatapathSide | None = None) -> None:
        super().__init__({
            **setting_ports(config, settings(config)),
            "sink": In(stream.Signature(layout(point_record(config)))),
            "source": Out(stream.Signature(survivor_layout(config))),
            **({} if config.joint else {"culled_near": Out(COUNTER_BITS), "culled_faint": Out(COUNTER_BITS)})})
        self._joint, self._carried = config.joint, data.StructLayout(_kept(config))
        self.datapath = side or Datapath(near_graph(config), interval=config.point_interval, carried=self._carried)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        path = self.datapath
        if isinstance(path, Datapath):
            m.submodules.datapath = path
        connect_settings(m, self, path)
        point, entry = self.sink.payload, path.sink.payload
        found, left = path.source.payload, self.source.payload
        inputs = flatten({"mean": point.mean, "log2_opacity": point.log2_opacity, "bound": point.bound,
                          **({"position": point.position} if self._joint else {})})
        m.d.comb += [entry[name].eq(value) for name, value in inputs.items() if name in entry.shape().members]
        for name, _ in self._carried:
            m.d.comb += [entry.carried[name].eq(point[name]), left[name].eq(found.carried[name])]
        for name, value in flatten({name: left[name] for name in ("offset", "z", "depth", "limit")}).items():
            m.d.comb += value.eq(found[name])
        end = found.carried.end
        if self._joint:
            m.d.comb += [
                left.behind.eq(found.behind), left.faint.eq(found.faint),
                path.sink.valid.eq(self.sink.valid), self.sink.ready.eq(path.sink.ready),
                self.source.valid.eq(path.source.valid), path.source.ready.eq(self.source.ready)]
            return m
        passes = end | ~(found.behind | found.faint)
        m.d.comb += [
            path.sink.valid.eq(self.sink.valid), self.sink.ready.eq(path.sink.ready),
            self.source.valid.eq(path.source.valid & passes), path.source.ready.eq(self.source.ready | ~passes)]
        count_items(
            m, path.source.valid & path.source.ready, end, (self.culled_near, found.behind),
            (self.culled_faint, found.faint & ~found.behind))
        return m
