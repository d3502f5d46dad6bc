"""Spherical harmonics: the basis of 3DGS in float64, and how the colour unit evaluates it in fixed point, with few products
that all have the same formats.

A direction is scaled to length DIRECTION_SCALE, and its x and y are negated. This makes every factor positive, and most
functions of degree 2 then need no factor. Let X, Y, Z be such a direction; `linear`, `axial`, `cubic`, `mixed`, `ring` and
`polar` are the constants of `Factors`. The basis functions are, in the order of 3DGS:

    degree 1    linear Y, linear Z, linear X
    degree 2    XY, YZ, axial (2 ZZ - XX - YY), XZ, (XX - YY) / 2
    degree 3    cubic Y(3 XX - YY), W XY, U Y, Z V, U X, W (XX - YY) / 2, cubic X(XX - 3 YY)
                with W = mixed 2 Z, U = ring (4 ZZ - XX - YY), V = polar (2 ZZ - 3 XX - 3 YY)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spec.config import NumberFormats
from spec.constants import SH_C1, SH_C2, SH_C3
from spec.formats import SQ, Fixed

# Normalisation constants of the real spherical harmonics (Sloan 2008, appendix A2), in closed form.
C1 = np.sqrt(3 / (4 * np.pi))
C2 = 0.5 * np.sqrt(15 / np.pi)  # xy, yz, xz; half of it for x^2 - y^2
C2_Z = 0.25 * np.sqrt(5 / np.pi)
C3_3 = 0.25 * np.sqrt(35 / (2 * np.pi))
C3_2 = 0.5 * np.sqrt(105 / np.pi)  # xyz; half of it for z (x^2 - y^2)
C3_1 = 0.25 * np.sqrt(21 / (2 * np.pi))
C3_0 = 0.25 * np.sqrt(7 / np.pi)


def basis_beyond_dc(direction: np.ndarray, count: int) -> np.ndarray:
    """(N, count) float64 basis functions of degree 1 up, at unit vectors `direction` (N, 3); count is 0, 3, 8 or 15."""
    x, y, z = direction.T
    xx, yy, zz = x * x, y * y, z * z
    functions = [
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2 * x * y,
        -C2 * y * z,
        C2_Z * (2 * zz - xx - yy),
        -C2 * x * z,
        C2 / 2 * (xx - yy),
        -C3_3 * y * (3 * xx - yy),
        C3_2 * x * y * z,
        -C3_1 * y * (4 * zz - xx - yy),
        C3_0 * z * (2 * zz - 3 * xx - 3 * yy),
        -C3_1 * x * (4 * zz - xx - yy),
        C3_2 / 2 * z * (xx - yy),
        -C3_3 * x * (xx - 3 * yy),
    ]
    return np.stack(functions, axis=1)[:, :count]


DIRECTION_SCALE = SH_C2[0] ** 0.5
"""Length of a scaled direction: the square root of the common factor of degree 2."""

SEED_INDEX_BITS = 6
"""Bits of a squared length, below its leading one, that address the table of reciprocal roots."""

SEED_FRAC_BITS = SEED_INDEX_BITS + 4
"""Fraction bits of that table. The error of rounding to them is a quarter of the error that the width of a segment causes."""


class Factors(NamedTuple):
    """Factors of the basis functions, as in the module's docstring: raw numbers below 2 with the fraction bits of
    `sh_basis`."""

    linear: int
    axial: int
    cubic: int
    mixed: int
    ring: int
    polar: int


def factors(formats: NumberFormats) -> Factors:
    """The factors of the scaled direction's polynomials."""
    s, one = DIRECTION_SCALE, 1 << formats.sh_basis.frac_bits
    exact = (SH_C1 / s, SH_C2[2] / s**2, -SH_C3[0] / s**3, SH_C3[1] / s**3 / 2, -SH_C3[2] / s**3, SH_C3[3] / s**3)
    return Factors(*(round(one * x) for x in exact))


def terms(sh_degree: int) -> int:
    """Number of basis functions beyond the first."""
    return (sh_degree + 1) ** 2 - 1


def direction_format(formats: NumberFormats) -> Fixed:
    """Format of scaled directions, aligned offsets, factors and the reciprocal root: the second operand of every product."""
    return SQ(1, formats.sh_basis.frac_bits)


def product_format(formats: NumberFormats) -> Fixed:
    """Format of rounded products."""
    return SQ(2, formats.sh_basis.frac_bits)


def polynomial_format(formats: NumberFormats) -> Fixed:
    """Format of sums of products: the first operand of every product."""
    return SQ(3, formats.sh_basis.frac_bits)


def length_format(formats: NumberFormats) -> Fixed:
    """Format of the squared length of an offset whose largest component lies in [1, 2)."""
    return SQ(4, formats.sh_basis.frac_bits)


def root_seeds(formats: NumberFormats) -> tuple[np.ndarray, np.ndarray]:
    """(root, inverse), int64 (2^(SEED_INDEX_BITS + 1),): first approximations for a squared length m in [1, 4).

    The low bits of the index are the bits of m below its leading one; the bit above them says whether m >= 2. root, with
    SEED_FRAC_BITS fraction bits, is DIRECTION_SCALE / sqrt(m) in the middle of the segment. inverse, with the fraction bits of
    `sh_basis`, is the 1 / m that belongs to the rounded root. From m * inverse = 1 - e follows the Newton step
    root * (1 + e / 2), whose error is 3/8 e^2.
    """
    count = 1 << SEED_INDEX_BITS
    middle = 1 + (np.arange(count) + 0.5) / count
    root = np.rint(DIRECTION_SCALE / np.sqrt(np.concatenate([middle, 2 * middle])) * (1 << SEED_FRAC_BITS)).astype(np.int64)
    exact = (root / (1 << SEED_FRAC_BITS) / DIRECTION_SCALE) ** 2
    return root, np.rint(exact * (1 << formats.sh_basis.frac_bits)).astype(np.int64)


def sum_format(formats: NumberFormats) -> Fixed:
    """Format of the exact sums of basis functions times coefficients, including the base colour.

    The squares of the 15 functions sum to 15 / 4 pi (Unsoeld's theorem), so their magnitudes sum to at most 4.3. Coefficients
    lie below 2, base colours below 4.
    """
    return SQ(4, formats.sh_basis.frac_bits + formats.sh_rest.frac_bits)
