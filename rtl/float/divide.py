"""The reciprocal and the quotient of small floats."""

from __future__ import annotations

from amaranth.hdl import Const, Mux

from rtl.float.iteration import Iteration, midpoint, raised, residual_bits
from rtl.float.number import Let, fields
from rtl.float.seed import Seed
from rtl.pipeline import Pipeline, Staged
from spec.formats import SmallFloat


class FloatReciprocal(Iteration):
    """`result` = 1 / a. Throughput: one result per cycle. Latency: 6 cycles. The reciprocal of zero saturates and is positive.

    Stages, where m is a's significand and k and h are those of `rtl.float.iteration`: table; seed y0; residual e = 1 - m y0;
    k from y0 + y0 e; sign of 1 - m h; packing.

    Parameters:
        a, result: formats.
    """

    latency = 6
    root = False
    quarters = 2

    def __init__(self, *, a: SmallFloat, result: SmallFloat) -> None:
        super().__init__({"a": a}, result)

    def _keep(self, seed: Seed) -> int:
        """Fraction bits of the residual that enter the Newton step."""
        return min(self._result.sig_bits + 2, seed.frac_bits + self._operands[0].sig_bits - 1)

    def _error(self, seed: Seed) -> tuple[float, float]:
        # With e = 1 - m y0: y0 (1 + e) = (1 - e^2) / m.
        return (seed.worst**2 + (1 + seed.worst) * 2.0 ** -self._keep(seed)) * 2.0**self._result.sig_bits, 0.0

    def stages(self, p: Pipeline, let: Let) -> Staged:
        number, to, s = self._operands[0], self._result, self._seed
        a, bits, keep = fields(self.a, number), number.sig_bits, self._keep(s)
        m, y0 = p.data("m", a.significand), self._first(p, let, a.significand)
        frac, bias = s.frac_bits + bits - 1, to.bias + number.bias - 2
        e = p.reg("e", lambda m, y: residual_bits(let, m * y - (1 << frac), frac, keep, s.worst), m, y0)
        k = p.reg("k", lambda y, e: self._step(let, y, s.frac_bits, y, e, s.frac_bits + keep, to.sig_bits), y0, e)
        # |1 - m h| < m ulp, so the low bits of m h, in which the 1 does not appear, show the sign.
        up = p.reg("up", lambda m, k: (m * midpoint(k))[bits + 1], m, k)
        return p.reg(
            "outcome", lambda exponent, k, up, negative, nonzero: self._pack(
                let, bias - exponent, k, up, negative=negative & nonzero, nonzero=Const(1, 1), infinite=~nonzero),
            p.data("exponent", a.exponent), k, up, p.data("negative", a.negative), p.data("nonzero", a.nonzero))


class FloatDivide(Iteration):
    """`result` = a / b. Throughput: one result per cycle. Latency: 7 cycles.

    A division by zero saturates and has a's sign, or gives zero where a is zero.

    m is b's significand; n is a's, doubled where it is smaller than m, so that n / m lies in [1, 2). k and h are those of
    `rtl.float.iteration`. Stages: table; seed y0 of 1 / m; q0 = n y0; residual d = n - m q0; k from q0 + y0 d; sign of n - m h;
    packing.

    Parameters:
        a, b, result: formats; a has no more significand bits than the result, because quotients could otherwise be ties.
    """

    latency = 7
    root = False
    quarters = 1

    def __init__(self, *, a: SmallFloat, b: SmallFloat, result: SmallFloat) -> None:
        super().__init__({"a": a, "b": b}, result)

    def _check(self) -> None:
        if self._operands[0].sig_bits > self._result.sig_bits:
            raise ValueError(f"a must have no more significand bits than the result, not {self._operands[0]!r}")

    def _quotient_frac(self, seed: Seed) -> int:
        """Fraction bits of q0."""
        return seed.frac_bits + 1

    def _residual_frac(self, seed: Seed) -> int:
        """Fraction bits of d."""
        return max(self._operands[0].sig_bits, self._operands[1].sig_bits + self._quotient_frac(seed)) - 1

    def _keep(self, seed: Seed) -> int:
        """Fraction bits of d that enter the Newton step."""
        return min(self._result.sig_bits + 1, self._residual_frac(seed))

    def _error(self, seed: Seed) -> tuple[float, float]:
        # Let q = n / m, y0 = (1 - e) / m, q0 = q (1 - b). Then q0 + y0 d = q (1 - e b), where e <= b <= e + floor and q < 2.
        floor, ulp = 2.0 ** -self._quotient_frac(seed), 2.0 ** (1 - self._result.sig_bits)
        return (2 * seed.worst * (seed.worst + floor) + (1 + seed.worst) * 2.0 ** -self._keep(seed)) / ulp, floor**2 / 2 / ulp

    def stages(self, p: Pipeline, let: Let) -> Staged:
        (a_format, b_format), to, s = self._operands, self._result, self._seed
        a, b = fields(self.a, a_format), fields(self.b, b_format)
        a_bits, bits, ulp_bits = a_format.sig_bits, b_format.sig_bits, to.sig_bits - 1
        widest = max(a_bits, bits)
        less = p.reg("less", lambda x: x, p.data("less", raised(a.significand, widest - a_bits) < raised(
            b.significand, widest - bits)))
        n = p.reg("n", lambda n, less: Mux(less, n << 1, n), p.data("a", a.significand), less)
        m, y0 = p.data("m", b.significand), self._first(p, let, b.significand)
        q_frac, d_frac, keep = self._quotient_frac(s), self._residual_frac(s), self._keep(s)
        frac = s.frac_bits + a_bits - 1
        q0 = p.reg("q0", lambda n, y: (n * raised(y, max(0, q_frac - frac)))[max(0, frac - q_frac) :][: q_frac + 2], n, y0)
        bound = 4 * (s.worst + 2.0**-q_frac)
        d = p.reg("d", lambda n, m, q: residual_bits(
            let, m * raised(q, d_frac - bits + 1 - q_frac) - raised(n, d_frac - a_bits + 1), d_frac, keep, bound), n, m, q0)
        k = p.reg("k", lambda q, y, d: self._step(let, q, q_frac, y, d, s.frac_bits + keep, ulp_bits), q0, y0, d)
        # |n - m h| < m ulp, so the low bits of m h - n, in units of 2^-(bits + ulp_bits), show the sign.
        up = p.reg("up", lambda n, m, k: (m * midpoint(k) - raised(n, bits + ulp_bits - a_bits + 1))[bits + 1], n, m, k)
        bias = to.bias - a_format.bias + b_format.bias - 1
        exponent = p.data("exponent", a.exponent - b.exponent).to(1)
        exponent = p.reg("exponent", lambda e, less: e + bias - less, exponent, less)
        return p.reg(
            "outcome", lambda exponent, k, up, negative, nonzero, finite: self._pack(
                let, exponent, k, up, negative=negative, nonzero=nonzero, infinite=~finite),
            exponent, k, up, p.data("negative", a.negative ^ (b.negative & b.nonzero)), p.data("nonzero", a.nonzero),
            p.data("finite", b.nonzero))
