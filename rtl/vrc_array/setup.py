"""The setup unit: turns intersections into pixel ops (docs/array.md).

`polynomial` holds the arithmetic. Around it this unit takes headers and intersections, selects the opacity, colour and cut of
each level, and ends every tile with its background ops.

An intersection that both levels of a blend tile use takes two slots of the pipeline. The second slot brings no data
(`rtl.pipeline`): it finds the polynomial of the first in the registers of every stage, and nothing is multiplied twice::

    cycle            0      1      2      3
    entries      <  A  ><  B  ><  C  ><  C  >     B is used by both levels: C waits for the slot B, 1
    slot         < A,0 >< B,0 >< B,1 >< C,0 >
"""

from __future__ import annotations

from typing import NamedTuple

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.fixed import saturate
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import layout, shape
from rtl.stream import Buffer
from rtl.vrc_array.polynomial import Polynomial, check_formats, polynomial
from spec.config import AcceleratorConfig
from spec.records import array_splat, pixel_op, tile_header
from spec.tables import log2_alpha_min, support_exponent

LATENCY = 15
"""Cycles from an intersection's transfer to its op at the output if nothing waits: 14 stages and the output buffer."""


class _Slot(NamedTuple):
    """What enters the pipeline in a cycle; each field is one bit."""

    valid: Signal
    load: Signal
    level: Signal
    background: Signal
    drain: Signal


