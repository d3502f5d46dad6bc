"""Intersections as 3DGS lists them: every tile that meets the square of three standard deviations around a projected mean.

Published speed-ups of pruned models count these, or come from renderers that draw them. The machine's lists are exact, so a
dense model starts from fewer intersections here, and what a method saves in squares it need not save in exact lists.
"""

from __future__ import annotations

import numpy as np

from golden.oracle.project import finite_input, project_covariance
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.constants import TILE

SIGMAS = 3
"""Half the edge of a square in standard deviations along the longest axis (Kerbl et al. 2023, public code)."""

LEAST = 0.1
"""Smallest value under the root in the eigenvalue, in px^4, as in the public code of 3DGS."""


def square_intersections(model: GaussianModel, camera: Camera) -> int:
    """The number of (Gaussian, tile) pairs of a frame of the model's first level, listed by squares.

    As in 3DGS's code, half an edge is rounded up to whole pixels, no opacity is looked at, and only Gaussians up to the near
    plane are left out.
    """
    with np.errstate(all="ignore"):
        point = model.means @ camera.rotation.T + camera.translation
        centre = point[:, :2] / point[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy) - 0.5
        covariance, determinant = project_covariance(model, point, camera)
        middle = 0.5 * (covariance[:, 0] + covariance[:, 2])
        half = np.ceil(SIGMAS * np.sqrt(middle + np.sqrt(np.maximum(LEAST, middle * middle - determinant))))
        tiles = np.ones(len(model))
        for axis, size in enumerate((camera.width, camera.height)):
            count = -(-size // TILE)
            first = np.clip(np.trunc((centre[:, axis] - half) / TILE), 0, count)
            end = np.clip(np.trunc((centre[:, axis] + half + TILE - 1) / TILE), 0, count)
            tiles *= end - first
    shown = finite_input(model) & (point[:, 2] > camera.near) & np.isfinite(tiles)
    return int(tiles[shown].sum())
