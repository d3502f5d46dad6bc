"""Square root of a small float, and its reciprocal."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux

from rtl.float.iteration import Iteration, floored, midpoint, raised
from rtl.float.number import fields
from rtl.float.seed import Seed
from rtl.pipeline import Pipeline, Staged
from spec.formats import SmallFloat


class _Root(Iteration):
    """What both share. Operands are m * 2^e with even e and m in [1, 4); negative ones count as zero.

    Parameters:
        a, result: formats.
    """

    root = True
    quarters = 1

    def __init__(self, *, a: SmallFloat, result: SmallFloat) -> None:
        super().__init__({"a": a}, result)

    def _operand(self, p: Pipeline) -> tuple[Staged, Staged, Staged, Staged]:
        """(m with its two integer bits, seed, e / 2, whether positive)."""
        number = self._operands[0]
        a = fields(self.a, number)
        parity = a.exponent[0] ^ (number.bias & 1)
        m = p.data("m", Mux(parity, Cat(Const(0, 1), a.significand), Cat(a.significand, Const(0, 1))))
        half = p.data("half", (a.exponent - number.bias) >> 1)
        return m, self._first(p, a.significand, parity), half, p.data("positive", a.nonzero & ~a.negative)


class FloatRsqrt(_Root):
    """`result` = 1 / sqrt(a). Latency 8. That of zero, and of negative numbers, saturates.

    Stages: table; seed y0; y0^2; residual e = 1 - m y0^2; k from y0 + y0 e / 2; h^2; sign of 1 - m h^2; packed.

    Parameters:
        a, result: formats.
    """

    latency = 8

    def _square_frac(self, seed: Seed) -> int:
        """Fraction bits to which y0^2 is kept."""
        return min(self._result.sig_bits + 3, 2 * seed.frac_bits)

    def _keep(self, seed: Seed) -> int:
        """Fraction bits to which the residual enters Newton's step."""
        return min(self._result.sig_bits + 2, self._square_frac(seed) + self._operands[0].sig_bits - 1)

    def _error(self, seed: Seed) -> tuple[float, float]:
        # y0 (1 + e / 2) = (1 - e)^(1/2) (1 + e / 2) / sqrt(m) = (1 - 3/8 e^2 - 1/4 e^3 ...) / sqrt(m)
        w, ulp, square_frac = seed.worst, 2.0**-self._result.sig_bits, self._square_frac(seed)
        floor = 0.0 if square_frac == 2 * seed.frac_bits else (1 + w) * 2.0**-square_frac
        return ((0.375 + w) * w**2 + (1 + w) * 2.0 ** -(self._keep(seed) + 1)) / ulp, floor / ulp

    def stages(self, p: Pipeline) -> Staged:
        s, to, bits, ulp_bits = self._seed, self._result, self._operands[0].sig_bits, self._result.sig_bits
        square_frac, keep = self._square_frac(s), self._keep(s)
        m, y0, half, positive = self._operand(p)
        square = p.reg("square", lambda y: (y * y)[2 * s.frac_bits - square_frac :], y0)
        frac, bound = square_frac + bits - 1, s.worst + 2.0 ** (2 - square_frac)
        e = p.reg("e", lambda m, z: floored((1 << frac) - m * z, frac, keep, bound), m, square)
        k = p.reg("k", lambda y, e: self._step(y, s.frac_bits, y * e, s.frac_bits + keep + 1, ulp_bits), y0, e)
        h_square = p.reg("h_square", lambda k: midpoint(k) * midpoint(k), k)
        # |1 - m h^2| < sqrt(m) (2 + ulp) ulp < 8 ulp; from 4 result bits on the 1 is not in the window.
        one, window = 2 * ulp_bits + bits + 1, ulp_bits + bits + 5

        def above(m, square):
            return ~((1 << one) - m * square)[window - 1] if one < window else (m * square)[window - 1]

        up = p.reg("up", above, m, h_square)
        return p.reg(
            "outcome", lambda half, k, up, positive: self._pack(
                to.bias - 2 - half, k, up, negative=Const(0, 1), nonzero=Const(1, 1), infinite=~positive),
            half, k, up, positive)


class FloatSqrt(_Root):
    """`result` = sqrt(a). Latency 7. That of negative numbers is zero.

    Stages: table; seed y0 of the reciprocal; s0 = m y0; d = m - s0^2; k from s0 + y0 d / 2; sign of m - h^2; packed.

    Parameters:
        a, result: formats; a has at most twice the result's significand bits, lest roots be ties.
    """

    latency = 7

    def _check(self) -> None:
        if self._operands[0].sig_bits > 2 * self._result.sig_bits:
            raise ValueError(f"a must have at most twice the result's significand bits, not {self._operands[0]!r}")

    def _root_frac(self, seed: Seed) -> int:
        """Fraction bits of s0."""
        return seed.frac_bits + 1

    def _residual_frac(self, seed: Seed) -> int:
        """Fraction bits of d."""
        return max(2 * self._root_frac(seed), self._operands[0].sig_bits - 1)

    def _keep(self, seed: Seed) -> int:
        """Fraction bits to which d enters Newton's step."""
        return min(self._result.sig_bits + 1, self._residual_frac(seed))

    def _bounds(self, seed: Seed) -> tuple[float, float]:
        """Relative errors of y0 and of s0."""
        of_seed = seed.worst / 2 * (1 + seed.worst)
        return of_seed, of_seed + 2.0 ** -self._root_frac(seed)

    def _error(self, seed: Seed) -> tuple[float, float]:
        # With y0 = (1 - a) / s and s0 = s (1 - b): s0 + y0 d / 2 = s (1 - b^2 / 2 - a b + a b^2 / 2), and s < 2.
        (a, b), ulp = self._bounds(seed), 2.0 ** (1 - self._result.sig_bits)
        return (b * b + 2 * a * b * (1 + b) + (1 + a) * 2.0 ** -(self._keep(seed) + 1)) / ulp, (a * a + 2 * a * b * b) / ulp

    def stages(self, p: Pipeline) -> Staged:
        s, to, bits, ulp_bits = self._seed, self._result, self._operands[0].sig_bits, self._result.sig_bits - 1
        s0_frac, d_frac, keep = self._root_frac(s), self._residual_frac(s), self._keep(s)
        m, y0, half, positive = self._operand(p)
        frac = s.frac_bits + bits - 1
        s0 = p.reg("s0", lambda m, y: raised(m * y, max(0, s0_frac - frac))[max(0, frac - s0_frac) :][: s0_frac + 2], m, y0)
        bound = 8 * self._bounds(s)[1]
        d = p.reg("d", lambda m, r: floored(
            raised(m, d_frac - bits + 1) - raised(r * r, d_frac - 2 * s0_frac), d_frac, keep, bound), m, s0)
        k = p.reg("k", lambda r, y, d: self._step(r, s0_frac, y * d, s.frac_bits + keep + 1, ulp_bits), s0, y0, d)
        # |m - h^2| < (2 s + ulp) ulp < 8 ulp; both have 2 ulp_bits + 2 fraction bits.
        up = p.reg("up", lambda m, k: ~(raised(m, 2 * ulp_bits + 3 - bits) - midpoint(k) * midpoint(k))[ulp_bits + 5], m, k)
        return p.reg(
            "outcome", lambda half, k, up, positive: self._pack(
                to.bias - 1 + half, k, up, negative=Const(0, 1), nonzero=positive),
            half, k, up, positive)
