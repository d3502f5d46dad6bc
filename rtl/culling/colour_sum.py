"""Multiplies spherical harmonics by the coefficients of a splat's colour record and sums the products of each channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from amaranth.hdl import Array, Cat, Const, Module, Mux, ShapeLike, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.culling.harmonics import basis_name
from rtl.shapes import layout, shape
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import sum_format, terms
from spec.memory import BEAT_BYTES, colour_beats, read_data
from spec.records import gaussian_colour

BEAT_WIDTH = 8 * BEAT_BYTES
_CHANNELS = 3


def colour_sum_layout(config: AcceleratorConfig, carried: ShapeLike) -> data.StructLayout:
    """A splat's sums over the coefficients, raw `sum_format`; its base colours, raw `sh_dc`; and the carried data."""
    n = config.formats
    return data.StructLayout({
        "total": data.ArrayLayout(shape(sum_format(n)), _CHANNELS),
        "dc": data.ArrayLayout(shape(n.sh_dc), _CHANNELS * MAX_LEVELS),
        "carried": carried,
    })


def basis_layout(config: AcceleratorConfig, sh_degree: int, carried: ShapeLike) -> data.StructLayout:
    """A splat's basis functions beyond the first, raw `sh_basis`, and the carried data, as the datapath outputs them."""
    basis = shape(config.formats.sh_basis)
    return data.StructLayout({**{basis_name(i): basis for i in range(terms(sh_degree))}, "carried": carried})


@dataclass(frozen=True)
class Step:
    """One step through a colour record.

    Attributes:
        terms: the basis functions that are multiplied in this step.
        base: the beat of the record in which their coefficients begin; for the first step, the beat of the base colours.
        end: for every degree, the beat after the last one that the step reads.
    """

    terms: range
    base: int
    end: tuple[int, ...]


