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
from spec.constants import SH_C1, SH_C2, SH_C3


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
        round_to(n.view), round_to(n.work), float(n.work.round(SH_C1)), tuple(n.work.round(SH_C2).tolist()),
        tuple(n.work.round(SH_C3).tolist()), 2.0**n.sh_dc.frac_bits, 2.0**n.sh_rest.frac_bits, 2.0**n.colour.frac_bits,
        float(n.colour.raw_max))


_BLOCK = 64
_X, _Y, _Z, _BASIS = (_BLOCK * row for row in range(4))
_BLOCK_ROWS = 3 + 15


@numba.njit(cache=True, error_model="numpy")
def _normalise(block, position, k):
    """World positions in rows X, Y and Z of the block to unit vectors from the camera."""
    V, W = k.to_view, k.to_work
    px, py, pz = position[0], position[1], position[2]
    for j in range(_BLOCK):
        dx, dy, dz = rnd(block[_X + j] - px, V), rnd(block[_Y + j] - py, V), rnd(block[_Z + j] - pz, V)
        inverse = rnd(1.0 / np.sqrt(dot3(W, dx, dy, dz, dx, dy, dz)), W)
        block[_X + j], block[_Y + j], block[_Z + j] = rnd(dx * inverse, W), rnd(dy * inverse, W), rnd(dz * inverse, W)


@numba.njit(cache=True, error_model="numpy")
def _basis(block, degree, k):
    """The basis functions beyond the first, in 3DGS order and sign, from row BASIS of the block on."""
    W, c1 = k.to_work, k.degree_1
    (c20, c21, c22, c23, c24), (c30, c31, c32, c33, c34, c35, c36) = k.degree_2, k.degree_3
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + j
        block[at], block[at + _BLOCK], block[at + 2 * _BLOCK] = rnd(-c1 * y, W), rnd(c1 * z, W), rnd(-c1 * x, W)
    if degree < 2:
        return
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + 3 * _BLOCK + j
        xx, yy, zz = rnd(x * x, W), rnd(y * y, W), rnd(z * z, W)
        block[at], block[at + _BLOCK] = rnd(c20 * rnd(x * y, W), W), rnd(c21 * rnd(y * z, W), W)
        block[at + 2 * _BLOCK] = rnd(c22 * rnd(rnd(2.0 * zz, W) - rnd(xx + yy, W), W), W)
        block[at + 3 * _BLOCK], block[at + 4 * _BLOCK] = rnd(c23 * rnd(x * z, W), W), rnd(c24 * rnd(xx - yy, W), W)
    if degree < 3:
        return
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + 8 * _BLOCK + j
        xx, yy, zz, xy = rnd(x * x, W), rnd(y * y, W), rnd(z * z, W), rnd(x * y, W)
        four_zz, xx_yy = rnd(rnd(4.0 * zz, W) - rnd(xx + yy, W), W), rnd(xx - yy, W)
        block[at] = rnd(rnd(c30 * y, W) * rnd(rnd(3.0 * xx, W) - yy, W), W)
        block[at + _BLOCK] = rnd(rnd(c31 * xy, W) * z, W)
        block[at + 2 * _BLOCK] = rnd(rnd(c32 * y, W) * four_zz, W)
        block[at + 3 * _BLOCK] = rnd(rnd(c33 * z, W) * rnd(rnd(2.0 * zz, W) - rnd(3.0 * rnd(xx + yy, W), W), W), W)
        block[at + 4 * _BLOCK] = rnd(rnd(c34 * x, W) * four_zz, W)
        block[at + 5 * _BLOCK] = rnd(rnd(c35 * z, W) * xx_yy, W)
        block[at + 6 * _BLOCK] = rnd(rnd(c36 * x, W) * rnd(xx - rnd(3.0 * yy, W), W), W)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _colours(_slice, begin, end, rows, mean, dc, rest, position, degree, k, colour):
    """Blocks of splats: every loop over j is over the splats of a block, for LLVM to make vectors of."""
    W = k.to_work
    block, coefficient, total = np.ones(_BLOCK_ROWS * _BLOCK), np.zeros(_BLOCK), np.zeros((3, _BLOCK))
    for start in range(begin, end, _BLOCK):
        count = min(end - start, _BLOCK)
        total[:] = 0.0
        if degree > 0:
            for j in range(count):
                i = rows[start + j]
                block[_X + j], block[_Y + j], block[_Z + j] = mean[i, 0], mean[i, 1], mean[i, 2]
            _normalise(block, position, k)
            _basis(block, degree, k)
            for n in range(3 * (degree + 1) ** 2 - 3):
                term, c = n // 3, n % 3
                for j in range(count):
                    coefficient[j] = rest[rows[start + j], n] / k.rest_one
                for j in range(_BLOCK):
                    total[c, j] = rnd(total[c, j] + rnd(block[_BASIS + _BLOCK * term + j] * coefficient[j], W), W)
        for n in range(3 * colour.shape[1]):
            level, c = n // 3, n % 3
            for j in range(count):
                value = rnd(total[c, j] + dc[rows[start + j], n] / k.dc_one, W)
                colour[start + j, level, c] = int(min(max(np.floor(value * k.colour_one + 0.5), 0.0), k.colour_max))


def splat_colours(config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, rows: np.ndarray) -> np.ndarray:
    """(len(rows), levels, 3) int32 raw `colour` of the Gaussians at `rows`; negative sums clamp to 0 after the sum."""
    colour = np.empty((len(rows), words.levels, 3), np.int32)
    rest = words.colour["rest"] if words.sh_degree else np.zeros((len(words.colour), 1), np.int16)
    for_slices(_colours, len(rows), rows, words.decoded.mean, words.colour["dc"], rest, registers.position, words.sh_degree,
               _constants(config), colour)
    return colour
