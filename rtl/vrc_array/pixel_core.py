"""The pixel core: the only arithmetic that exists once per pixel (docs/array.md, "A pixel and an op").

It has four stages, each between two ranks of registers; the row supplies the op's fields beside each stage::

    cycle            0     1     2     3     4     5
    exponent       < e  >
    exponent_below       < e' >                           e + slope, for the core below
    alpha_op             <cut >                           exponent against cut, 2^x to 1 - alpha
    blend_op                   <bank>                     T' = T (1 - alpha)
    transmittance                    < T' >
    weigh_op                         <bank>               weight = T - T'
    sum_op                                 <col.>         sums += weight * colour
    sums                                         <sum>

Latency: 3 cycles to the transmittance and 5 to the sums. Throughput: one op per cycle, whatever the order of banks, because
every loop through a bank (T to T', sum to sum) closes in one cycle.

No data register has a reset: the first op of a tile defines everything that the later ops read. In machines with super-tiles a
load does, see `rtl.vrc_array.batch_row`.
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

import numpy as np
from amaranth.hdl import Array, Cat, Const, Module, Shape, Signal, Value, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.select import select
from spec.config import AcceleratorConfig, NumberFormats
from spec.formats import Fixed
from spec.tables import EXP2_SLOPE_FRAC, alpha_max_l1, exp2_segments, log2_alpha_min, t_stop


def index_shape(count: int) -> Shape:
    """Shape of an index below `count`; it has at least one bit, so that every port exists in every configuration."""
    return unsigned(max(1, (count - 1).bit_length()))


def pixel_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Accumulated state of one pixel in one level bank; depth is always 0 without config.depth."""
    n = config.formats
    return data.StructLayout({
        "colour": data.ArrayLayout(unsigned(n.accumulator.width), 3),
        "depth": unsigned(n.depth_accumulator.width),
        "transmittance": unsigned(n.transmittance.width),
    })


def alpha_op_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Fields of the op in the alpha stage; `cut` is at least `tables.log2_alpha_min`. Banks in memories are read in this stage,
    so that the block is there, too."""
    ahead = {"block": index_shape(config.blocks)} if config.bank_memories else {}
    return data.StructLayout({"cut": signed(config.formats.cut.width), "outer": 1, "last": 1, **ahead})


def place_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Where an op finds the state of its pixel in a machine whose banks are in memories."""
    return data.StructLayout({
        "block": index_shape(config.blocks),
        "held": 1,  # low if `first`, because the bank then starts afresh
    })


def bank_ports(config: AcceleratorConfig) -> dict[str, Any]:
    """Fields of an op that say which bank it reads and writes."""
    if config.bank_memories:
        return {"read": place_layout(config), "write": config.level_banks}  # one-hot level; 0 in a bubble
    return {
        "read": config.banks,  # one-hot bank; 0 if `first`, because the bank then starts afresh
        "write": config.banks,  # one-hot bank; 0 in a bubble
    }


def blend_op_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Fields of the op in the blend stage."""
    first = {} if config.supertiles else {"first": 1}  # with super-tiles every tile's state is loaded
    return data.StructLayout({**bank_ports(config), **first, "last": 1})


def weigh_op_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Fields of the op in the weigh stage."""
    # One-hot bank, or 1 where banks are in memories; 0 if `last`, which uses up the whole transmittance.
    return data.StructLayout({"read": 1 if config.bank_memories else config.banks})


def sum_op_layout(config: AcceleratorConfig) -> data.StructLayout:
    """Fields of the op in the sum stage."""
    n = config.formats
    return data.StructLayout({
        **bank_ports(config),
        "colour": data.ArrayLayout(unsigned(n.colour.width), 3),
        "depth": unsigned(n.depth.width),
        # Three times the depth, because its multiplier is taken two bits at a time.
        "depth_thrice": unsigned(n.depth.width + 2),
    })


