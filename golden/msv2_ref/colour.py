"""Colour of the surviving splats: spherical harmonics of degree 0-3, one colour for each level.

Everything is fixed-point. The offset from the camera is shifted so that its largest component uses all bits, and scaled to a
fixed length with a table and one Newton step. The harmonics are rounded products (`spec.harmonics`), and the sum over the
coefficients is exact. Numbers are raw integers held in float64, which never exceed what it can represent. Their fraction is
that of `sh_basis` unless stated otherwise.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters
from golden.host.rounding import RoundTo, operation, rnd, round_to
from golden.kernels import compiled
from golden.threads import for_slices
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.harmonics import SEED_FRAC_BITS, SEED_INDEX_BITS, Factors, factors, root_seeds
from spec.memory import splat_record


class _Constants(NamedTuple):
    to_view: RoundTo
    frac_bits: int
    one: float
    ulp: float
    factor: Factors
    root: np.ndarray
    inverse: np.ndarray
    dc_one: float
    sum_ulp: float
    colour_max: float


@cache
def _constants(config: AcceleratorConfig) -> _Constants:
    n = config.formats
    frac_bits, sum_bits = n.sh_basis.frac_bits, n.sh_basis.frac_bits + n.sh_rest.frac_bits
    root, inverse = root_seeds(n)
    return _Constants(
        round_to(n.view), frac_bits, 2.0**frac_bits, 2.0**-frac_bits, Factors(*map(float, factors(n))),
        root * 2.0 ** (frac_bits - SEED_FRAC_BITS), inverse.astype(np.float64), 2.0 ** (sum_bits - n.sh_dc.frac_bits),
        2.0 ** (n.colour.frac_bits - sum_bits), float(n.colour.raw_max))


_BLOCK = 64
_X, _Y, _Z, _BASIS = (_BLOCK * row for row in range(4))
_BLOCK_ROWS = 3 + 15
_EXPONENT = 0x7FF << 52


@operation
def _product(a, b, k):
    """a * b in the fraction of `sh_basis`, rounded HALF_UP."""
    return np.floor(a * b * k.ulp + 0.5)


@operation
def _scaled_root(n, k):
    """DIRECTION_SCALE / sqrt(n) for a squared length n in [1, 16); for 0, any finite number."""
    large = n >= 4.0 * k.one
    m = np.floor(n * 0.25) if large else n
    whole = np.int64(m)
    upper = whole >> (k.frac_bits + 1)
    below = whole >> (k.frac_bits - SEED_INDEX_BITS + upper) & ((1 << SEED_INDEX_BITS) - 1)
    index = upper << SEED_INDEX_BITS | below
    root = k.root[index]
    step = _product(root, k.one - _product(m, k.inverse[index], k), k)
    return np.floor((2.0 * root + step) * (0.25 if large else 0.5))


@compiled(error_model="numpy")
def _directions(block, k):
    """Converts the offsets in rows X, Y and Z of the block to scaled directions; a zero offset stays zero."""
    for j in range(_BLOCK):
        x, y, z = block[_X + j], block[_Y + j], block[_Z + j]
        exponent = np.float64(max(abs(x), abs(y), abs(z))).view(np.int64) & _EXPONENT
        unit = np.int64((2046 << 52) - exponent).view(np.float64)
        x, y, z = np.trunc(-x * unit * k.one), np.trunc(-y * unit * k.one), np.trunc(z * unit * k.one)
        root = _scaled_root(_product(x, x, k) + _product(y, y, k) + _product(z, z, k), k)
        block[_X + j], block[_Y + j], block[_Z + j] = _product(x, root, k), _product(y, root, k), _product(z, root, k)


@compiled(error_model="numpy")
def _basis(block, degree, k):
    """Writes the basis functions beyond the first, in 3DGS order, from row BASIS of the block on."""
    f = k.factor
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + j
        block[at], block[at + _BLOCK] = _product(y, f.linear, k), _product(z, f.linear, k)
        block[at + 2 * _BLOCK] = _product(x, f.linear, k)
    if degree < 2:
        return
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + 3 * _BLOCK + j
        xx, yy, zz = _product(x, x, k), _product(y, y, k), _product(z, z, k)
        block[at], block[at + _BLOCK] = _product(x, y, k), _product(y, z, k)
        block[at + 2 * _BLOCK] = _product(2.0 * zz - xx - yy, f.axial, k)
        block[at + 3 * _BLOCK], block[at + 4 * _BLOCK] = _product(x, z, k), np.floor((xx - yy) * 0.5)
    if degree < 3:
        return
    for j in range(_BLOCK):
        x, y, z, at = block[_X + j], block[_Y + j], block[_Z + j], _BASIS + 8 * _BLOCK + j
        xx, yy, zz = _product(x, x, k), _product(y, y, k), _product(z, z, k)
        w = _product(2.0 * z, f.mixed, k)
        u = _product(4.0 * zz - xx - yy, f.ring, k)
        v = _product(2.0 * zz - 3.0 * (xx + yy), f.polar, k)
        block[at] = _product(_product(3.0 * xx - yy, y, k), f.cubic, k)
        block[at + _BLOCK] = _product(w, _product(x, y, k), k)
        block[at + 2 * _BLOCK], block[at + 4 * _BLOCK] = _product(u, y, k), _product(u, x, k)
        block[at + 3 * _BLOCK] = _product(v, z, k)
        block[at + 5 * _BLOCK] = _product(w, np.floor((xx - yy) * 0.5), k)
        block[at + 6 * _BLOCK] = _product(_product(xx - 3.0 * yy, x, k), f.cubic, k)


@compiled(nogil=True, error_model="numpy")
def _colours(_slice, begin, end, rows, mean, dc, rest, position, degree, k, colour):
    """Colours of the splats `rows[begin:end]`, in blocks; LLVM vectorises the loops over j, the splats of a block."""
    V = k.to_view
    block, coefficient, total = np.ones(_BLOCK_ROWS * _BLOCK), np.zeros(_BLOCK), np.zeros((3, _BLOCK))
    px, py, pz = position[0], position[1], position[2]
    for start in range(begin, end, _BLOCK):
        count = min(end - start, _BLOCK)
        total[:] = 0.0
        if degree > 0:
            for j in range(count):
                i = rows[start + j]
                block[_X + j], block[_Y + j] = rnd(mean[i, 0] - px, V), rnd(mean[i, 1] - py, V)
                block[_Z + j] = rnd(mean[i, 2] - pz, V)
            _directions(block, k)
            _basis(block, degree, k)
            for n in range(3 * (degree + 1) ** 2 - 3):
                term, c = n // 3, n % 3
                for j in range(count):
                    coefficient[j] = rest[rows[start + j], n]
                for j in range(_BLOCK):
                    total[c, j] += block[_BASIS + _BLOCK * term + j] * coefficient[j]
        for n in range(3 * colour.shape[1]):
            level, c = n // 3, n % 3
            for j in range(count):
                value = total[c, j] + dc[rows[start + j], n] * k.dc_one
                colour[start + j, level, c] = int(min(max(np.floor(value * k.sum_ulp + 0.5), 0.0), k.colour_max))


def splat_colours(config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, rows: np.ndarray) -> np.ndarray:
    """(len(rows), levels, 3) int32 raw `colour` of the Gaussians at `rows`; negative colours become 0 after the whole sum."""
    colour = np.empty((len(rows), words.levels, 3), np.int32)
    rest = words.colour["rest"] if words.sh_degree else np.zeros((len(words.colour), 1), np.int16)
    for_slices(_colours, len(rows), rows, words.decoded.mean, words.colour["dc"], rest, registers.position, words.sh_degree,
               _constants(config), colour)
    return colour


def survivor_records(
    config: AcceleratorConfig, survivors: np.ndarray, records: np.ndarray, sh_degree: int, view_shift: int,
    opacity: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The splat records that the colour unit writes for a frame, in order: one for each level that each splat is used at.

    Args:
        config: the machine.
        survivors: (N,) SurvivingSplat records without the `end`.
        records: (N,) their GaussianColour records, of at least that degree; decoded ones of compact records.
        sh_degree: the degree in use.
        view_shift: there are 1 << view_shift places for splat records of each Gaussian.
        opacity: (N, 4) raw `log2_opacity` by level, decoded from the compact records; None: the survivors have them.

    Returns:
        (M,) SplatRecord records, and (M,) int64 the beat of each, counted from the base of the region `views`.
    """
    colour, offset = np.empty((len(survivors), MAX_LEVELS, 3), np.int32), config.formats.view.to_float(survivors["offset"])
    rest = records["rest"] if sh_degree else np.zeros((len(records), 1), np.int16)
    for_slices(_colours, len(survivors), np.arange(len(survivors)), offset, np.ascontiguousarray(records["dc"]),
               np.ascontiguousarray(rest), np.zeros(3), sh_degree, _constants(config), colour)
    row, level = np.nonzero(survivors["levels"][:, None] >> np.arange(MAX_LEVELS) & 1)
    both = np.minimum(np.stack([level, level + 1], 1), MAX_LEVELS - 1)
    views = np.zeros(len(row), splat_record(config).dtype)
    for name in ("mean2d", "conic", "depth", "bound"):
        views[name] = survivors[name][row]
    views["log2_opacity"] = (survivors["log2_opacity"] if opacity is None else opacity)[row[:, None], both]
    views["colour"] = colour[row[:, None], both].reshape(len(row), 6)
    return views, (survivors["index"][row].astype(np.int64) << view_shift) + level
