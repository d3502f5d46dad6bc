"""Reciprocals, quotients and roots by a table, one Newton step, and the sign of an exact residual.

The results are correctly rounded. This needs no proof about the last bits of an approximation (an ulp is one of the result):

1. A table of straight lines gives a seed with about half of the bits of the result.
2. One Newton step, plus a constant that centres its error, gives an approximation within half an ulp of the exact result. k is
   this approximation rounded down to ulps, so the correctly rounded result is k or k + 1.
3. The sign of an exact residual tells on which side of the midpoint h = k + 1/2 the exact result lies. The exact result is
   never h itself: h has one bit more than the result, and its product or square has more bits than the operand. The residual is
   of the order of ulps, so the low bits of its products suffice.

This method was chosen by estimates of the area. For 20-bit reciprocals a quadratic table instead of seed and step needs 64
segments of 50 bits, against 16 of 21 bits, and equally large multipliers. A recurrence with one digit per stage needs as many
adders and several times the registers.
"""

from __future__ import annotations

from collections.abc import Mapping

from amaranth.hdl import Array, Cat, Const, Value

from rtl.fixed import as_integer
from rtl.float.number import Let, pack
from rtl.float.seed import Seed, seeds
from rtl.float.unit import FloatUnit, check_kind
from rtl.pipeline import Pipeline, Staged
from rtl.shapes import shape
from spec.formats import SmallFloat


class Iteration(FloatUnit):
    """The steps that all units of this kind share. The table is addressed by the last operand's significand m.

    Attributes:
        root: whether the table approximates 1/sqrt(m) instead of 1/m.
        quarters: the constant that centres the error of the Newton step, in quarters of an ulp.
    """

    root: bool
    quarters: int

    def __init__(self, operands: Mapping[str, SmallFloat], result: SmallFloat) -> None:
        for name, number in (*operands.items(), ("result", result)):
            check_kind(name, number, SmallFloat)
        self._operands, self._result = tuple(operands.values()), result
        self._check()
        bits = self._operands[-1].sig_bits
        found = next((s for s in seeds(self.root, bits) if self._fits(*self._error(s))), None)
        if found is None:
            raise ValueError(f"result must be within reach of one step from a table of {bits} bits, not {result!r}")
        self._seed = found
        super().__init__({name: shape(number) for name, number in operands.items()}, result)

    def _check(self) -> None:
        """Raises ValueError where a result could be a tie."""

    def _error(self, seed: Seed) -> tuple[float, float]:
        """The largest distances, in ulps, by which the Newton step may lie below and above the exact result."""
        raise NotImplementedError

    def _fits(self, below: float, above: float) -> bool:
        return below <= 0.5 + self.quarters / 4 and above <= 0.5 - self.quarters / 4

    def _first(self, p: Pipeline, let: Let, significand: Value, parity: Value | None = None) -> Staged:
        """Stages 1 and 2: the table, and the straight line of the segment, which is the seed."""
        s, fraction = self._seed, significand[:-1]
        used = fraction[len(fraction) - s.index_bits - s.t_bits :]
        index = p.data("index", used[s.t_bits :] if parity is None else Cat(used[s.t_bits :], parity))
        offset, slope = (p.reg(name, lambda i, table=table: _look_up(table, i), index)
                         for name, table in (("offset", s.offset), ("slope", s.slope)))
        width = max(s.offset).bit_length()
        return p.reg(
            "seed", lambda o, c, t: let("line", raised(o, s.slope_frac) - c * t)[s.slope_frac :][:width],
            offset, slope, p.data("t", used[: s.t_bits]).to(1))

    def _step(
        self, let: Let, first: Value, first_frac: int, y: Value, residual: Value, correction_frac: int, ulp_bits: int,
    ) -> Value:
        """k: first + y * residual + the centring constant, rounded down to multiples of 2^-ulp_bits.

        `correction_frac` is the number of fraction bits of y * residual; `residual` is the result of `residual_bits`.
        """
        frac = max(first_frac, correction_frac, ulp_bits + 2)
        residual = raised(residual, frac - correction_frac)
        constant = self.quarters << (frac - ulp_bits - 2)
        total = y * residual + raised(first, frac - first_frac) + constant - raised(y, len(residual) - 1)
        return let("step", total[frac - ulp_bits :][: self._result.sig_bits + 1])

    def _pack(self, let: Let, exponent: Value, k: Value, up: Value, **conditions: Value) -> Value:
        """The packed result, k + up ulps. `exponent` is that of k's leading one minus 1, because adding k adds 1 to it."""
        total = Cat(Const(0, self._result.sig_bits - 1), as_integer(exponent)).as_signed() + k + up
        return pack(let, self._result, total, **conditions)


def _look_up(table: tuple[int, ...], index: Value) -> Value:
    constants = [Const(c, max(table).bit_length()) for c in table]
    return Array(constants)[index] if len(constants) > 1 else constants[0]


def midpoint(k: Value) -> Value:
    """The midpoint h = k + 1/2 as a number of half ulps."""
    return Cat(Const(1, 1), k)


def raised(x: Value, shift: int) -> Value:
    """x * 2^shift for unsigned x."""
    return Cat(Const(0, shift), x)


def residual_bits(let: Let, negated: Value, frac_bits: int, keep: int, bound: float) -> Value:
    """-`negated` cut to `keep` fraction bits, plus half of the result's range; `negated` has `frac_bits` fraction bits and a
    magnitude below `bound`.

    The offset makes the result unsigned, so that no signed product is needed; it costs one inverter. The bits that are cut off
    lower the residual by up to 2^-keep.
    """
    width = int(bound * 2.0**keep + 1).bit_length() + 1
    bits = let("residual", negated[frac_bits - keep :][:width])
    return Cat(~bits[:-1], bits[-1])


def square(x: Value, plus: Value | None = None) -> Value:
    """x * x, or x * x + plus, for unsigned x, with half as many partial products as a general multiplier. The sum must have no
    more than twice the bits of x."""
    total = Cat(*(Cat(bit, Const(0, 1)) for bit in x))
    total = total if plus is None else total + plus
    for i in range(1, len(x)):
        total = total + raised(x[:i] & x[i].replicate(i), i + 1)
    return total[: 2 * len(x)]
