"""The chunk test: passes on the headers of chunks that may have a splat with an intersection, and drops the others.

`spec.chunks` defines the test; the graph below does the same operations in the same order.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value, signed, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.chunks.level_bounds import octagon_layout, place_bits
from rtl.culling.dataflow import Dataflow, Node
from rtl.culling.datapath import Datapath
from rtl.culling.frame import COUNTER_BITS, count_items, flatten, setting_ports
from rtl.culling.values import order
from rtl.shapes import layout
from spec.chunks import (
    BOX_SHIFT,
    CENTRE_MARGIN,
    CHUNK,
    COUNT_BITS,
    EXTENT_BITS,
    SCALE_TOP_BITS,
    SCALE_TOP_STEPS,
    STEP_BITS,
    TEST_INTERVAL,
    TESTED_CHUNKS,
    WIDE_SPREAD,
    header_item,
    pad,
    pixel_format,
    sigma_significands,
)
from spec.compact import OPACITY_BITS, STEP_BIAS
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, TILE
from spec.formats import SQ, UQ, Fixed, Rounding, SmallFloat
from spec.records import INDEX_BITS

SETTINGS = ("position", "rotation", "near", "reach", "centre", "width", "height", "gaussians")

_PLACES = TILE.bit_length() - 1


def whole_pixels(config: AcceleratorConfig) -> Fixed:
    """The format of the principal point without its fraction bits."""
    return SQ(config.formats.mean2d.int_bits, 0)


def octagon_names(config: AcceleratorConfig) -> list[str]:
    """The names of the graph's settings that are level bounds, by quality bound, and with joint frames by eye first."""
    return [f"{eye}octagon_{bound}" for eye in ("", *(["target_"] if config.joint else [])) for bound in range(MAX_LEVELS)]


def chunk_graph(config: AcceleratorConfig, *, details: bool = False) -> Dataflow:
    """The graph of whether a chunk is skipped.

    Its settings `rotation`, `near` and `reach` are cut to the format `chunk`, `centre` to whole pixels; `last_tile` has the
    last column and the last row of the frame's tiles, `gaussians` is the model's number of Gaussians, and `octagon_0` and so on
    are the level bounds. In machines with joint frames each slot is the test for one eye: the eye and its position are inputs,
    and `target_octagon_0` and so on are the target's level bounds.

    Args:
        config: the machine.
        details: whether each reason, and the columns and rows of tiles that the chunk can touch, are outputs, too.
    """
    n, g = config.formats, Dataflow(registered=True)
    chunk, tile = n.chunk, unsigned(place_bits(config))
    rotation, near, reach = g.settings("rotation", chunk, 9), g.setting("near", chunk), g.settings("reach", chunk, 2)
    centre, last_tile = g.settings("centre", whole_pixels(config), 2), g.settings("last_tile", UQ(place_bits(config), 0), 2)
    octagons = [g.setting(name, octagon_layout(config)) for name in octagon_names(config)]
    top, bound = g.input("scale_top", unsigned(SCALE_TOP_BITS)), g.input("bound", unsigned(2))
    opacity, count = g.input("opacity", unsigned(OPACITY_BITS)), g.input("count", unsigned(COUNT_BITS))

    low, high = _box(config, g, rotation)
    behind = g.logic("behind", 1, lambda z, near: order(z) <= order(near), high[2], near)
    nearest = g.logic("nearest", chunk, lambda z, near: Mux(order(z) > order(near), z, near), low[2], near)
    q = (g.reciprocal(nearest, chunk), g.reciprocal(high[2], chunk))
    sigma = g.mul(g.logic("sigma", chunk, lambda top: _sigma(config, top), top), q[0], chunk)

    runs, outside = [], []
    for k, name in enumerate("xy"):
        spread = g.mul(reach[k], sigma, chunk)
        left = g.logic(f"left_share_{name}", chunk, lambda x, a, b: Mux(x[-1], a, b), low[k], *q)
        right = g.logic(f"right_share_{name}", chunk, lambda x, a, b: Mux(x[-1], b, a), high[k], *q)
        ends = (g.sub(g.mul(low[k], left, chunk), spread, chunk), g.add(g.mul(high[k], right, chunk), spread, chunk))
        pixels = [g.to_fixed(end, pixel_format(), Rounding.FLOOR) for end in ends]
        begin = _tile(config, g, f"begin_{name}", pixels[0], centre[k], -pad(config))
        end = _tile(config, g, f"end_{name}", pixels[1], centre[k], pad(config) + 2)
        wide = g.logic(f"wide_{name}", 1, lambda spread: _at_least(spread, chunk, WIDE_SPREAD), spread)
        outside.append(g.logic(
            f"outside_{name}", 1, lambda wide, begin, end, last: ~wide & (end[-1] | (begin > last)),
            wide, begin, end, last_tile[k]))
        runs.append((
            g.logic(f"first_{name}", tile, lambda wide, begin: Mux(wide | begin[-1], 0, begin), wide, begin),
            g.logic(f"last_{name}", tile, lambda wide, end, last: Mux(wide | (end > last), last, end),
                    wide, end, last_tile[k])))

    chosen = g.logic("chosen", unsigned(3), Cat, bound, g.input("eye", unsigned(1))) if config.joint else bound
    octagon = g.logic("octagon", octagon_layout(config), lambda chosen, *each: Array(each)[chosen], chosen, *octagons)
    filtered = g.logic("filtered", 1, _filtered, octagon, *_sides(g, tile, runs))
    nothing = g.logic("nothing", 1, lambda opacity, count: ~opacity.any() | ~count.any(), opacity, count)
    after = g.logic("after", unsigned(INDEX_BITS + 1), lambda first, count: first + count,
                    g.input("first", unsigned(INDEX_BITS)), count)
    astray = g.logic("astray", 1, lambda count, after, most: (count > CHUNK) | (after > most), count, after,
                     g.setting("gaussians", UQ(INDEX_BITS, 0)))
    reasons = {"behind": behind, "outside_x": outside[0], "outside_y": outside[1], "filtered": filtered, "nothing": nothing,
               "astray": astray}
    g.output("skipped", g.logic("skipped", 1, lambda *each: Cat(*each).any(), *reasons.values()))
    if details:
        places = {f"{end}_{name}": node for name, run in zip("xy", runs, strict=True)
                  for end, node in zip(("first", "last"), run, strict=True)}
        for name, node in (reasons | places).items():
            g.output(name, node)
    return g


