"""Where a pixel of the source eye goes: its disparity, its column in the target eye, and the key that says how near it is.

The disparity is floor(S w / d) (`spec.stereo`). If it does not fit the quotient, it is larger than `reach`, and the pixel is
dropped. A pixel is also dropped if it would move further than `reach` or leave the frame. Without `warp_veiled` a pixel is
dropped as well if its coverage lies between that of the background and that of a solid pixel. The disparity, rounded half up to
whole pixels, is added to the column if the source is the right eye, and subtracted otherwise. The largest permitted shift
follows from the edge of the frame and from `reach`; it is computed before the disparity is known::

    stage   1          2             3      4 .. Q + 3       Q + 4
            columns    class, most,  S w    long division,   column in the ring, not too far?
            to go      half of S w          Q bits           key
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.vrc_array.pixel_writer import display_byte
from rtl.warp_unit.divider import Divider
from rtl.warp_unit.queue import column_bits, place_layout, source_layout, sub_bits
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.stereo import (
    DISPARITY_FRAC,
    DISPARITY_SCALE_BITS,
    background_transmittance,
    disparity,
    disparity_drop,
    reach,
    warped_transmittance,
)


def ring_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The place of a target pixel: its row among the lane's rows, and its column in the ring. As a number it has no gaps."""
    return data.StructLayout({"sub": sub_bits(config), "x": range(config.warp_columns)})


def moved_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A pixel on its way into a lane's part of the ring: the fields that differ within a lane."""
    return data.StructLayout({
        "place": ring_layout(config), "colour": data.ArrayLayout(8, 3), "key": disparity(config).width, "keep": 1})


def carried_layout(config: AcceleratorConfig) -> data.StructLayout:
    """What bypasses the division: the pixel's own column in the ring, its largest permitted shift, and its colour."""
    return data.StructLayout({
        "place": ring_layout(config), "most": range(reach(config) + 1), "colour": data.ArrayLayout(8, 3), "background": 1})


def carried_cycles(config: AcceleratorConfig) -> int:
    """Cycles by which `carried_layout` is delayed."""
    return disparity(config).width + 1


def disparity_latency(config: AcceleratorConfig) -> int:
    """Cycles through the unit."""
    return disparity(config).width + 4


def disparity_divider(config: AcceleratorConfig) -> Divider:
    """The divider of S w by d."""
    n = config.formats
    return Divider(numerator_bits=DISPARITY_SCALE_BITS + n.transmittance.width - disparity_drop(n),
                   divisor_bits=n.depth_accumulator.width, quotient_bits=disparity(config).width)


