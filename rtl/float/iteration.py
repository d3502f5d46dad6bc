"""Reciprocals, quotients and roots: a table, one step of Newton, and the sign of an exact residual.

They are correctly rounded without an argument about an approximation's last bits. With ulp the result's:

1. a table of straight lines gives a seed good to about half of the bits wanted;
2. one step of Newton gives an approximation at most half an ulp from the exact result, once a constant has centred its
   error; k is its floor in ulps, so the exact result rounds to k or to k + 1;
3. the sign of an exact residual tells on which side of h = k + 1/2 it lies. It cannot lie there: the midpoint has one bit
   more than the result, and its product or square more than the operand. The residual is of the order of ulps, so the
   low bits of its products suffice.

Area decided, by estimate: a quadratic table instead of seed and step needs 64 segments of 50 bits against 16 of 21 for 20-bit
reciprocals and as much multiplier; a recurrence of one digit a stage has as many adders and several times the registers.
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
    """The steps in common; the table is of the last operand's significand.

    Attributes:
        root: whether the table is of 1/sqrt(m), and not of 1/m.
        quarters: quarters of an ulp that centre the error of Newton's step.
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
        """ValueError where a result could be a tie."""

    def _error(self, seed: Seed) -> tuple[float, float]:
        """How far Newton's step may lie below and above the exact result, in ulps."""
        raise NotImplementedError

    def _fits(self, below: float, above: float) -> bool:
        return below <= 0.5 + self.quarters / 4 and above <= 0.5 - self.quarters / 4

    def _first(self, p: Pipeline, let: Let, significand: Value, parity: Value | None = None) -> Staged:
        """Stages 1 and 2: the table and its straight line."""
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
        """k: first + y * residual + the centring constant, floored to multiples of 2^-ulp_bits.

        `correction_frac` is the product's fraction; the residual is as `residual_bits` gives it.
        """
        frac = max(first_frac, correction_frac, ulp_bits + 2)
        residual = raised(residual, frac - correction_frac)
        constant = self.quarters << (frac - ulp_bits - 2)
        total = y * residual + raised(first, frac - first_frac) + constant - raised(y, len(residual) - 1)
        return let("step", total[frac - ulp_bits :][: self._result.sig_bits + 1])

    def _pack(self, let: Let, exponent: Value, k: Value, up: Value, **conditions: Value) -> Value:
        """The result k + up ulps; `exponent` is that of k's leading one, less one for adding it."""
        total = Cat(Const(0, self._result.sig_bits - 1), as_integer(exponent)).as_signed() + k + up
        return pack(let, self._result, total, **conditions)


def _look_up(table: tuple[int, ...], index: Value) -> Value:
    constants = [Const(c, max(table).bit_length()) for c in table]
    return Array(constants)[index] if len(constants) > 1 else constants[0]


def midpoint(k: Value) -> Value:
    """h in half ulps."""
    return Cat(Const(1, 1), k)


def raised(x: Value, shift: int) -> Value:
    """Unsigned x * 2^shift."""
    return Cat(Const(0, shift), x)


def residual_bits(let: Let, negated: Value, frac_bits: int, keep: int, bound: float) -> Value:
    """-`negated`, which has `frac_bits` fraction bits and is below `bound`, to `keep` of them, plus half of the field's range.

    The offset spares a signed product and costs an inverter. What is left out lowers the residual by up to 2^-keep.
    """
    width = int(bound * 2.0**keep + 1).bit_length() + 1
    bits = let("residual", negated[frac_bits - keep :][:width])
    return Cat(~bits[:-1], bits[-1])


def square(x: Value) -> Value:
    """x * x of an unsigned value, with half the partial products."""
    total = Cat(*(Cat(bit, Const(0, 1)) for bit in x))
    for i in range(1, len(x)):
        total = total + raised(x[:i] & x[i].replicate(i), i + 1)
    return total[: 2 * len(x)]