def _box(config: AcceleratorConfig, g: Dataflow, rotation: tuple[Node, ...]) -> tuple[list[Node], list[Node]]:
    """lo and hi of the box along x, y (times the focal lengths) and z of the camera."""
    n, chunk = config.formats, config.formats.chunk
    size = UQ(EXTENT_BITS + 1, 0)
    position = [g.input(f"position_{i}", n.view) for i in range(3)] if config.joint else g.settings("position", n.view, 3)
    shift = STEP_BIAS + 1 - BOX_SHIFT

    def length(name: str, extent: Node, step: Node, more: int) -> Node:
        """(extent + more) * 2^(step - shift): the exponent cannot leave the format."""
        number = g.to_float(g.logic(f"{name}_steps", size, lambda x: x + more, extent), chunk)
        return g.logic(name, chunk, lambda x, step: _scaled(x, chunk, step - shift), number, step)

    centre, margin = [], []
    for i in range(3):
        low, step = g.input(f"low_{i}", n.position), g.input(f"step_{i}", unsigned(STEP_BITS))
        extent = g.input(f"extent_{i}", unsigned(EXTENT_BITS))
        offset = g.view(f"cut_{i}", chunk, lambda x: cut(x, n.view, chunk), g.sub(low, position[i], n.view))
        a = g.add(offset, length(f"half_{i}", extent, step, 1), chunk)
        share = g.logic(f"share_{i}", chunk, lambda x: _share(x, chunk), a)
        centre.append(a)
        margin.append(g.add(length(f"wide_{i}", extent, step, 2), share, chunk))
    lows, highs = [], []
    for k in range(3):
        row = rotation[3 * k : 3 * k + 3]
        magnitudes = tuple(g.view(f"absolute_{x.name}", chunk, lambda x: Cat(x[:-1], Const(0, 1)), x) for x in row)
        v, s = g.dot3(chunk, row, tuple(centre)), g.dot3(chunk, magnitudes, tuple(margin))
        lows.append(g.sub(v, s, chunk))
        highs.append(g.add(v, s, chunk))
    return lows, highs


def cut(x: Value, number: SmallFloat, to: SmallFloat) -> Value:
    """A number rounded towards zero to a format with the same exponents and fewer significand bits."""
    return x[number.sig_bits - to.sig_bits :]


