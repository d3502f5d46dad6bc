"""Decodes the levels of compact records, rounds sums to colours, and writes splat records to memory."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.chunks.decode_colour import base_colour, opacity
from rtl.culling.compact_sum import compact_sum_layout
from rtl.culling.views import rounded_colour
from rtl.select import select
from rtl.shapes import layout, shape
from spec.compact import COARSE_BOUND, OPACITY_BITS, dc_bits, levels_held
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import sum_format
from spec.memory import BEAT_BITS, WORDS, splat_record, write_request

_UNCHANGED = ("mean2d", "conic", "depth", "bound")


class CompactRecordWriter(wiring.Component):
    """Writes one splat record (SplatRecord), which is one beat, for every level at which a splat has an intersection.

        sums --> codes of a level and of the one above, decoded --> base colours added, rounded --> writes

    Parameters:
        config: the machine, with compact records.
        carried: layout of the data that is carried with the sums: index, bound, levels and what the record takes unchanged.

    Ports:
        sums: `compact_sum_layout` items; each is taken with the splat's last level, or at once where it has no level.
        writes: writes in the order of the splats, lowest level first. Level L of splat i lies at beat
            views_base + (i << view_shift) + L.
        views_base, view_shift: settings of the frame.
        busy: a record is inside that `writes` does not offer yet.

    Throughput: one beat per cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig, *, carried: data.StructLayout) -> None:
        self.config = config
        super().__init__({
            "sums": In(stream.Signature(compact_sum_layout(config, carried))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "views_base": In(BEAT_BITS),
            "view_shift": In(2),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        n, sums, splat = self.config.formats, self.sums, self.sums.payload.carried
        done, rest, level, above = (Signal(MAX_LEVELS, name=name) for name in ("done", "rest", "level", "above"))
        free, moves, last = Signal(), Signal(), Signal()
        coarse, dc_range = splat.bound == COARSE_BOUND, sums.payload.codes.dc_range
        held = Signal(data.StructLayout({
            "beat": BEAT_BITS, "total": data.ArrayLayout(shape(sum_format(n)), 3),
            "dc": data.ArrayLayout(shape(n.sh_dc), 6), "log2_opacity": data.ArrayLayout(shape(n.log2_opacity), 2),
            **{name: splat[name].shape() for name in _UNCHANGED}}), reset_less=True)
        m.d.comb += [
            rest.eq(splat.levels & ~done),
            level.eq(Cat(rest[i] & ~rest[:i].any() for i in range(MAX_LEVELS))),  # one-hot: the lowest that is left
            above.eq(Cat(Const(0, 1), level[:-2], level[-2:].any())),  # the level above, if any
            last.eq(~(rest & ~level).any()),
            free.eq(~self.writes.valid | self.writes.ready),
            moves.eq(~self.busy | free),
            sums.ready.eq(~rest.any() | moves & last),
        ]
        opacities, colours = level_codes(m, sums.payload.codes, coarse, level, above)
        with m.If(moves):
            m.d.sync += self.busy.eq(sums.valid & rest.any())
        with m.If(moves & sums.valid & rest.any()):
            number = Cat(level[1] | level[3], level[2] | level[3])
            m.d.sync += [
                done.eq(done | level), held.beat.eq(self.views_base + (splat.index << self.view_shift) + number),
                held.total.eq(sums.payload.total), *(held[name].eq(splat[name]) for name in _UNCHANGED)]
            m.d.sync += [held.log2_opacity[i].eq(opacity(self.config, code)) for i, code in enumerate(opacities)]
            m.d.sync += [held.dc[i].eq(base_colour(self.config, code, coarse, dc_range)) for i, code in enumerate(colours)]
        with m.If(sums.valid & sums.ready):
            m.d.sync += done.eq(0)
        with m.If(free):
            m.d.sync += self.writes.valid.eq(self.busy)
        with m.If(free & self.busy):
            m.d.sync += [
                self.writes.payload.beat.eq(held.beat), self.writes.payload.strobe.eq((1 << WORDS) - 1),
                self.writes.payload.word.as_value().eq(self._record(held))]
        return m

    def _record(self, held: data.View) -> Value:
        """The splat record."""
        values = {name: Value.cast(held[name]) for name in (*_UNCHANGED, "log2_opacity")}
        values["colour"] = Cat(
            rounded_colour(self.config, held.total[i % 3], held.dc[i]) for i in range(6))
        return Cat(values[name] for name, _ in layout(splat_record(self.config)))


def level_codes(m: Module, codes: data.View, coarse: Value, *both: Value) -> tuple[list[Signal], list[Signal]]:
    """The codes of the opacities and of the base colours, r, g, b, of a level and of the one above, both one-hot.

    `codes` are the splat's (`rtl.culling.compact_sum.codes_layout`); `coarse` is high where it has a coarse record.
    """
    opacities = [Signal(OPACITY_BITS, name=f"opacity_code_{i}") for i in range(2)]
    colours = [Signal(dc_bits(False), name=f"dc_code_{i}") for i in range(6)]
    for i, at in enumerate(both):
        places = Cat(at & coarse.replicate(MAX_LEVELS), Cat(at[0], at[1], at[2:].any()) & (~coarse).replicate(3))
        m.d.comb += opacities[i].eq(_chosen(places, codes.opacity, 0, 1, (OPACITY_BITS, OPACITY_BITS)))
        for c in range(3):
            m.d.comb += colours[3 * i + c].eq(_chosen(places, codes.dc, c, 3, (dc_bits(True), dc_bits(False))))
    return opacities, colours


def _chosen(places: Value, codes: Value, first: int, step: int, bits: tuple[int, int]) -> Value:
    """The code of the level at which `places` is set: a bit for each level of a coarse record, then for each of a fine one.

    A level's codes lie `step` apart from those of the next, and have so many bits in a coarse and in a fine record.
    """
    choices = []
    for width, coarse in zip(bits, (True, False), strict=True):
        choices += [codes[k * width : (k + 1) * width] for k in range(first, levels_held(coarse) * step, step)]
    return select(places, choices)
