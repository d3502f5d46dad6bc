"""View-dependent colour from real spherical harmonics, degree 0-3, in the order and signs of 3DGS."""

from __future__ import annotations

import numpy as np

from golden.scenes.model import GaussianModel
from spec.constants import SH_C0

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


def colour_per_level(model: GaussianModel, index: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """(N, levels, 3) float64 colours of the points `index` (N,), seen from `eye` (3,) in world units.

    Level l's colour is max(0, C0 dc[l] + rest(direction) + 0.5): only the DC term differs between levels, and the
    clamp follows the whole sum.
    """
    colour = model.sh_dc[index] * SH_C0 + 0.5
    rest = model.sh_rest[index]
    if rest.shape[1]:
        direction = model.means[index] - eye
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        basis = basis_beyond_dc(direction, rest.shape[1])
        colour += np.einsum("nk,nkc->nc", basis, rest)[:, None, :]
    return np.maximum(colour, 0.0)
