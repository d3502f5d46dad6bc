"""Decodes the levels of compact records, rounds sums to colours, and makes the places of pairs."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.chunks.decode_colour import base_colour, opacity
from rtl.culling.compact_sum import compact_sum_layout
from rtl.culling.compact_views import level_codes
from rtl.culling.views import rounded_colour
from rtl.shapes import layout, shape
from rtl.stream import payload_register
from spec.compact import COARSE_BOUND
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import sum_format
from spec.supertiles import batch_place

CARRIED = data.StructLayout({"bound": 2, "keep": 1})
"""In machines with joint frames, what is carried with the sums (`rtl.culling.compact_sum`)."""


def _unchanged(config: AcceleratorConfig) -> tuple[str, ...]:
    """The fields that a place takes unchanged."""
    return ("mean2d", "conic", "depth", "bound", "mask", *(["eye"] if config.joint else []))


class PairPlaces(wiring.Component):
    """Makes a splat record for every level among the tiles of a pair.

        sums, splats --> codes of a level and of the one above, decoded --> base colours added, rounded --> places

    Parameters:
        config: the machine, with super-tiles.
        carried: layout of the data that is carried with the sums: levels, and what a place takes unchanged; with joint frames
            that of the splats.

    Ports:
        sums: `compact_sum_layout` items, one per pair; each is taken with the pair's last level, or at once where it has no
            level.
        splats: in machines with joint frames, what a place takes unchanged, for each eye in which a pair has a level; `last`:
            nothing of the pair follows; in machines with a warp unit also for a pair without a level, which gives a place with
            `none`. There is a sum for each of them or, while `once` is high, one for each pair.
        once: see `splats`.
        places: BatchPlace items, pair by pair, for each pair the lowest level first.

    Throughput: one place a cycle. Latency: 2 cycles.
    """

    def __init__(self, config: AcceleratorConfig, *, carried: data.StructLayout) -> None:
        self.config = config
        summed = CARRIED if config.joint else carried
        super().__init__({
            "sums": In(stream.Signature(compact_sum_layout(config, summed))),
            **({"splats": In(stream.Signature(carried)), "once": In(1)} if config.joint else {}),
            "places": Out(stream.Signature(layout(batch_place(config)))),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        n, sums, places, unchanged = self.config.formats, self.sums, self.places, _unchanged(self.config)
        splat, offered = (self.splats.payload, sums.valid & self.splats.valid) if self.config.joint else (
            sums.payload.carried, sums.valid)
        done, rest, level, above = (Signal(MAX_LEVELS, name=name) for name in ("done", "rest", "level", "above"))
        there, free, moves, last, made = Signal(), Signal(), Signal(), Signal(), payload_register(m, places)
        coarse = splat.bound == COARSE_BOUND
        held = Signal(data.StructLayout({
            "total": data.ArrayLayout(shape(sum_format(n)), 3), "dc": data.ArrayLayout(shape(n.sh_dc), 6),
            "log2_opacity": data.ArrayLayout(shape(n.log2_opacity), 2), "level": 2, "last": 1,
            **({"none": 1} if self.config.warps_joint else {}),
            **{name: splat[name].shape() for name in unchanged}}), reset_less=True)
        none = ~splat.levels.any() if self.config.warps_joint else None
        has = rest.any() if none is None else rest.any() | none
        m.d.comb += [
            rest.eq(splat.levels & ~done),
            level.eq(Cat(rest[i] & ~rest[:i].any() for i in range(MAX_LEVELS))),  # one-hot: the lowest that is left
            above.eq(Cat(Const(0, 1), level[:-2], level[-2:].any())),  # the level above, if any
            last.eq(~(rest & ~level).any()),
            free.eq(~places.valid | places.ready),
            moves.eq(~there | free),
        ]
        taken, whole = self._take(m, splat, rest, moves, last)
        opacities, colours = level_codes(m, sums.payload.codes, coarse, level, above)
        with m.If(moves):
            m.d.sync += there.eq(offered & has)
        with m.If(moves & offered & has):
            m.d.sync += [
                done.eq(done | level), held.level.eq(Cat(level[1] | level[3], level[2] | level[3])), held.last.eq(whole),
                held.total.eq(sums.payload.total), *(held[name].eq(splat[name]) for name in unchanged)]
            if none is not None:
                m.d.sync += held.none.eq(none)
            m.d.sync += [held.log2_opacity[i].eq(opacity(self.config, code)) for i, code in enumerate(opacities)]
            m.d.sync += [held.dc[i].eq(base_colour(self.config, code, coarse, sums.payload.codes.dc_range))
                         for i, code in enumerate(colours)]
        with m.If(taken):
            m.d.sync += done.eq(0)
        with m.If(free):
            m.d.sync += places.valid.eq(there)
        with m.If(free & there):
            m.d.sync += Value.cast(made).eq(self._place(held))
        return m

    def _take(self, m: Module, splat: data.View, rest: Value, moves: Value, last: Value) -> tuple[Value, Value]:
        """Takes sums, and splats; `last` is the last level of the splat. Returns whether a splat is taken, and whether its
        pair's last place is made."""
        sums = self.sums
        if not self.config.joint:
            m.d.comb += sums.ready.eq(~rest.any() | moves & last)
            return sums.valid & sums.ready, last
        splats = self.splats
        m.d.comb += [
            splats.ready.eq(sums.valid & moves & last),
            sums.ready.eq(splats.valid & moves & last & (~self.once | splat.last))]
        return splats.valid & splats.ready, last & splat.last

    def _place(self, held: data.View) -> Value:
        """The place."""
        none = ("none",) if self.config.warps_joint else ()
        values = {name: Value.cast(held[name]) for name in (*_unchanged(self.config), "log2_opacity", "level", *none, "last")}
        values["colour"] = Cat(
            rounded_colour(self.config, held.total[i % 3], held.dc[i]) for i in range(6))
        return Cat(values[name] for name, _ in layout(batch_place(self.config)))