def _scaled(x: Value, number: SmallFloat, places: Value) -> Value:
    """x * 2^places of a positive x, where the exponent stays in its range."""
    low = number.sig_bits - 1
    exponent = x[low : low + number.exp_bits] + places
    return Cat(x[:low], exponent[: number.exp_bits], Const(0, 1))


def _share(x: Value, number: SmallFloat) -> Value:
    """|x| * 2^-CENTRE_MARGIN, or zero where that is below the format's smallest number."""
    low = number.sig_bits - 1
    exponent = x[low : low + number.exp_bits]
    held = exponent > CENTRE_MARGIN
    return Cat(x[:low], (exponent - CENTRE_MARGIN)[: number.exp_bits]) & held.replicate(low + number.exp_bits)


def _sigma(config: AcceleratorConfig, top: Value) -> Value:
    """A chunk's largest standard deviation from `scale_top`."""
    number, bias = config.formats.chunk, config.formats.scale.bias
    low, places = number.sig_bits - 1, SCALE_TOP_STEPS.bit_length() - 1
    fractions = Array(Const(x - (1 << low), low) for x in sigma_significands(config))
    return Cat(fractions[top[:places]], (top[places:] + (number.bias - bias))[: number.exp_bits], Const(0, 1))


def _tile(config: AcceleratorConfig, g: Dataflow, name: str, pixel: Node, centre: Node, margin: int) -> Node:
    """The column or row of tiles of a pixel relative to the principal point, moved by a margin."""
    bits = max(pixel_format().width, whole_pixels(config).width) + 1 - _PLACES + 1
    return g.logic(name, signed(bits), lambda pixel, centre: (pixel + centre + margin) >> _PLACES, pixel, centre)


def _at_least(x: Value, number: SmallFloat, limit: int) -> Value:
    """Whether a positive number is at least a limit, which is a power of two."""
    low = number.sig_bits - 1
    return x[low : low + number.exp_bits] >= number.bias + limit.bit_length() - 1


def _sides(g: Dataflow, tile: unsigned, runs: list[tuple[Node, Node]]) -> list[Node]:
    """Smallest and largest x, y, x + y and x - y of a chunk's box of tiles."""
    (first_x, last_x), (first_y, last_y) = runs
    total, difference = unsigned(tile.width + 1), signed(tile.width + 1)
    return [
        first_x, last_x, first_y, last_y,
        g.logic("least_sum", total, lambda x, y: x + y, first_x, first_y),
        g.logic("most_sum", total, lambda x, y: x + y, last_x, last_y),
        g.logic("least_difference", difference, lambda x, y: x - y, first_x, last_y),
        g.logic("most_difference", difference, lambda x, y: x - y, last_x, first_y)]


def _filtered(octagon: data.View, *sides: Value) -> Value:
    """Whether an octagon has no tile, or lies beside the box with these smallest and largest sides, in the order of the
    octagon's."""
    beside = [Cat(least > octagon.most[side], most < octagon.least[side])
              for side, least, most in zip(octagon.shape().members["least"].members, sides[::2], sides[1::2], strict=True)]
    return ~octagon.present | Cat(*beside).any()


