"""Multiplies spherical harmonics by the codes of a splat's compact records and sums the products of each channel."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from amaranth.hdl import Cat, Const, Module, Mux, ShapeLike, Signal, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.colour_sum import basis_layout, tree
from rtl.culling.harmonics import basis_name
from rtl.shapes import layout, shape
from rtl.stream import payload_register
from spec.compact import (
    BAND_BITS,
    BAND_EXPONENT_BITS,
    BAND_EXPONENT_MOST,
    BANDS,
    COARSE_BOUND,
    compact_colour,
    compact_harmonics,
)
from spec.config import AcceleratorConfig
from spec.harmonics import sum_format, terms
from spec.memory import BEAT_BYTES, read_data
from spec.records import Record

_CHANNELS = 3
_LEVEL_FIELDS = ("dc_range", "opacity", "dc")
_SHIFT = unsigned(max(BAND_EXPONENT_MOST).bit_length())


def field_place(record: Record, name: str) -> tuple[int, int]:
    """First bit and width of a field of a record."""
    place = 0
    for field in record.fields:
        if field.name == name:
            return place, field.width
        place += field.width
    raise KeyError(name)


def codes_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The codes of a splat's levels: the factor's exponent, and opacities and base colours as a fine or a coarse record has
    them, from bit 0 up."""
    records = [compact_colour(config, coarse) for coarse in (False, True)]
    return data.StructLayout({
        name: unsigned(max(field_place(record, name)[1] for record in records)) for name in _LEVEL_FIELDS})


def compact_sum_layout(config: AcceleratorConfig, carried: ShapeLike) -> data.StructLayout:
    """A splat's sums over the coefficients, raw `sum_format`; the codes of its levels; and the carried data."""
    return data.StructLayout({
        "total": data.ArrayLayout(shape(sum_format(config.formats)), _CHANNELS), "codes": codes_layout(config),
        "carried": carried})


@dataclass(frozen=True)
class Group:
    """Neighbouring lanes that multiply codes of a single band in every step, so that their sum is shifted once.

    Attributes:
        lanes: the lanes.
        bits: bits of the widest code that they multiply.
    """

    lanes: range
    bits: int


def band_of(term: int) -> int:
    """The band, its degree less 1, of a term."""
    return next(i for i, band in enumerate(BANDS) if term in band)


def lane_groups(sh_degree: int, lanes: int) -> list[Group]:
    """The groups of the lanes, where step i multiplies the terms from i * lanes on."""
    count = terms(sh_degree)
    cuts = {band.start % lanes for band in BANDS if band.start < count} | {0, lanes} if lanes else {0}
    edges = sorted(cuts)
    groups = []
    for first, end in pairwise(edges):
        used = [term for term in range(count) if first <= term % lanes < end]
        if used:
            groups.append(Group(range(first, end), max(BAND_BITS[band_of(term)] for term in used)))
    return groups


