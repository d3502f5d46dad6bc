"""View-dependent colour from real spherical harmonics, degree 0-3, in the order and signs of 3DGS."""

from __future__ import annotations

import numpy as np

from golden.scenes.model import GaussianModel
from spec.constants import SH_C0
from spec.harmonics import basis_beyond_dc


def colour_per_level(model: GaussianModel, index: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """(N, levels, 3) float64 colours of the points `index` (N,), seen from `eye` (3,) in world units.

    The colour of level l is max(0, C0 dc[l] + rest(direction) + 0.5): only the DC term differs between levels, and the whole
    sum is clamped.
    """
    colour = model.sh_dc[index] * SH_C0 + 0.5
    rest = model.sh_rest[index]
    if rest.shape[1]:
        direction = model.means[index] - eye
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        basis = basis_beyond_dc(direction, rest.shape[1])
        colour += np.einsum("nk,nkc->nc", basis, rest)[:, None, :]
    return np.maximum(colour, 0.0)