class ChunkTest(wiring.Component):
    """Passes on the headers of chunks that are read. In a joint frame a chunk is tested for one eye after the other, and read
    where either test says so.

    Parameters:
        config: a machine with chunks.

    Ports:
        headers: HeaderItem items; a frame ends with an item with `end`.
        tested: those that are read, in order and unchanged, and every item with `end`.
        position, rotation, near, reach, centre, width, height, gaussians: settings; near is positive.
        bounds: the frame's level bounds (`LevelBounds`); like the settings, they are stable while chunks are tested.
        target_position, joint, target_bounds: with joint frames, further settings, and the level bounds of the target.
        chunks_read, chunks_skipped: number of the frame's chunks that are read, and that were skipped, among those that have
            been tested. The counts stay until the first chunk of the next frame has been tested.

    Throughput: one chunk every TEST_INTERVAL cycles, in joint frames every two of them, read or skipped, while the queue at the
    output has free space. Latency: that of the datapath of `chunk_graph`, 80 cycles, and two of the queue. Storage: the
    datapath's, and a queue of TESTED_CHUNKS items, from which chunks are read while others are tested::

        cycle            0      8      16     ..     80     81     82     ..     88
        headers       < A >  < B >  < C >
        datapath                                  < A >                       < B >    one leaves every 8 cycles
        tested                                                  < A  until it is taken
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.chunks:
            raise ValueError(f"config must be a machine with chunks, not {config.name!r}")
        item = layout(header_item(config))
        bounds, joint = In(data.ArrayLayout(octagon_layout(config), MAX_LEVELS)), ("target_position", "joint") * config.joint
        super().__init__({
            **setting_ports(config, (*SETTINGS, *joint)), "bounds": bounds,
            **({"target_bounds": bounds} if config.joint else {}),
            "headers": In(stream.Signature(item)), "tested": Out(stream.Signature(item)),
            "chunks_read": Out(COUNTER_BITS), "chunks_skipped": Out(COUNTER_BITS)})
        self._config = config
        self.datapath = Datapath(chunk_graph(config), interval=TEST_INTERVAL, carried=item)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.datapath = path = self.datapath
        m.submodules.queue = queue = SyncFIFOBuffered(width=self.tested.payload.shape().size, depth=TESTED_CHUNKS)
        self._settings(m)
        names = ("low", "step", "extent", "scale_top", "opacity", "bound", "count", "first")
        for name, value in flatten({name: self.headers.payload[name] for name in names}).items():
            m.d.comb += path.sink.payload[name].eq(value)
        m.d.comb += [
            path.sink.payload.carried.eq(self.headers.payload),
            path.sink.valid.eq(self.headers.valid), self.headers.ready.eq(path.sink.ready)]
        found = path.source.payload
        read, skipped = self._eyes(m) if self._config.joint else (~found.skipped, found.skipped)
        passes = found.carried.end | read
        m.d.comb += [
            queue.w_en.eq(path.source.valid & passes), queue.w_data.eq(found.carried),
            path.source.ready.eq(queue.w_rdy | ~passes),
            self.tested.valid.eq(queue.r_rdy), self.tested.payload.eq(queue.r_data), queue.r_en.eq(self.tested.ready)]
        count_items(m, path.source.valid & path.source.ready, found.carried.end, (self.chunks_read, read),
                    (self.chunks_skipped, skipped))
        return m

    def _eyes(self, m: Module) -> tuple[Value, Value]:
        """Tests every chunk of a joint frame for both eyes; returns whether the chunk whose test leaves the datapath is to be
        read, and whether it is to be skipped: neither before its last test."""
        path, begins, ends, wanted = self.datapath, Signal(), Signal(), Signal()
        enters, end, found = path.sink.payload, self.headers.payload.end, path.source.payload
        again = self.joint & ~begins & ~end  # the eye that enters is the source, and the target comes next
        m.d.comb += [
            enters.eye.eq(begins), self.headers.ready.eq(path.sink.ready & ~again),
            *(enters[f"position_{i}"].eq(Mux(begins, self.target_position[i], self.position[i])) for i in range(3))]
        with m.If(path.sink.valid & path.sink.ready):
            m.d.sync += begins.eq(again)
        with m.If(path.source.valid & path.source.ready):
            m.d.sync += [ends.eq(self.joint & ~ends & ~found.carried.end), wanted.eq(~found.skipped)]
        last, read = ~self.joint | ends, ~found.skipped | ends & wanted
        return last & read, last & ~read

    def _settings(self, m: Module) -> None:
        """Settings of the datapath. The frame's last tiles are registered: they are stable long before they are used."""
        n, path = self._config.formats, self.datapath
        bounds = [*self.bounds, *(self.target_bounds if self._config.joint else ())]
        m.d.comb += [getattr(path, name).eq(octagon)
                     for name, octagon in zip(octagon_names(self._config), bounds, strict=True)]
        if not self._config.joint:
            for i in range(3):
                m.d.comb += path.position[i].eq(self.position[i])
        for i in range(9):
            m.d.comb += path.rotation[i].eq(cut(self.rotation[i], n.view, n.chunk))
        m.d.comb += [path.near.eq(cut(self.near, n.view, n.chunk)), path.gaussians.eq(self.gaussians)]
        for k, size in enumerate((self.width, self.height)):
            last = Signal(place_bits(self._config), name=f"last_tile_{k}", reset_less=True)
            m.d.sync += last.eq((size - 1) >> _PLACES)
            m.d.comb += [
                path.last_tile[k].eq(last), path.reach[k].eq(cut(self.reach[k], n.view, n.chunk)),
                path.centre[k].eq(self.centre[k] >> n.mean2d.frac_bits)]