class CompactColourSum(wiring.Component):
    """Multiplies `lanes` basis functions by the codes of three channels per cycle, shifts the sums of the products by the
    exponents of their bands, and accumulates them. Nothing is rounded.

    The unit holds the end of one R beat and one SH beat. Each step reads the codes of its terms in the SH beat, and the first
    step hands on the codes of the levels, so that the next splat's R can come. With `lanes` for two steps a splat, beats come
    without a gap; 0' belongs to the next splat::

        beats taken   R    SH   R'   SH'  R"   SH"
        held               R    R,SH R',SH R',SH'
        step                    0    1    0'   1'
        operands                     0    1    0'
        products                          0    1
        groups' sums                           0    1
        sums                                             ^         (held until they are taken)

    Parameters:
        config: the machine, with compact records.
        sh_degree: degree of the largest records.
        lanes: basis functions per cycle, 0 for degree 0.
        carried: layout of the data that passes the unit with a splat; it has a field `bound`. If it has a field `keep`, the
            beats of a splat where it is 1 are those of the next splat, too, and come only once.

    Ports:
        basis: `basis_layout` items; each is taken with its splat's last step.
        data: the splats' beats: R, and SH where `sh_degree` is not 0.
        sums: `compact_sum_layout` items, in order.
        sh_degree: degree of the records, at most the parameter.
        idle: no beat is held.

    Throughput: one splat every max(steps, beats) cycles, where steps is the number of terms of the largest degree divided by
    `lanes`, whatever the degree; two cycles at least where there are lanes. All stages wait while a splat's sums cannot
    replace those of the splat before. Latency: 4 cycles from the last step to `sums`; 1 without lanes.
    """

    def __init__(self, config: AcceleratorConfig, *, sh_degree: int, lanes: int, carried: data.StructLayout) -> None:
        if lanes and terms(sh_degree) <= lanes:
            raise ValueError(f"lanes must leave at least two steps, not {lanes!r}")
        self.config, self._degree, self._lanes, self._carried = config, sh_degree, lanes, carried
        self._steps = -(-terms(sh_degree) // lanes) if lanes else 1
        self._groups = lane_groups(sh_degree, lanes)
        super().__init__({
            "basis": In(stream.Signature(basis_layout(config, sh_degree, carried))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "sums": Out(stream.Signature(compact_sum_layout(config, carried))),
            "sh_degree": In(2),
            "idle": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        self._step, self._first, self._last, self._move = Signal(), Signal(), Signal(), Signal()
        self._summed = payload_register(m, self.sums)
        number = Signal(range(max(self._steps, 2)))
        enough = self._beats(m)
        m.d.comb += [
            self._first.eq(number == 0),
            self._last.eq(number == self._steps - 1),
            self._step.eq(self.basis.valid & enough & self._move),
            self.basis.ready.eq(self._step & self._last),
        ]
        with m.If(self._step):
            m.d.sync += number.eq(Mux(self._last, 0, number + 1))
        if self._lanes:
            self._pipeline(m, number)
        else:
            self._pass(m)
        return m

    def _beats(self, m: Module) -> Value:
        """Holds R from the first field that differs between levels on, and SH. Returns whether all beats of the next step are
        there."""
        below = min(field_place(compact_colour(self.config, coarse), "dc_range")[0] for coarse in (False, True))
        self._record = Signal(8 * BEAT_BYTES - below, reset_less=True)
        self._below = below
        self._harmonics = Signal(compact_harmonics(self.config).width if self._degree else 0, reset_less=True)
        record_there, harmonics_there, second, taken = Signal(), Signal(), Signal(), Signal()
        incoming, two = self.data.payload.word.as_value(), self.sh_degree.any() & (self._degree > 0)
        used = self._step
        if "keep" in self._carried.members:
            used = used & ~self.basis.payload.carried.keep
        leaves, used_up = used & self._first, used & self._last
        m.d.comb += [
            self.data.ready.eq(Mux(second, ~harmonics_there | used_up, ~record_there | leaves)),
            taken.eq(self.data.valid & self.data.ready),
            self.idle.eq(~record_there & ~harmonics_there),
        ]
        with m.If(taken):
            m.d.sync += second.eq(~second & two)
        m.d.sync += [
            record_there.eq(taken & ~second | record_there & ~leaves),
            harmonics_there.eq(taken & second | harmonics_there & ~used_up)]
        with m.If(taken & ~second):
            m.d.sync += self._record.eq(incoming[below:])
        with m.If(taken & second):
            m.d.sync += self._harmonics.eq(incoming)
        return (record_there | ~self._first) & (harmonics_there | ~two)

    def _codes(self) -> Value:
        """The codes of the levels of the splat whose first step is made."""
        fine, coarse = (self._codes_of(kind) for kind in (False, True))
        return Mux(self.basis.payload.carried.bound == COARSE_BOUND, coarse, fine)

    def _codes_of(self, coarse: bool) -> Value:
        """The codes as they are in a fine or in a coarse record, in `codes_layout`."""
        parts = []
        for name, of in codes_layout(self.config).members.items():
            place, width = field_place(compact_colour(self.config, coarse), name)
            parts += [self._record[place - self._below : place - self._below + width], Const(0, of.width - width)]
        return Cat(*parts)

    def _pass(self, m: Module) -> None:
        """Without harmonics the sums are 0, and a splat moves to `sums` at once."""
        sums = self.sums
        m.d.comb += [self._move.eq(~sums.valid | sums.ready), Value.cast(sums.payload.total).eq(0)]
        with m.If(self._move):
            m.d.sync += sums.valid.eq(self._step)
        with m.If(self._step):
            m.d.sync += [self._summed.codes.eq(self._codes()), self._summed.carried.eq(self.basis.payload.carried)]

    def _pipeline(self, m: Module, number: Signal) -> None:
        """Registers for operands, for products, for the groups' sums, and for the sums."""
        config, sums = self.config, self.sums
        valid, lasts, starts = Signal(3), Signal(3), Signal(3)  # of the steps in the three stages
        m.d.comb += self._move.eq(~(lasts[2] & sums.valid & ~sums.ready))
        with m.If(self._move):
            m.d.sync += [valid.eq(Cat(self._step, valid)), lasts.eq(Cat(self._step & self._last, lasts)),
                         starts.eq(Cat(self._first, starts))]
        with m.If(sums.ready):
            m.d.sync += sums.valid.eq(0)
        with m.If(lasts[2] & self._move):
            m.d.sync += sums.valid.eq(1)
        codes = [Signal(codes_layout(config), name=f"codes_{i}", reset_less=True) for i in range(2)]
        carried = [Signal(self._carried, name=f"carried_{i}", reset_less=True) for i in range(2)]
        with m.If(self._step & self._first):
            m.d.sync += codes[0].eq(self._codes())
        with m.If(self._step & self._last):
            m.d.sync += carried[0].eq(self.basis.payload.carried)
        with m.If(lasts[0] & self._move):
            m.d.sync += [codes[1].eq(codes[0]), carried[1].eq(carried[0])]
        with m.If(lasts[2] & self._move):
            m.d.sync += [self._summed.codes.eq(codes[1]), self._summed.carried.eq(carried[1])]
        self._multiply(m, number, valid, starts, lasts)

    def _multiply(self, m: Module, number: Signal, valid: Signal, starts: Signal, lasts: Signal) -> None:
        basis = [Signal(shape(self.config.formats.sh_basis), name=f"basis_operand_{i}", reset_less=True)
                 for i in range(self._lanes)]
        shifts = [[Signal(_SHIFT, name=f"shift_{g}_{stage}", reset_less=True) for stage in range(3)]
                  for g in range(len(self._groups))]
        rest = {}
        for group in self._groups:
            for lane in group.lanes:
                rest[lane] = [Signal(group.bits, name=f"code_{lane}_{c}", reset_less=True) for c in range(_CHANNELS)]
        with m.If(self._step), m.Switch(number):
            for step in range(self._steps):
                with m.Case(step):
                    self._operands(m, step, basis, rest, [stages[0] for stages in shifts])
        for stages in shifts:
            for i in range(2):
                with m.If(valid[i] & self._move):
                    m.d.sync += stages[i + 1].eq(stages[i])
        to = shape(sum_format(self.config.formats))
        for c in range(_CHANNELS):
            shifted = []
            for g, group in enumerate(self._groups):
                exact = [basis[i] * rest[i][c].as_signed() for i in group.lanes]
                products = [Signal(x.shape(), name=f"product_{i}_{c}", reset_less=True)
                            for i, x in zip(group.lanes, exact, strict=True)]
                with m.If(valid[0] & self._move):
                    m.d.sync += [product.eq(x) for product, x in zip(products, exact, strict=True)]
                sum_ = tree(products)
                held = Signal(sum_.shape(), name=f"group_{g}_{c}", reset_less=True)
                with m.If(valid[1] & self._move):
                    m.d.sync += held.eq(sum_)
                shifted.append((held << shifts[g][2])[: to.width].as_signed())
            running, now = Signal(to, name=f"sum_{c}", reset_less=True), Signal(to, name=f"sum_now_{c}")
            m.d.comb += now.eq(Mux(starts[2], 0, running) + sum(shifted[1:], shifted[0]))
            with m.If(valid[2] & self._move):
                m.d.sync += running.eq(now)
            with m.If(lasts[2] & self._move):
                m.d.sync += self._summed.total[c].eq(now)

    def _operands(
        self, m: Module, step: int, basis: list[Signal], rest: dict[int, list[Signal]], shifts: list[Signal],
    ) -> None:
        """Loads the operands of one step; without harmonics all codes count as 0."""
        record, there = compact_harmonics(self.config), self.sh_degree.any()
        for group, shift in zip(self._groups, shifts, strict=True):
            at = [step * self._lanes + lane for lane in group.lanes]
            known = [term for term in at if term < terms(self._degree)]
            if known:
                m.d.sync += shift.eq(self._exponent(band_of(known[0])))
            for lane, term in zip(group.lanes, at, strict=True):
                if term not in known:
                    m.d.sync += [operand.eq(0) for operand in rest[lane]]
                    continue
                band = band_of(term)
                place, bits = field_place(record, f"degree_{band + 1}")[0], BAND_BITS[band]
                place += _CHANNELS * (term - BANDS[band].start) * bits
                m.d.sync += basis[lane].eq(self.basis.payload[basis_name(term)])
                for c, operand in enumerate(rest[lane]):
                    code = self._harmonics[place + c * bits : place + (c + 1) * bits]
                    code = Cat(code, code[-1].replicate(group.bits - bits))
                    m.d.sync += operand.eq(code & there.replicate(group.bits))

    def _exponent(self, band: int) -> Value:
        """The shift of a band's products."""
        raw = self._harmonics[band * BAND_EXPONENT_BITS : (band + 1) * BAND_EXPONENT_BITS]
        most = BAND_EXPONENT_MOST[band]
        return Mux(raw > most, most, raw)
