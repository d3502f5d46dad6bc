"""Arithmetic that gives the same bits on every CPU, for a scene that is computed anew wherever it is used.

numpy and LAPACK choose their instructions by the CPU, so that sums of products, logarithms and eigenvectors differ in their
last bits. Two things remove the difference. Values are rounded to a grid far coarser than it, before anything discrete or
degenerate looks at them. Eigenvectors come from Jacobi's method in single operations on whole arrays (+, -, *, /, square
root), which IEEE 754 rounds alike everywhere: those of equal eigenvalues are arbitrary, and LAPACK picks them by the noise.
"""

from __future__ import annotations

import numpy as np

SWEEPS = 8
"""Jacobi sweeps. The method converges quadratically: 3x3 matrices need five or six in float64."""

NEGLIGIBLE = 2.0**-60
"""Share of the diagonal below which an entry beside it counts as zero: less than float64 resolves."""


def on_grid(values: np.ndarray, bits: int) -> np.ndarray:
    """`values` (any shape, float64) rounded to multiples of 2^-bits, ties to even."""
    return np.ldexp(np.rint(np.ldexp(values, bits)), -bits)


def on_relative_grid(matrices: np.ndarray, bits: int) -> np.ndarray:
    """Matrices (N, 3, 3) float64, each rounded to multiples of 2^-bits times the power of two above its largest entry."""
    exponent = np.frexp(np.abs(matrices).max(axis=(1, 2)))[1][:, None, None]
    return np.ldexp(np.rint(np.ldexp(matrices, bits - exponent)), exponent - bits)


def symmetric_eigen(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and eigenvectors of symmetric matrices by cyclic Jacobi rotations.

    Args:
        matrices: (N, 3, 3) float64, symmetric.

    Returns:
        (N, 3) eigenvalues in ascending order, and (N, 3, 3) orthonormal eigenvectors as columns, a proper rotation.
    """
    a = np.moveaxis(matrices, 0, -1).copy()  # (3, 3, N): one array for each entry
    axes = np.repeat(np.eye(3)[:, :, None], len(matrices), axis=2)
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            _rotate(a, axes, p, q)
    values = np.stack([a[0, 0], a[1, 1], a[2, 2]], axis=1)
    order = np.argsort(values, axis=1, kind="stable")
    columns = np.take_along_axis(np.moveaxis(axes, -1, 0), order[:, None, :], axis=2)
    # An odd permutation of a proper rotation mirrors it.
    odd = (order[:, 0] > order[:, 1]) ^ (order[:, 0] > order[:, 2]) ^ (order[:, 1] > order[:, 2])
    return np.take_along_axis(values, order, axis=1), np.where(odd[:, None, None], -columns, columns)


def _rotate(a: np.ndarray, axes: np.ndarray, p: int, q: int) -> None:
    """Turns the plane p, q of all matrices `a` (3, 3, N) in place so that a[p, q] becomes 0, and `axes` (3, 3, N) with them."""
    off, difference = a[p, q], a[q, q] - a[p, p]
    flat = np.abs(off) <= NEGLIGIBLE * (np.abs(a[p, p]) + np.abs(a[q, q]))
    ratio = difference / np.where(flat, 1.0, 2.0 * off)
    tangent = np.where(ratio < 0.0, -1.0, 1.0) / (np.abs(ratio) + np.sqrt(ratio * ratio + 1.0))
    tangent = np.where(flat, 0.0, tangent)
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for left, right in ((a[:, p], a[:, q]), (a[p], a[q]), (axes[:, p], axes[:, q])):
        turned = cosine * left - sine * right, sine * left + cosine * right
        left[:], right[:] = turned
    a[p, q] = a[q, p] = 0.0
