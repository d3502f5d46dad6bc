"""Projection of 3D Gaussians to screen-space splats (EWA, as in 3DGS), in float64.

Sources: Zwicker et al. 2001 for EWA splatting, Kerbl et al. 2023 for the conventions, paper section 2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.oracle.ellipse import meets_frame
from golden.oracle.harmonics import colour_per_level
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.constants import ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS
from spec.guard_band import MEAN_RANGE, Range


@dataclass(frozen=True)
class Splats:
    """The projected Gaussians that may touch the frame, in the model's order: N splats with K levels each.

    Attributes:
        index: (N,) int64, the Gaussian in the model.
        mean2d: (N, 2) float64, pixels.
        cov2d: (N, 3) float64, px^2: xx, xy, yy of the covariance, low-pass included.
        factor: (N, 3) float64, 1/px: triangular factor of the conic, see `golden.oracle.ellipse`.
        depth: (N,) float64, camera z in world units.
        opacity: (N, K) float64, amplified opacity.
        colour: (N, K, 3) float64, >= 0.
        q_max: (N, K) float64, largest falloff exponent at which the level still covers a pixel; -inf where it covers none or
            the level lies beyond the quality bound.
        quality_bound: (N,) int64 in 1..K.
    """

    index: np.ndarray
    mean2d: np.ndarray
    cov2d: np.ndarray
    factor: np.ndarray
    depth: np.ndarray
    opacity: np.ndarray
    colour: np.ndarray
    q_max: np.ndarray
    quality_bound: np.ndarray

    def __len__(self) -> int:
        return len(self.index)


def project(
    model: GaussianModel, camera: Camera, support_sigma: float | None, mean_range: Range = MEAN_RANGE,
) -> tuple[Splats, dict[str, int]]:
    """Projects every Gaussian of `model` and culls those that cannot change a pixel.

    Args:
        model: the Gaussians.
        camera: the camera, with the frame's size.
        support_sigma: Mahalanobis radius that bounds the support, or None for 3DGS's bound on alpha alone.
        mean_range: the guard band: pixels between which a projected mean must lie.

    Returns:
        The surviving splats, and the number of culled points by reason. A point counts under the first reason that applies:
        `non_finite` (an input field is not finite, or the quaternion is zero), `near` (z <= camera.near), `overflow`
        (position or extent on the screen exceed float64), `transparent` (alpha is below 1/255 even at the centre, at every
        level that uses the point), `outside` (the footprint misses the rectangle of the frame's pixel centres, or the mean
        lies beyond the guard band).
    """
    with np.errstate(all="ignore"):  # points that are not finite here are culled below
        point = model.means @ camera.rotation.T + camera.translation
        mean2d = point[:, :2] / point[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        cov2d, determinant = project_covariance(model, point, camera)
        factor = conic_factor(cov2d, determinant)
        q_max = largest_exponent(model, support_sigma)
        widest = q_max.max(axis=1)
        bad = {
            "non_finite": ~finite_input(model),
            "near": ~(point[:, 2] > camera.near),
            "overflow": ~(np.isfinite(mean2d).all(axis=1) & np.isfinite(determinant)),
            "transparent": widest < 0,
            "outside": ~(meets_frame(mean2d, factor, widest, camera.width, camera.height) & within(mean2d, mean_range)),
        }
    alive, culled = np.ones(len(model), bool), {}
    for reason, applies in bad.items():
        culled[reason] = int((alive & applies).sum())
        alive &= ~applies
    index = np.flatnonzero(alive)
    splats = Splats(
        index=index,
        mean2d=mean2d[index],
        cov2d=cov2d[index],
        factor=factor[index],
        depth=point[index, 2],
        opacity=model.opacity[index],
        colour=colour_per_level(model, index, camera.position),
        q_max=q_max[index],
        quality_bound=model.quality_bound[index].astype(np.int64),
    )
    return splats, culled


def within(mean2d: np.ndarray, mean_range: Range) -> np.ndarray:
    """(N,) bool: whether the means (N, 2), in pixels, lie within the guard band."""
    low, high = mean_range
    return ((low < mean2d) & (mean2d < high)).all(axis=1)


def finite_input(model: GaussianModel) -> np.ndarray:
    """(N,) bool: whether every field is finite and the quaternion is not 0. A log scale of -inf, a degenerate axis, is
    accepted."""
    fields = (model.means, model.quats, model.opacity, model.sh_dc, model.sh_rest)
    finite = [np.isfinite(values).all(axis=tuple(range(1, values.ndim))) for values in fields]
    return np.logical_and.reduce([*finite, (model.log_scales < np.inf).all(axis=1), model.quats.any(axis=1)])


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotations of the wxyz quaternions (N, 4), which are normalised first."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def project_covariance(model: GaussianModel, point: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Covariance on the screen, J W (R S)(R S)^T W^T J^T + 0.3 I, and its determinant.

    Args:
        point: (N, 3) float64, the means in camera space.

    Returns:
        (N, 3) float64 xx, xy, yy in px^2, and (N,) float64 determinants. With m0, m1 the rows of M = J W R S, the
        determinant is |m0 x m1|^2 + 0.3 (|m0|^2 + |m1|^2) + 0.09: a sum of squares, which cannot cancel.
    """
    x, y, z = point.T
    # The local affine approximation is poor towards the frustum's sides, so it is evaluated no farther out than the margin.
    left, right = -FRUSTUM_MARGIN * camera.cx / camera.fx, FRUSTUM_MARGIN * (camera.width - camera.cx) / camera.fx
    top, bottom = -FRUSTUM_MARGIN * camera.cy / camera.fy, FRUSTUM_MARGIN * (camera.height - camera.cy) / camera.fy
    x = np.clip(x, left * z, right * z)  # inside the margin this gives x itself, without the rounding of (x / z) * z
    y = np.clip(y, top * z, bottom * z)
    zero = np.zeros_like(z)
    jacobian = np.array([[camera.fx / z, zero, -camera.fx * x / z**2], [zero, camera.fy / z, -camera.fy * y / z**2]])

    axes = rotation_matrices(model.quats) * np.exp(model.log_scales)[:, None, :]
    m = np.moveaxis(jacobian, -1, 0) @ camera.rotation @ axes
    xx, xy, yy = (m[:, 0] ** 2).sum(1), (m[:, 0] * m[:, 1]).sum(1), (m[:, 1] ** 2).sum(1)
    area_squared = (np.cross(m[:, 0], m[:, 1]) ** 2).sum(1)
    determinant = area_squared + LOW_PASS * (xx + yy) + LOW_PASS**2
    return np.stack([xx + LOW_PASS, xy, yy + LOW_PASS], axis=1), determinant


def conic_factor(cov2d: np.ndarray, determinant: np.ndarray) -> np.ndarray:
    """(N, 3) float64 (f0, f1, f2), the triangular factor of the conic (the covariance's inverse): see
    `golden.oracle.ellipse`."""
    _, xy, yy = cov2d.T
    f0 = np.sqrt(yy / determinant)
    return np.stack([f0, -f0 * xy / yy, 1 / np.sqrt(yy)], axis=1)


def largest_exponent(model: GaussianModel, support_sigma: float | None) -> np.ndarray:
    """(N, levels) float64: the largest q with o_amp exp(-q) >= 1/255 and a Mahalanobis radius <= support_sigma.

    It is -inf where the opacity is below 1/255, and at levels beyond the point's quality bound.
    """
    support = np.inf if support_sigma is None else support_sigma**2 / 2
    q_max = np.minimum(np.log(model.opacity / ALPHA_MIN), support)
    used = np.arange(model.levels) < model.quality_bound[:, None]
    return np.where(used & (q_max >= 0), q_max, -np.inf)
