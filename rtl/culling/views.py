"""Rounds sums to colours, and writes splat records to memory."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, ShapeLike, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.colour_sum import colour_sum_layout
from rtl.fixed import round_shift, saturate
from rtl.select import select
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import sum_format
from spec.memory import BEAT_BITS, WORDS, splat_record, write_request


class RecordWriter(wiring.Component):
    """Writes one splat record (SplatRecord), which is one beat, for every level at which a splat has an intersection.

    Parameters:
        config: the machine.
        carried: layout of the data that is carried with the sums: the fields of SurvivingSplat without `offset` and `end`.

    Ports:
        sums: `colour_sum_layout` items; each is taken with the splat's last beat, or at once where it has no level. The
            producer must leave at least one cycle without an offer between two splats. In the last such cycle `carried` must
            already be that of the next splat, because its levels are read there.
        writes: writes in the order of the splats, lowest level first. Level L of splat i lies at beat
            views_base + (i << view_shift) + L.
        views_base, view_shift: settings of the frame.

    Throughput: one beat per cycle. Latency: 1 cycle.
    """

    def __init__(self, config: AcceleratorConfig, *, carried: ShapeLike) -> None:
        self.config = config
        super().__init__({
            "sums": In(stream.Signature(colour_sum_layout(config, carried))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "views_base": In(BEAT_BITS),
            "view_shift": In(2),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sums, request, splat = self.sums, self.writes.payload, self.sums.payload.carried
        left, following, lowest, free = Signal(MAX_LEVELS), Signal(MAX_LEVELS), Signal(MAX_LEVELS), Signal()
        level, above = Signal(MAX_LEVELS), Signal(MAX_LEVELS)  # one-hot: the next beat's level, and the one above if any
        m.d.comb += [
            free.eq(~self.writes.valid | self.writes.ready),
            following.eq(Mux(sums.valid, left & ~level, splat.levels)),
            lowest.eq(Cat(following[i] & ~following[:i].any() for i in range(MAX_LEVELS))),
            sums.ready.eq(~left.any() | free & ~(left & ~level).any()),
        ]
        with m.If(~sums.valid | free):
            m.d.sync += [left.eq(following), level.eq(lowest), above.eq(Cat(Const(0, 1), lowest[:-2], lowest[-2:].any()))]
        with m.If(free):
            m.d.sync += self.writes.valid.eq(sums.valid & left.any())
        with m.If(sums.valid & free & left.any()):
            number = Cat(level[1] | level[3], level[2] | level[3])
            m.d.sync += [
                request.beat.eq(self.views_base + (splat.index << self.view_shift) + number),
                request.word.as_value().eq(self._view(level, above).as_value()),
                request.strobe.eq((1 << WORDS) - 1),
            ]
        return m

    def _view(self, *both: Value) -> data.View:
        """The splat record for a level and the one above, both one-hot."""
        splat, of = self.sums.payload.carried, layout(splat_record(self.config))
        values = {name: getattr(splat, name) for name in ("mean2d", "conic", "depth", "bound")}
        opacity = [splat.log2_opacity[i].as_unsigned() for i in range(MAX_LEVELS)]
        values["log2_opacity"] = Cat(select(at, opacity) for at in both)
        values["colour"] = Cat(self._colour(c, at) for at in both for c in range(3))
        return data.View(of, Cat(Value.cast(values[name]) for name, _ in of))

    def _colour(self, channel: int, level: Value) -> Value:
        """The colour of a channel at a level."""
        sums = self.sums.payload
        base = select(level, [sums.dc[3 * i + channel].as_unsigned() for i in range(MAX_LEVELS)]).as_signed()
        return rounded_colour(self.config, sums.total[channel], base)


def rounded_colour(config: AcceleratorConfig, total: Value, base: Value) -> Value:
    """The sum plus the base colour, rounded and saturated once."""
    n, frac = config.formats, sum_format(config.formats).frac_bits
    return saturate(round_shift(total + (base << frac - n.sh_dc.frac_bits), frac - n.colour.frac_bits), n.colour)
