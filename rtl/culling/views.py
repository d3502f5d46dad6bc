"""Sums to colours, and views of splats into memory."""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Mux, ShapeLike, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.colour_sum import colour_sum_layout
from rtl.fixed import round_shift, saturate
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import sum_format
from spec.memory import BEAT_BITS, WORDS, splat_view, write_request


class ViewWriter(wiring.Component):
    """One SplatView beat for every level that a splat has entries at, lowest level first.

    Parameters:
        config: the machine.
        carried: layout of what the sums carry: the fields of SurvivingSplat but `offset` and `end`.

    Ports:
        sums: `colour_sum_layout`; taken with the splat's last beat, or at once where it has no level.
        writes: of level L of splat i at beat views_base + (i << view_shift) + L.
        views_base, view_shift: settings of the frame.

    Throughput: a beat a cycle. Latency: 1.
    """

    def __init__(self, config: AcceleratorConfig, *, carried: ShapeLike) -> None:
        self.config = config
        super().__init__({
            "sums": In(stream.Signature(colour_sum_layout(config, carried))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "views_base": In(BEAT_BITS),
            "view_shift": In(2),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        sums, request, splat = self.sums, self.writes.payload, self.sums.payload.carried
        written, left, level, free = Signal(MAX_LEVELS), Signal(MAX_LEVELS), Signal(range(MAX_LEVELS)), Signal()
        chosen = left & (~left + 1)[:MAX_LEVELS]
        m.d.comb += [
            free.eq(~self.writes.valid | self.writes.ready),
            left.eq(splat.levels & ~written),
            sums.ready.eq((left == 0) | free & (left == chosen)),
        ]
        for i in reversed(range(MAX_LEVELS)):
            with m.If(left[i]):
                m.d.comb += level.eq(i)
        with m.If(free):
            m.d.sync += self.writes.valid.eq(sums.valid & left.any())
        with m.If(sums.valid & free & left.any()):
            m.d.sync += [
                written.eq(Mux(left == chosen, 0, written | chosen)),
                request.beat.eq(self.views_base + (splat.index << self.view_shift) + level),
                request.word.as_value().eq(self._view(level).as_value()),
                request.strobe.eq((1 << WORDS) - 1),
            ]
        return m

    def _view(self, level: Signal) -> data.View:
        """The view at a level."""
        splat, of = self.sums.payload.carried, layout(splat_view(self.config))
        both = level, Mux(level == MAX_LEVELS - 1, level, level + 1)
        opacity = Array(splat.log2_opacity[i] for i in range(MAX_LEVELS))
        values = {name: getattr(splat, name) for name in ("mean2d", "conic", "depth", "bound")}
        values["log2_opacity"] = Cat(opacity[at].as_unsigned() for at in both)
        values["colour"] = Cat(self._colour(c, at) for at in both for c in range(3))
        return data.View(of, Cat(Value.cast(values[name]) for name, _ in of))

    def _colour(self, channel: int, level: Value) -> Value:
        """Sum and base colour, rounded and saturated once."""
        n, sums = self.config.formats, self.sums.payload
        frac = sum_format(n).frac_bits
        base = Array(sums.dc[3 * i + channel] for i in range(MAX_LEVELS))[level]
        total = sums.total[channel] + (base << frac - n.sh_dc.frac_bits)
        return saturate(round_shift(total, frac - n.colour.frac_bits), n.colour)