class SetupUnit(wiring.Component):
    """Turns the intersections of each tile into pixel ops, and adds the background ops.

    Parameters:
        config: the machine; `levels`, `depth`, `support_sigma` and the formats are used.

    Ports:
        tiles: headers, one per tile; a header is taken together with the last slot of the tile before.
        entries: intersections, as many as each header's count.
        background: colour behind everything; must be stable during a frame.
        stopped: per level bank, whether every pixel of the tile at the input has stopped. Once this holds for all banks that
            the tile uses, its remaining intersections give no op.
        ops: pixel ops in order, whose polynomials are given at the tile's first pixel.
        skipped: strobe; an intersection was taken without an op because of `stopped`.

    Throughput: one slot per cycle. A tile takes one slot for each intersection, one more for each that both levels use, and one
    for the background of each level. An intersection that no level uses, or whose splat cannot touch the tile, gives no op; its
    slot stays empty. Latency: LATENCY.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_formats(config.formats)
        self.config = config
        super().__init__(self._ports())

    def _ports(self) -> dict[str, wiring.Member]:
        config = self.config
        return {
            "tiles": In(stream.Signature(layout(tile_header(config)))),
            "entries": In(stream.Signature(layout(array_splat(config)))),
            "background": In(data.ArrayLayout(shape(config.formats.colour), 3)),
            "stopped": In(config.level_banks),
            "ops": Out(stream.Signature(layout(pixel_op(config)))),
            "skipped": Out(1),
        }

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.buffer = buffer = Buffer(self.ops.payload.shape())
        wiring.connect(m, buffer.source, wiring.flipped(self.ops))
        advance = buffer.sink.ready
        header = self._header()
        slot = self._schedule(m, header, advance)
        p, entry = Pipeline(m, load=slot.load, advance=advance), self.entries.payload
        terms = polynomial(p, self.config.formats, header.tile_x, header.tile_y, entry.mean2d, entry.conic,
                           quarter=self._quarter())
        self._finish(m, p, header, slot, terms, buffer.sink)
        return m

    def _quarter(self) -> Value | None:
        """The quarter of the tile at whose first pixel polynomials are given; None where this is the tile's first pixel."""
        return None

    def _header(self) -> data.View:
        """The register of the tile's header."""
        return Signal(self.tiles.payload.shape(), name="header")

    def _schedule(self, m: Module, header: data.View, advance: Value) -> _Slot:
        """Takes headers and intersections, and decides what slot enters the pipeline."""
        entry, two_levels = self.entries.payload, self.config.level_banks == 2
        busy, second, background_level = Signal(), Signal(), Signal()
        left = Signal.like(header.count)
        blend = header.blend if two_levels else Const(0, 1)
        used = Cat(entry.use[0], entry.use[1] & blend)
        entry_turn, background_turn, skip = Signal(), Signal(), Signal()
        slot = _Slot(*(Signal(name=f"slot_{name}") for name in _Slot._fields))
        m.d.comb += [
            skip.eq(self.stopped[0] & (self.stopped[-1] | ~blend)),
            entry_turn.eq(busy & ~second & left.any()),
            background_turn.eq(busy & ~second & ~left.any()),
            self.entries.ready.eq(entry_turn & (advance | skip)),
            self.skipped.eq(self.entries.valid & entry_turn & skip),
            slot.load.eq(entry_turn & self.entries.valid & used.any() & ~skip),
            slot.valid.eq(slot.load | second | background_turn),
            slot.level.eq(Mux(background_turn, background_level, second | ~used[0]) if two_levels else 0),
            slot.background.eq(background_turn),
            slot.drain.eq(background_turn & (background_level == blend)),
            self.tiles.ready.eq(~busy | slot.drain & advance),
        ]
        with m.If(self.entries.valid & self.entries.ready):
            m.d.sync += left.eq(left - 1)
        if two_levels:
            with m.If(advance):
                m.d.sync += [second.eq(slot.load & used.all()), background_level.eq(background_turn & ~slot.drain)]
        with m.If(self.tiles.ready):
            m.d.sync += busy.eq(self.tiles.valid)
            with m.If(self.tiles.valid):
                m.d.sync += [header.eq(self.tiles.payload), left.eq(self.tiles.payload.count)]
        return slot

    def _finish(self, m: Module, p: Pipeline, header: data.View, slot: _Slot, terms: Polynomial, out: stream.Interface) -> None:
        """Step 7, background and flags: assembles ops from the polynomials."""
        config, n, entry = self.config, self.config.formats, self.entries.payload
        level, background = p.control("level", slot.level), p.control("background", slot.background)

        def of_level(name: str, values: list[Value]) -> Staged:
            pair = [p.reg(f"{name}_{i}", lambda x: x, p.data(name, value)) for i, value in enumerate(values)]
            return p.reg(name, lambda level, a, b: Mux(level, b, a), level, *pair) if config.level_banks == 2 else pair[0]

        opacity = of_level("opacity", [entry.log2_opacity[0], entry.log2_opacity[1]])
        colour = of_level("colour", [Cat(*(entry.colour[3 * i + c] for c in range(3))) for i in range(2)])
        support, cut_min = support_exponent(config), log2_alpha_min(n)
        cut = opacity.map(lambda x: cut_min) if support is None else p.reg(
            "cut", lambda x: saturate(Mux(x >= cut_min + support, x - support, cut_min), n.cut), opacity)
        half_ulp = Const(1 << (n.exponent.frac_bits - n.cut.frac_bits - 1), n.exponent.frac_bits - n.cut.frac_bits)
        exponent = p.reg("exponent", lambda x, o: x + Cat(half_ulp, o).as_signed(), terms.corner, opacity)

        end, op = exponent.stage, out.payload
        valid, drain = p.control("valid", slot.valid).at(end), p.control("drain", slot.drain).at(end)
        level, background = level.at(end), background.at(end)
        m.d.comb += [
            out.valid.eq(valid & (background | terms.kept.at(end))),
            op.bank.eq(level),
            op.last.eq(background),
            op.drain.eq(drain),
            op.outer.eq(background | level | p.data("outer", header.outer).at(end)),
            op.colour.eq(Mux(background, self.background.as_value(), colour.at(end))),
        ]
        if config.depth:
            m.d.comb += op.depth.eq(Mux(background, 0, p.data("depth", entry.depth).at(end)))
        for name, value in (("exponent", exponent), ("cut", cut), *terms._asdict().items()):
            if name not in ("corner", "kept"):
                m.d.comb += op[name].eq(Mux(background, 0, value.at(end)))
        self._mark(m, p, header, slot, level, background, end, out)

    def _mark(self, m: Module, p: Pipeline, header: data.View, slot: _Slot, level: Value, background: Value, end: int,
              out: stream.Interface) -> None:
        """Marks a tile's first op in each bank."""
        started = Signal(self.config.level_banks)
        m.d.comb += out.payload.first.eq(~started.bit_select(level, 1))
        with m.If(out.valid & out.ready):
            m.d.sync += started.bit_select(level, 1).eq(~background)