def record_steps(config: AcceleratorConfig, sh_degree: int, lanes: int) -> list[Step]:
    """The steps through a record of a degree, with `lanes` basis functions each; there is at least one step."""
    count, steps = terms(sh_degree), []
    for first in range(0, max(count, 1), max(lanes, 1)):
        group = range(first, min(first + lanes, count))
        ends = [min(coefficient_place(config, group.stop), gaussian_colour(config, d).width) for d in range(sh_degree + 1)]
        base = coefficient_place(config, first) // BEAT_WIDTH if first else 0
        steps.append(Step(group, base, tuple((end - 1) // BEAT_WIDTH + 1 for end in ends)))
        if steps[-1].end[-1] > base + 2:
            raise ValueError(f"lanes must be so few that a step reads at most two beats, not {lanes!r}")
    return steps


def coefficient_place(config: AcceleratorConfig, term: int) -> int:
    """The first bit of a term's coefficients in the record."""
    n = config.formats
    return _CHANNELS * (MAX_LEVELS * n.sh_dc.width + term * n.sh_rest.width)


def by_degree(sh_degree: Value, numbers: Sequence[int]) -> Value:
    """The constant for a degree; degrees beyond the last constant get the last one."""
    constants = [Const(number, max(numbers).bit_length()) for number in numbers]
    return Value.cast(Array([*constants, *constants[-1:] * (4 - len(constants))])[sh_degree])


class ColourSum(wiring.Component):
    """Multiplies and accumulates `lanes` basis functions for three channels per cycle, without rounding.

    The unit holds two beats of the record. Each step reads its coefficients at fixed positions of these beats, and a beat is
    dropped when it is used up. The steps of a splat follow each other without a gap, and so do splats, while one beat comes per
    cycle. In the waveform, 0' is beat 0 of the next record::

        lanes 4       0    1    2    3    4    5    6    7    8
        step          0    1    2    3    0    1    2    3
        beats held    0,1  1,2  1,2  2,0' 0,1  1,2  1,2  2,0'
        operands           0    1    2    3    0    1    2    3
        products                0    1    2    3    0    1    2
        sums                                   ^              (held until they are taken)

    Parameters:
        config: the machine.
        sh_degree: degree of the largest records.
        lanes: basis functions per cycle, 0 for degree 0.
        carried: shape of the data that passes the unit with a splat.

    Ports:
        basis: `basis_layout` items; each is taken with its splat's last step.
        data: the splats' colour records, `colour_beats` beats each.
        sums: `colour_sum_layout` items, in order.
        sh_degree: degree of the records, at most the parameter; basis functions beyond it count as 0.
        idle: no beat of the last record is left.

    Throughput: one splat every max(steps, beats, 3) cycles, where steps is the number of the degree's terms divided by `lanes`.
    A splat makes its last step only when the sums of the splat before have been taken. Latency: 3 cycles from the last step to
    `sums`.
    """

    def __init__(self, config: AcceleratorConfig, *, sh_degree: int, lanes: int, carried: ShapeLike) -> None:
        self.config, self._degree, self._lanes, self._carried = config, sh_degree, lanes, carried
        self._steps = record_steps(config, sh_degree, lanes)
        super().__init__({
            "basis": In(stream.Signature(basis_layout(config, sh_degree, carried))),
            "data": In(stream.Signature(layout(read_data(config)))),
            "sums": Out(stream.Signature(colour_sum_layout(config, carried))),
            "sh_degree": In(2),
            "idle": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        step, number, first, last = Signal(), Signal(range(len(self._steps))), Signal(), Signal()
        beats = self._beats(m, step, number, last)
        lasts = Signal(2)  # whether the step in the operand registers, and that in the product registers, is a splat's last
        free = ~lasts.any() & (~self.sums.valid | self.sums.ready)
        m.d.comb += [
            first.eq(number == 0),
            last.eq(number == self._by_degree(lambda d: len(self._degree_steps(d)) - 1)),
            step.eq(self.basis.valid & beats.enough & (~last | free)),
            self.basis.ready.eq(step & last),
        ]
        with m.If(step):
            m.d.sync += number.eq(Mux(last, 0, number + 1))
        self._base_colours(m, step, first, last, beats.bits)
        with m.If(self.sums.ready):
            m.d.sync += self.sums.valid.eq(0)
        m.d.sync += lasts.eq(Cat(step & last, lasts[0]))
        with m.If(lasts[1]):
            m.d.sync += self.sums.valid.eq(1)
        if self._lanes:
            self._multiply(m, step, number, first, beats.bits, lasts[1])
        return m

    def _degree_steps(self, degree: int) -> list[Step]:
        """The steps for a record of a degree."""
        return [s for s in self._steps if s.terms.start < max(terms(degree), 1)]

    def _by_degree(self, number: Callable[[int], int]) -> Value:
        """A constant, chosen by the setting `sh_degree`."""
        return by_degree(self.sh_degree, [number(d) for d in range(self._degree + 1)])

    def _beats(self, m: Module, step: Signal, number: Signal, last: Signal) -> _Beats:
        """The two beats that are held: their bits, and whether they suffice for the step."""
        held = [Signal(BEAT_WIDTH, name=f"beat_{i}", reset_less=True) for i in range(2)]
        place, count, move, taken = Signal(2), Signal(2), Signal(), Signal()
        base, following, end = Signal(2), Signal(2), Signal(2)
        with m.Switch(number):
            for i, s in enumerate(self._steps):
                with m.Case(i):
                    after = self._steps[i + 1].base if i + 1 < len(self._steps) else 0
                    ends = self._by_degree(s.end.__getitem__)
                    m.d.comb += [base.eq(s.base), following.eq(after), end.eq(ends)]
        beats = self._by_degree(lambda d: colour_beats(self.config, d))
        enough = (place == base) & (place + count >= end)
        m.d.comb += move.eq((count != 0) & Mux(step, last | (following != place), place != base))
        m.d.comb += [
            self.data.ready.eq(~count[1] | move),
            self.idle.eq(place == 0),
            taken.eq(self.data.valid & self.data.ready),
        ]
        m.d.sync += count.eq(count + taken - move)
        with m.If(move):
            m.d.sync += [held[0].eq(held[1]), place.eq(Mux(place + 1 == beats, 0, place + 1))]
        incoming = self.data.payload.word.as_value()
        with m.If(taken):
            with m.If(count - move == 0):
                m.d.sync += held[0].eq(incoming)
            with m.Else():
                m.d.sync += held[1].eq(incoming)
        return _Beats(enough, Cat(*held))

    def _base_colours(self, m: Module, step: Signal, first: Signal, last: Signal, bits: Value) -> None:
        """Holds the base colours and the carried data from the last step until the sums are taken."""
        payload = self.sums.payload
        width = len(payload.dc.as_value())
        early = Signal(width, reset_less=True)
        with m.If(step & first):
            m.d.sync += early.eq(bits[:width])
        with m.If(step & last):
            m.d.sync += [
                payload.dc.eq(Mux(first, bits[:width], early)), payload.carried.eq(self.basis.payload.carried)]

    def _multiply(self, m: Module, step: Signal, number: Signal, first: Signal, bits: Value, last: Value) -> None:
        """Three stages: registers for operands, for products, and for sums."""
        n, total = self.config.formats, self.sums.payload.total
        basis = [Signal(shape(n.sh_basis), name=f"basis_operand_{i}", reset_less=True) for i in range(self._lanes)]
        rest = [[Signal(shape(n.sh_rest), name=f"rest_operand_{i}_{c}", reset_less=True) for c in range(_CHANNELS)]
                for i in range(self._lanes)]
        with m.If(step), m.Switch(number):
            for i, s in enumerate(self._steps):
                with m.Case(i):
                    self._operands(m, s, bits, basis, rest)
        valid, starts = Signal(2), Signal(2)
        m.d.sync += [valid.eq(Cat(step, valid[0])), starts.eq(Cat(first, starts[0]))]
        for c in range(_CHANNELS):
            exact = [basis[i] * rest[i][c] for i in range(self._lanes)]
            products = [Signal(x.shape(), name=f"product_{i}_{c}", reset_less=True) for i, x in enumerate(exact)]
            with m.If(valid[0]):
                m.d.sync += [product.eq(x) for product, x in zip(products, exact, strict=True)]
            running, now = Signal(shape(sum_format(n)), name=f"sum_{c}", reset_less=True), Signal(
                shape(sum_format(n)), name=f"sum_now_{c}")
            m.d.comb += now.eq(Mux(starts[1], 0, running) + tree(products))
            with m.If(valid[1]):
                m.d.sync += running.eq(now)
            with m.If(last):
                m.d.sync += total[c].eq(now)

    def _operands(self, m: Module, s: Step, bits: Value, basis: list[Signal], rest: list[list[Signal]]) -> None:
        """Loads the operands of one step; coefficients beyond the record count as 0."""
        width = self.config.formats.sh_rest.width
        for i in range(self._lanes):
            if i >= len(s.terms):
                m.d.sync += [operand.eq(0) for operand in rest[i]]
                continue
            term = s.terms[i]
            least = next(d for d in range(4) if terms(d) > term)
            m.d.sync += basis[i].eq(self.basis.payload[basis_name(term)])
            for c, operand in enumerate(rest[i]):
                place = coefficient_place(self.config, term) + c * width - s.base * BEAT_WIDTH
                inside = (self.sh_degree >= least).replicate(width)
                m.d.sync += operand.eq((bits[place : place + width] & inside).as_signed())


@dataclass(frozen=True)
class _Beats:
    """The bits of the beats that are held, and whether they suffice for the step."""

    enough: Value
    bits: Value


def tree(values: list[Value]) -> Value:
    """The sum of the values as a balanced tree."""
    middle = len(values) // 2
    return values[0] if len(values) == 1 else tree(values[:middle]) + tree(values[middle:])
