"""One splat in closed form: the rendering semantics for a splat whose axes are parallel to the camera's, in a few lines.

This is a third derivation, independent of the two renderers. Cases compute expected values with it, for cameras at the origin
that look along z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from golden.scenes.camera import Camera
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, SUPPORT_SIGMA


def exponents(camera: Camera, mean: ArrayLike, scale: ArrayLike) -> np.ndarray:
    """(H, W) float64: half the squared Mahalanobis distance of each pixel's centre to a splat with axes parallel to the
    camera's."""
    x, y, z = np.asarray(mean, float)
    sx, sy, sz = np.broadcast_to(np.asarray(scale, float), 3)
    left, right = -FRUSTUM_MARGIN * camera.cx / camera.fx, FRUSTUM_MARGIN * (camera.width - camera.cx) / camera.fx
    top, bottom = -FRUSTUM_MARGIN * camera.cy / camera.fy, FRUSTUM_MARGIN * (camera.height - camera.cy) / camera.fy
    tx, ty = np.clip(x / z, left, right), np.clip(y / z, top, bottom)
    across = np.array([[camera.fx * sx, 0, -camera.fx * tx * sz], [0, camera.fy * sy, -camera.fy * ty * sz]]) / z
    inverse = np.linalg.inv(across @ across.T + LOW_PASS * np.eye(2))
    row, column = np.indices((camera.height, camera.width))
    offset = np.stack([column + 0.5 - camera.fx * x / z - camera.cx, row + 0.5 - camera.fy * y / z - camera.cy], -1)
    return 0.5 * np.einsum("hwi,ij,hwj->hw", offset, inverse, offset)


def alphas(
    camera: Camera, mean: ArrayLike, scale: ArrayLike, opacity: float, alpha_max: float = ALPHA_MAX_L1,
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float64 the splat's alpha, and (H, W) bool where it is certain: outside the rounding error at the support's rim
    and at the cut."""
    q = exponents(camera, mean, scale)
    alpha = np.minimum(opacity * np.exp(-q), alpha_max)
    rim = SUPPORT_SIGMA**2 / 2
    sure = (np.abs(q - rim) > 0.02) & (np.abs(np.log2(np.maximum(alpha, 1e-9) / ALPHA_MIN)) > 0.02)
    return np.where((q <= rim) & (alpha >= ALPHA_MIN), alpha, 0.0), sure