class Disparity(wiring.Component):
    """Computes where each pixel of the source eye goes.

    Parameters:
        config: the machine; `row_width`, `warp_columns` and `warp_veiled` are used, and `warp_lanes` for the places.

    Ports:
        load: a pixel is at the input; without it the stages keep their contents.
        place, pixel: the pixel, which lies in the frame.
        last: the frame's last column.
        disparity_scale, source_right: settings of the frame.
        carries, early, late: the path around the division: `late` is the value that `early` had, with `carries` high,
            `carried_cycles` cycles ago. The delay is outside (`rtl.warp_unit.delay`), so that one memory serves all lanes.
        moved: the pixel, `disparity_latency` cycles later; `keep` is low if the pixel is dropped or there is none.

    Throughput: one pixel per cycle, without back-pressure. Order is kept. Latency: 21 cycles for PAPER.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            "load": In(1), "place": In(place_layout(config)), "pixel": In(source_layout(config)),
            "last": In(column_bits(config)),
            "disparity_scale": In(DISPARITY_SCALE_BITS), "source_right": In(1), "moved": Out(moved_layout(config)),
            "carries": Out(1), "early": Out(carried_layout(config)), "late": In(carried_layout(config)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        n, p = self.config.formats, Pipeline(m, load=self.load)
        loads = p.control("load", self.load)
        # registered first, because the selection of the pixel is on the critical path
        t, depth = (p.data(name, self.pixel[name]).to(1) for name in ("transmittance", "depth"))
        background = p.reg("background", lambda t: t >= background_transmittance(n), t)
        most = warped_transmittance(self.config)
        may = p.reg("may", lambda load, t: load & ((t >= background_transmittance(n)) | (t <= most)), loads, t)
        colour = p.reg("colour", lambda c: Cat(display_byte(c.word_select(i, n.accumulator.width), n.accumulator)
                                               for i in range(3)), p.data("sums", self.pixel.colour.as_value()).to(1))
        raw, over = self._quotient(m, p, loads, t, depth, background)
        may = p.reg("fits", lambda may, over: may & ~over, may, over)
        x = p.data("x", self.place.x)
        goes = p.reg("goes", lambda x: Mux(self.source_right, self.last - x, x)[: len(x)], x)
        farthest = p.reg("most", lambda goes: Mux(goes < reach(self.config), goes, reach(self.config)), goes)
        ring = p.data("ring", Cat(self.place.sub, x.value[: (TILE - 1).bit_length()], self.place.slot))
        m.d.comb += [
            self.carries.eq(loads.at(colour.stage)), self.early.place.as_value().eq(ring.at(colour.stage)),
            self.early.most.eq(farthest.at(colour.stage)), self.early.colour.as_value().eq(colour.value),
            self.early.background.eq(background.value)]
        if raw.stage != colour.stage + carried_cycles(self.config):
            raise AssertionError(f"{raw.stage - colour.stage} cycles, not {carried_cycles(self.config)}")

        late = {name: Staged(p, name, value, raw.stage, False) for name, value in (
            ("late_x", self.late.place.x), ("late_most", self.late.most), ("late_sub", self.late.place.sub),
            ("late_background", self.late.background), ("late_colour", self.late.colour.as_value()))}
        key = p.reg("key", lambda raw, background: Mux(background, 0, raw + 1)[: len(raw)], raw, late["late_background"])
        x = p.reg("column", self._column, raw, late["late_x"])
        keep = p.reg("keep", self._near_enough, may, raw, late["late_most"])
        end, moved = keep.stage, self.moved
        m.d.comb += [
            moved.keep.eq(keep.value), moved.place.x.eq(x.at(end)), moved.key.eq(key.at(end)),
            moved.place.sub.eq(late["late_sub"].at(end)), moved.colour.as_value().eq(late["late_colour"].at(end))]
        if end != disparity_latency(self.config):
            raise AssertionError(f"{end} stages, not {disparity_latency(self.config)}")
        return m

    def _quotient(
        self, m: Module, p: Pipeline, loads: Staged, t: Staged, depth: Staged, background: Staged,
    ) -> tuple[Staged, Staged]:
        """The raw disparity, for the background 0 divided by an odd number; and whether it is too large, known much earlier."""
        n = self.config.formats
        weight = t.map(lambda t: ~t)  # the initial T, all ones, minus the final T
        # The upper half absorbs the carry of the lower product
        half, drop = (n.transmittance.width + 1) // 2, disparity_drop(n)
        low = p.reg("low", lambda w: self.disparity_scale * w[:half], weight)
        high = p.reg("high", lambda w, t: Mux(t >= background_transmittance(n), 0, w[half:]), weight, t)

        def whole(low: Value, high: Value, background: Value) -> Value:
            low = Mux(background, 0, low)
            return Cat(low[:half], low[half:] + self.disparity_scale * high)[drop:]

        product = p.reg("product", whole, low, high, background)
        m.submodules.divider = divider = disparity_divider(self.config)
        start = product.stage
        m.d.comb += [
            divider.load.eq(loads.at(start)), divider.numerator.eq(product.value),
            divider.divisor.eq(depth.at(start) | background.at(start))]
        return (Staged(p, "quotient", divider.quotient, start + divider.latency, False),
                Staged(p, "over", divider.over, start + 1, False))

    def _column(self, raw: Value, x: Value) -> Value:
        """x plus or minus the rounded disparity, modulo the ring; the minus uses -(whole + past) = ~whole + 1 - past."""
        left, (whole, past) = ~self.source_right, self._rounded(raw)
        return (x + (Cat(whole, Const(0, 1)) ^ left.replicate(len(whole) + 1)).as_signed() + (past ^ left))[: len(x)]

    def _near_enough(self, may: Value, raw: Value, most: Value) -> Value:
        """Whether the pixel may be warped, and moves no further than it may."""
        whole, past = self._rounded(raw)
        return may & (whole + past <= most)

    def _rounded(self, raw: Value) -> tuple[Value, Value]:
        """Whole pixels of the disparity, and whether rounding adds one: a half always moves the column to the right."""
        half, below = raw[DISPARITY_FRAC - 1], raw[: DISPARITY_FRAC - 1].any()
        return raw[DISPARITY_FRAC:], half & (self.source_right | below)