def saturation_threshold(formats: NumberFormats) -> int:
    """Smallest raw exponent (in the fraction of `cut`) whose alpha reaches level 1's upper bound.

    Raises:
        ValueError: alpha is not monotonic there, or never reaches the bound.
    """
    bits, segment_bits = formats.cut.frac_bits, formats.cut.frac_bits - (formats.exp2_segments - 1).bit_length()
    base, slope = exp2_segments(formats)
    f = np.arange(1 << bits)
    s, r = f >> segment_bits, f & (1 << segment_bits) - 1
    mantissa = base[s] + (slope[s] * r >> EXP2_SLOPE_FRAC + bits - formats.alpha.frac_bits)
    reached = -(-mantissa >> 1) >= alpha_max_l1(formats)
    if not reached[-1] or (np.diff(reached.astype(int)) < 0).any():
        raise ValueError(f"formats must give an alpha that crosses its upper bound once, not {formats!r}")
    return int(np.argmax(reached)) - (1 << bits)


class PixelCore(wiring.Component):
    """The core of one pixel.

    Parameters:
        config: the machine; `banks`, `level_banks`, `depth` and the formats are used.

    Ports, with the cycle in which an op uses them (see the module):
        exponent, slope: cycle 0; exponent of alpha at this pixel, and its first difference along y.
        exponent_below, slope_below: cycle 1; the same for the pixel below. `curve_yy` is read in cycle 1.
        alpha_op, blend_op, weigh_op, sum_op: cycles 1, 2, 3, 4.
        draining_block, drained_block: the block whose transmittance, and the block whose sums, `pixel` shows.
        pixel: the state per level bank, straight from the registers.
        stopped: per level bank, whether T < t_stop in every block.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        n = config.formats
        if n.cut.frac_bits > n.exponent.frac_bits:
            raise ValueError(f"cut must not have more fraction bits than exponent {n.exponent}, not {n.cut}")
        if n.weight.frac_bits > n.transmittance.frac_bits:
            raise ValueError(f"weight must not have more fraction bits than transmittance {n.transmittance}, not {n.weight}")
        self.config = config
        self._saturation = saturation_threshold(n)
        super().__init__(self._ports())

    def _ports(self) -> dict[str, wiring.Member]:
        config, n = self.config, self.config.formats
        return {
            "exponent": In(signed(n.exponent.width)),
            "slope": In(signed(n.slope.width)),
            "curve_yy": In(signed(n.curvature.width)),
            "exponent_below": Out(signed(n.exponent.width)),
            "slope_below": Out(signed(n.slope.width)),
            "alpha_op": In(alpha_op_layout(config)),
            "blend_op": In(blend_op_layout(config)),
            "weigh_op": In(weigh_op_layout(config)),
            "sum_op": In(sum_op_layout(config)),
            "draining_block": In(index_shape(config.blocks)),
            "drained_block": In(index_shape(config.blocks)),
            "pixel": Out(data.ArrayLayout(pixel_layout(config), config.level_banks)),
            "stopped": Out(config.level_banks),
        }

    def _first(self) -> Value:
        """Whether the op in the blend stage is the first of its tile in its bank."""
        return self.blend_op.first

    def elaborate(self, platform: object) -> Module:
        m = Module()
        exponent = Signal.like(self.exponent, reset_less=True)
        slope = Signal.like(self.slope, reset_less=True)
        m.d.sync += [exponent.eq(self.exponent), slope.eq(self.slope)]
        m.d.comb += [self.exponent_below.eq(exponent + slope), self.slope_below.eq(slope + self.curve_yy)]

        keep, covered = self._alpha(m, exponent)
        self._sums(m, *self._weigh(m, *self._blend(m, keep, covered)))
        return m

    def _alpha(self, m: Module, exponent: Value) -> tuple[Signal, Signal]:
        """Stage 1: registers 1 - alpha, in [0, 1), and whether the exponent has reached the cut.

        1 - alpha needs no integer bit, because alpha is never 0 in a pixel that reaches its cut.
        """
        n, op = self.config.formats, self.alpha_op
        frac = n.alpha.frac_bits
        t = Signal(signed(n.exponent.width - n.exponent.frac_bits + n.cut.frac_bits))
        m.d.comb += t.eq(exponent >> n.exponent.frac_bits - n.cut.frac_bits)

        f = t[:n.cut.frac_bits]
        segment_bits = n.cut.frac_bits - (n.exp2_segments - 1).bit_length()
        bases, slopes = exp2_segments(n)
        base, slope = (Array(Const(int(v), int(table.max()).bit_length()) for v in table)[f[segment_bits:]]
                       for table in (bases - 1, slopes))
        low = EXP2_SLOPE_FRAC + n.cut.frac_bits - frac
        less = Signal(frac + 1)  # the mantissa minus one; its complement is -mantissa
        m.d.comb += less.eq(Cat(Const(0, low), base) + slope * f[:segment_bits] >> low)

        # A pixel that reaches its cut has alpha >= 1/255, so the shift, -i, is between 1 and `deepest`.
        deepest = -(log2_alpha_min(n) >> n.cut.frac_bits)
        shift = (~t[n.cut.frac_bits:])[:(deepest - 1).bit_length()]

        keep = Signal(frac, reset_less=True)
        covered = Signal(reset_less=True)
        one = op.last | (op.outer & (t >= 0))
        with m.If(one):
            m.d.sync += keep.eq(0)
        with m.Elif(~op.outer & (t >= self._saturation)):
            m.d.sync += keep.eq((1 << frac) - alpha_max_l1(n))
        with m.Else():
            m.d.sync += keep.eq(~((less >> 1) >> shift))
        m.d.sync += covered.eq(op.last | (t >= op.cut))
        return keep, covered

    def _blend(self, m: Module, keep: Value, covered: Value) -> tuple[list[Signal], Value, Signal]:
        """Stage 2: updates the transmittance of the op's bank.

        Returns the banks, the transmittance before the op from registers, and a register of whether the sums may change. That
        flag only gates the clock of the sums: where the transmittance stays the same, the weight is 0 anyway.
        """
        n, op, first = self.config.formats, self.blend_op, self._first()
        frac = n.alpha.frac_bits
        banks = [Signal(n.transmittance.width, name=f"transmittance{b}", reset_less=True) for b in range(self.config.banks)]
        below = Signal(self.config.banks)
        m.d.comb += below.eq(Cat(bank < t_stop(n) for bank in banks))

        held, before = Signal(n.transmittance.width), Signal(n.transmittance.width)
        after = Signal(n.transmittance.width)
        m.d.comb += [
            held.eq(select(op.read, banks)), before.eq(held | first.replicate(len(before))),
            after.eq((before * keep + (1 << frac - 1)) >> frac),
        ]
        touch = op.last | (covered & ~(op.read & below).any())
        afresh = first & (op.last | ~covered)
        for b, bank in enumerate(banks):
            with m.If(op.write[b] & (first | (touch & ~op.last))):
                m.d.sync += bank.eq(after | afresh.replicate(len(after)))

        was = Signal(self._finest.width, reset_less=True)
        began, touched = Signal(reset_less=True), Signal(reset_less=True)
        m.d.sync += [was.eq(held >> n.transmittance.frac_bits - self._finest.frac_bits), began.eq(first),
                     touched.eq(touch | first)]
        kept = was | began.replicate(len(was))  # recomputed from registers, because `before` already drives the multiplier
        for level in range(self.config.level_banks):
            blocks = slice(level, None, self.config.level_banks)
            m.d.comb += [
                self.stopped[level].eq(below[blocks].all()),
                self.pixel[level].transmittance.eq(Array(banks[blocks])[self.draining_block]),
            ]
        return banks, kept, touched

    @property
    def _finest(self) -> Fixed:
        """The format of the weight that the depth sums use if there is depth, else of the colours' weight."""
        return self.config.depth_weight if self.config.depth else self.config.formats.weight

    def _weigh(self, m: Module, banks: list[Signal], kept: Value, touched: Value) -> tuple[Signal, Signal, Signal]:
        """Stage 3: the weight is the transmittance that the op took from its bank.

        The background takes all that is left, but leaves the bank unchanged. Returns the weight of the colours, the weight of
        the depth, which may have more fraction bits, and whether the sums may change.
        """
        n = self.config.formats
        left = Signal(self._finest.width)
        weight = Signal(n.weight.width, reset_less=True)
        still_touched = Signal(reset_less=True)
        drop, finer = n.transmittance.frac_bits - self._finest.frac_bits, self._finest.frac_bits - n.weight.frac_bits
        m.d.comb += left.eq(select(self.weigh_op.read, [bank >> drop for bank in banks]))
        m.d.sync += [weight.eq((kept >> finer) - (left >> finer)), still_touched.eq(touched)]
        if not finer:
            return weight, weight, still_touched
        fine = Signal(self._finest.width, reset_less=True)
        m.d.sync += fine.eq(kept - left)
        return weight, fine, still_touched

    def _sums(self, m: Module, weight: Value, fine: Value, touched: Value) -> list[list[Signal]]:
        """Stage 4: adds to the sums of colour and depth. Returns the banks of each sum: r, g, b and, with depth, depth."""
        op, every = self.sum_op, []
        for s, (product, shift, sum_format, outputs) in enumerate(self._products(weight, fine)):
            banks = [Signal(sum_format.width, name=f"sum{s}_{b}", reset_less=True) for b in range(self.config.banks)]
            total = Signal(sum_format.width + shift, name=f"total{s}")
            m.d.comb += total.eq(Cat(Const(1 << shift - 1, shift), select(op.read, banks)) + product)
            for b, bank in enumerate(banks):
                with m.If(op.write[b] & touched):
                    m.d.sync += bank.eq(total >> shift)
            for level, output in enumerate(outputs):
                m.d.comb += output.eq(Array(banks[level::self.config.level_banks])[self.drained_block])
            every.append(banks)
        return every

    def _products(self, weight: Value, fine: Value) -> list[tuple[Value, int, Fixed, list[Value]]]:
        """What an op adds to each sum, r, g, b and, with depth, depth: the product, the bits by which it is longer than the
        sum, the format of the sum, and the ports that show the sum of each level."""
        n, op = self.config.formats, self.sum_op
        sums = [(weight * op.colour[c], n.weight, n.colour, n.accumulator, [pixel.colour[c] for pixel in self.pixel])
                for c in range(3)]
        if self.config.depth:
            finer = self._finest.width > n.weight.width
            product = by_pairs(fine, op.depth, op.depth_thrice) if finer else fine * op.depth
            sums.append((product, self._finest, n.depth, n.depth_accumulator, [pixel.depth for pixel in self.pixel]))
        return [(product, by_format.frac_bits + value_format.frac_bits - sum_format.frac_bits, sum_format, outputs)
                for product, by_format, value_format, sum_format, outputs in sums]


def by_pairs(by: Value, value: Value, thrice: Value) -> Value:
    """by * value, from pairs of bits of `by`; `thrice` is 3 * value.

    Pairs need half as many addends as single bits. The depth's weight has so many bits that adding one addend for each would
    take more than a cycle. The addends are selected by and-or gates, which a simulator evaluates faster than multiplexers.
    """
    terms = []
    for i in range(0, len(by), 2):
        low, high = by[i], by[i + 1] if i + 1 < len(by) else Const(0, 1)
        terms.append(select(Cat(low & ~high, high & ~low, low & high), [value, value << 1, thrice]) << i)
    return reduce(add, terms)
