"""Colour conversion of the survivors: spherical harmonics of degree 0-3 in the work format, one colour a level."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from golden.msv2_ref.parallel import for_slices
from golden.msv2_ref.quantise import GaussianWords
from golden.msv2_ref.registers import FrameRegisters
from golden.msv2_ref.rounding import RoundTo, dot3, rnd, round_to
from spec.config import AcceleratorConfig

_DEGREE_1 = 0.4886025119029199
_DEGREE_2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
_DEGREE_3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658,
             1.445305721320277, -0.5900435899266435)


class _Constants(NamedTuple):
    to_view: RoundTo
    to_work: RoundTo
    degree_1: float
    degree_2: tuple[float, ...]
    degree_3: tuple[float, ...]
    dc_one: float
    rest_one: float
    colour_one: float
    colour_max: float


@cache
def _constants(config: AcceleratorConfig) -> _Constants:
    n = config.formats
    return _Constants(
        round_to(n.view), round_to(n.work), float(n.work.round(_DEGREE_1)), tuple(n.work.round(_DEGREE_2).tolist()),
        tuple(n.work.round(_DEGREE_3).tolist()), 2.0**n.sh_dc.frac_bits, 2.0**n.sh_rest.frac_bits, 2.0**n.colour.frac_bits,
        float(n.colour.raw_max))


@numba.njit(cache=True)
def _basis(x, y, z, degree, k, out):
    """The basis functions beyond the first, in 3DGS order and sign."""
    W, c1, d2, d3 = k.to_work, k.degree_1, k.degree_2, k.degree_3
    out[0], out[1], out[2] = rnd(-c1 * y, W), rnd(c1 * z, W), rnd(-c1 * x, W)
    if degree < 2:
        return
    xx, yy, zz = rnd(x * x, W), rnd(y * y, W), rnd(z * z, W)
    xy, yz, xz = rnd(x * y, W), rnd(y * z, W), rnd(x * z, W)
    two_zz = rnd(rnd(2.0 * zz, W) - rnd(xx + yy, W), W)
    xx_yy = rnd(xx - yy, W)
    out[3], out[4], out[5] = rnd(d2[0] * xy, W), rnd(d2[1] * yz, W), rnd(d2[2] * two_zz, W)
    out[6], out[7] = rnd(d2[3] * xz, W), rnd(d2[4] * xx_yy, W)
    if degree < 3:
        return
    four_zz = rnd(rnd(4.0 * zz, W) - rnd(xx + yy, W), W)
    out[8] = rnd(rnd(d3[0] * y, W) * rnd(rnd(3.0 * xx, W) - yy, W), W)
    out[9] = rnd(rnd(d3[1] * xy, W) * z, W)
    out[10] = rnd(rnd(d3[2] * y, W) * four_zz, W)
    out[11] = rnd(rnd(d3[3] * z, W) * rnd(rnd(2.0 * zz, W) - rnd(3.0 * rnd(xx + yy, W), W), W), W)
    out[12] = rnd(rnd(d3[4] * x, W) * four_zz, W)
    out[13] = rnd(rnd(d3[5] * z, W) * xx_yy, W)
    out[14] = rnd(rnd(d3[6] * x, W) * rnd(xx - rnd(3.0 * yy, W), W), W)


@numba.njit(cache=True, nogil=True)
def _colours(_slice, begin, end, mean, dc, rest, position, degree, k, colour):
    V, W = k.to_view, k.to_work
    terms = (degree + 1) ** 2 - 1
    for i in range(begin, end):
        factors, total = np.zeros(16), np.zeros(3)
        if degree > 0:
            dx, dy, dz = (rnd(mean[i, 0] - position[0], V), rnd(mean[i, 1] - position[1], V), rnd(mean[i, 2] - position[2], V))
            inverse = rnd(1.0 / np.sqrt(dot3(W, dx, dy, dz, dx, dy, dz)), W)
            _basis(rnd(dx * inverse, W), rnd(dy * inverse, W), rnd(dz * inverse, W), degree, k, factors)
            for t in range(terms):
                for c in range(3):
                    total[c] = rnd(total[c] + rnd(factors[t] * (rest[i, 3 * t + c] / k.rest_one), W), W)
        for level in range(colour.shape[1]):
            for c in range(3):
                value = rnd(total[c] + dc[i, 3 * level + c] / k.dc_one, W)
                colour[i, level, c] = int(min(max(np.floor(value * k.colour_one + 0.5), 0.0), k.colour_max))


def splat_colours(config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, rows: np.ndarray) -> np.ndarray:
    """(len(rows), levels, 3) int32 raw `colour` of the Gaussians at `rows`; negative sums clamp to 0 after the sum."""
    colour = np.empty((len(rows), words.levels, 3), np.int32)
    words_of = words.colour[rows]
    rest = words_of["rest"] if words.sh_degree else np.zeros((len(rows), 1), np.int16)
    mean = config.formats.position.to_float(words.geometry["mean"][rows]) if words.sh_degree else np.zeros((len(rows), 3))
    for_slices(_colours, len(rows), mean, np.ascontiguousarray(words_of["dc"]), np.ascontiguousarray(rest), registers.position,
               words.sh_degree, _constants(config), colour)
    return colour
