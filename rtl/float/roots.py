"""The square root of a small float, and the reciprocal of the square root."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Mux

from rtl.float.iteration import Iteration, midpoint, raised, residual_bits, square
from rtl.float.number import Let, fields, product
from rtl.float.seed import Seed
from rtl.pipeline import Pipeline, Staged
from spec.formats import SmallFloat


class _Root(Iteration):
    """The parts that both roots share. An operand is m * 2^e with even e and m in [1, 4); negative operands count as zero.

    Parameters:
        a, result: formats.
    """

    root = True
    quarters = 1

    def __init__(self, *, a: SmallFloat, result: SmallFloat) -> None:
        super().__init__({"a": a}, result)

    def _operand(self, p: Pipeline, let: Let) -> tuple[Staged, Staged, Staged, Staged]:
        """(m with its two integer bits, seed, e / 2, whether positive)."""
        number = self._operands[0]
        a = fields(self.a, number)
        parity = a.exponent[0] ^ (number.bias & 1)
        m = p.data("m", Mux(parity, Cat(Const(0, 1), a.significand), Cat(a.significand, Const(0, 1))))
        half = p.data("half", (a.exponent - number.bias) >> 1)
        return m, self._first(p, let, a.significand, parity), half, p.data("positive", a.nonzero & ~a.negative)


class FloatRsqrt(_Root):
    """`result` = 1 / sqrt(a). Throughput: one result per cycle. Latency: 9 cycles. For zero and negative a the result
    saturates.

    Stages, where k and h are those of `rtl.float.iteration`: table; seed y0; s0 = m y0; residual e = 1 - s0 y0; k from
    y0 + y0 e / 2; h^2; two stages for m h^2, which gives the sign of 1 - m h^2; packing.

    Parameters:
        a, result: formats.
    """

    latency = 9

    def _root_frac(self, seed: Seed) -> int:
        """Fraction bits of s0."""
        return min(self._result.sig_bits + 2, seed.frac_bits + self._operands[0].sig_bits - 1)

    def _keep(self, seed: Seed) -> int:
        """Fraction bits of the residual that enter the Newton step."""
        return min(self._result.sig_bits + 1, self._root_frac(seed) + seed.frac_bits)

    def _error(self, seed: Seed) -> tuple[float, float]:
        # y0 (1 + e / 2) = (1 - e)^(1/2) (1 + e / 2) / sqrt(m) = (1 - 3/8 e^2 - 1/8 e^3 ...) / sqrt(m)
        w, ulp = seed.worst, 2.0**-self._result.sig_bits
        below = (0.375 + w) * w**2 + (1 + w) * 2.0 ** -(self._keep(seed) + 1)
        return below / ulp, (1 + w) * 2.0 ** -(self._root_frac(seed) + 1) / ulp

    def stages(self, p: Pipeline, let: Let) -> Staged:
        s, to, bits, ulp_bits = self._seed, self._result, self._operands[0].sig_bits, self._result.sig_bits
        s0_frac, keep = self._root_frac(s), self._keep(s)
        m, y0, half, positive = self._operand(p, let)
        s0 = p.reg("s0", lambda m, y: (m * y)[s.frac_bits + bits - 1 - s0_frac :][: s0_frac + 2], m, y0)
        frac, bound = s0_frac + s.frac_bits, s.worst + 2.0**-s0_frac
        e = p.reg("e", lambda r, y: residual_bits(let, r * y - (1 << frac), frac, keep, bound), s0, y0)
        k = p.reg("k", lambda y, e: self._step(let, y, s.frac_bits, y, e, s.frac_bits + keep + 1, ulp_bits), y0, e)
        h_square = p.reg("h_square", lambda k: let("h_square", square(midpoint(k))), k)
        # |1 - m h^2| < sqrt(m) (2 + ulp) ulp < 8 ulp, so low bits show its sign. With 4 result bits or more they exclude the 1.
        one, window = 2 * ulp_bits + bits + 1, ulp_bits + bits + 5
        up = product(p, let, "m_h_square", h_square, m).map(lambda x: (x - (1 << one) if one < window else x)[window - 1])
        return p.reg(
            "outcome", lambda half, k, up, positive: self._pack(
                let, to.bias - 2 - half, k, up, negative=Const(0, 1), nonzero=Const(1, 1), infinite=~positive),
            half, k, up, positive)


class FloatSqrt(_Root):
    """`result` = sqrt(a). Throughput: one result per cycle. Latency: 7 cycles. For negative a the result is zero.

    Stages, where k and h are those of `rtl.float.iteration`: table; seed y0 of 1 / sqrt(m); s0 = m y0; residual d = m - s0^2;
    k from s0 + y0 d / 2; sign of m - h^2; packing.

    Parameters:
        a, result: formats; a has at most twice the result's significand bits, because roots could otherwise be ties.
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
        """Fraction bits of d that enter the Newton step."""
        return min(self._result.sig_bits + 1, self._residual_frac(seed))

    def _bounds(self, seed: Seed) -> tuple[float, float]:
        """Bounds of the relative errors of y0 and of s0."""
        of_seed = seed.worst / 2 * (1 + seed.worst)
        return of_seed, of_seed + 2.0 ** -self._root_frac(seed)

    def _error(self, seed: Seed) -> tuple[float, float]:
        # Let s = sqrt(m), y0 = (1 - a) / s, s0 = s (1 - b). Then s0 + y0 d / 2 = s (1 - b^2 / 2 - a b + a b^2 / 2), and s < 2.
        (a, b), ulp = self._bounds(seed), 2.0 ** (1 - self._result.sig_bits)
        return (b * b + 2 * a * b * (1 + b) + (1 + a) * 2.0 ** -(self._keep(seed) + 1)) / ulp, (a * a + 2 * a * b * b) / ulp

    def stages(self, p: Pipeline, let: Let) -> Staged:
        s, to, bits, ulp_bits = self._seed, self._result, self._operands[0].sig_bits, self._result.sig_bits - 1
        s0_frac, d_frac, keep = self._root_frac(s), self._residual_frac(s), self._keep(s)
        m, y0, half, positive = self._operand(p, let)
        frac = s.frac_bits + bits - 1
        s0 = p.reg("s0", lambda m, y: (m * raised(y, max(0, s0_frac - frac)))[max(0, frac - s0_frac) :][: s0_frac + 2], m, y0)
        bound = 8 * self._bounds(s)[1]
        d = p.reg("d", lambda m, r: residual_bits(
            let, raised(square(r), d_frac - 2 * s0_frac) - raised(m, d_frac - bits + 1), d_frac, keep, bound), m, s0)
        k = p.reg("k", lambda r, y, d: self._step(let, r, s0_frac, y, d, s.frac_bits + keep + 1, ulp_bits), s0, y0, d)
        # |m - h^2| < (2 s + ulp) ulp < 8 ulp, so low bits show its sign; m and h^2 have 2 ulp_bits + 2 fraction bits here.
        up = p.reg("up", lambda m, k: (square(midpoint(k)) - raised(m, 2 * ulp_bits + 3 - bits))[ulp_bits + 5], m, k)
        return p.reg(
            "outcome", lambda half, k, up, positive: self._pack(
                let, to.bias - 1 + half, k, up, negative=Const(0, 1), nonzero=positive),
            half, k, up, positive)
