"""Projection on the CPU: the arithmetic of `projection` as two fused kernels, with derivatives worked out by hand.

The forward pass of a splat is a few hundred operations, which torch would turn into a hundred passes through memory. Inputs and
results are float32, intermediate numbers float64. The backward pass projects again instead of keeping intermediate results.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from golden.diff.slices import run_slices
from golden.kernels import compiled
from golden.oracle.ellipse import smallest_exponent
from golden.scenes.camera import Camera
from spec.constants import ALPHA_MIN, AMP_MAX, FRUSTUM_MARGIN, LOW_PASS, SH_C0
from spec.guard_band import Range
from spec.harmonics import C1, C2, C2_Z, C3_0, C3_1, C3_2, C3_3

FRAME_SLACK = 1e-5
"""Added to the exponent's bound where footprints are tested against the frame: it covers float32 rounding, so that no pixel
is missed."""

FARTHEST = 1e30
"""A splat is left out if it is farther than this many pixels from the frame, or its area is larger than this many px^2,
because its conic would not fit float32."""

_kernel = compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})


class View(NamedTuple):
    """A camera for the kernels, float64; `low` and `high` bound x/z and y/z in the Jacobian, and means lie within
    `mean_range`."""

    rotation: tuple[tuple[float, float, float], ...]
    eye: tuple[float, float, float]
    focal: tuple[float, float]
    centre: tuple[float, float]
    low: tuple[float, float]
    high: tuple[float, float]
    size: tuple[float, float]
    near: float
    mean_range: Range


def view_of(camera: Camera, mean_range: Range) -> View:
    """The numbers of a camera that the kernels need, and the guard band."""
    focal, centre, size = (camera.fx, camera.fy), (camera.cx, camera.cy), (camera.width, camera.height)
    low = tuple(float(-FRUSTUM_MARGIN * c / f) for c, f in zip(centre, focal, strict=True))
    high = tuple(float(FRUSTUM_MARGIN * (s - c) / f) for s, c, f in zip(size, centre, focal, strict=True))
    return View(
        tuple(tuple(map(float, row)) for row in camera.rotation), tuple(map(float, camera.position)),
        tuple(map(float, focal)), tuple(map(float, centre)), low, high, tuple(map(float, size)), float(camera.near),
        mean_range)


@_kernel
def _vector(rows, i):
    """Three components of a row. Functions take arrays and an index, as a slice costs two calls that count references."""
    return np.float64(rows[i, 0]), np.float64(rows[i, 1]), np.float64(rows[i, 2])


@_kernel
def _rest(sh_rest, i, k):
    return np.float64(sh_rest[i, k, 0]), np.float64(sh_rest[i, k, 1]), np.float64(sh_rest[i, k, 2])


@_kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_kernel
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@_kernel
def _sum(k, a, l, b):
    return k * a[0] + l * b[0], k * a[1] + l * b[1], k * a[2] + l * b[2]


@_kernel
def _by(a, b):
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@_kernel
def _apply(matrix, a):
    return _dot(matrix[0], a), _dot(matrix[1], a), _dot(matrix[2], a)


@_kernel
def _apply_transposed(matrix, a):
    return _sum(1.0, _sum(a[0], matrix[0], a[1], matrix[1]), a[2], matrix[2])


@_kernel
def _rotation(quats, i):
    """The rotation matrix of a wxyz quaternion, the normalised quaternion, and the inverse of its length."""
    w, x, y, z = np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3])
    scale = 1 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    rotation = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return rotation, (w, x, y, z), scale


@_kernel
def _rotation_backward(g, unit, scale):
    """Gradient of a quaternion before normalisation, from the gradient of its matrix."""
    w, x, y, z = unit
    d_w = 2 * (z * (g[1][0] - g[0][1]) + y * (g[0][2] - g[2][0]) + x * (g[2][1] - g[1][2]))
    d_x = 2 * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2])) - 4 * x * (g[1][1] + g[2][2])
    d_y = 2 * (x * (g[0][1] + g[1][0]) + z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0])) - 4 * y * (g[0][0] + g[2][2])
    d_z = 2 * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) + w * (g[1][0] - g[0][1])) - 4 * z * (g[0][0] + g[1][1])
    along = w * d_w + x * d_x + y * d_y + z * d_z
    return (d_w - along * w) * scale, (d_x - along * x) * scale, (d_y - along * y) * scale, (d_z - along * z) * scale


@_kernel
def _spread(point, scale, rotation, view):
    """The rows of J W, with the slopes in J clamped, and the rows of M = J W R S."""
    inverse = 1 / point[2]
    slope_x = min(max(point[0] * inverse, view.low[0]), view.high[0])
    slope_y = min(max(point[1] * inverse, view.low[1]), view.high[1])
    gain_x, gain_y, axes = view.focal[0] * inverse, view.focal[1] * inverse, view.rotation
    a = _sum(gain_x, axes[0], -gain_x * slope_x, axes[2])
    b = _sum(gain_y, axes[1], -gain_y * slope_y, axes[2])
    return a, b, _by(_apply_transposed(rotation, a), scale), _by(_apply_transposed(rotation, b), scale)


@_kernel
def _factor(m, n):
    """xx, xy, yy of the covariance with low-pass, its determinant as a sum of squares, and the conic's triangular factor."""
    xx, xy, yy, area = _dot(m, m), _dot(m, n), _dot(n, n), _cross(m, n)
    determinant = _dot(area, area) + LOW_PASS * (xx + yy) + LOW_PASS**2
    xx, yy = xx + LOW_PASS, yy + LOW_PASS
    f0 = math.sqrt(yy / determinant)
    return xx, xy, yy, determinant, (f0, -f0 * xy / yy, 1 / math.sqrt(yy))


@_kernel
def _factor_backward(g, m, n):
    """Gradients of m and n, the rows of M, from the gradient of the factor."""
    _, xy, yy, determinant, (f0, _, f2) = _factor(m, n)
    g_f0 = g[0] - g[1] * xy / yy
    g_determinant, g_xy = -0.5 * g_f0 * f0 / determinant, -g[1] * f0 / yy
    g_xx = LOW_PASS * g_determinant
    g_yy = g_xx + (0.5 * g_f0 * f0 - 0.5 * g[2] * f2 - g_xy * xy) / yy
    g_area = _sum(2 * g_determinant, _cross(m, n), 0.0, m)
    g_m = _sum(1.0, _sum(2 * g_xx, m, g_xy, n), 1.0, _cross(n, g_area))
    g_n = _sum(1.0, _sum(2 * g_yy, n, g_xy, m), 1.0, _cross(g_area, m))
    return g_m, g_n


@_kernel
def _amplified(logit, log_amp):
    """Amplified opacity before it is bounded, and its derivative with respect to the logit divided by that opacity."""
    plain = 1 / (1 + math.exp(-np.float64(logit)))
    return plain * math.exp(np.float64(log_amp)), 1 - plain


@_kernel
def _finite_colour(sh_dc, sh_rest, i):
    total = abs(sh_dc[i, 0]) + abs(sh_dc[i, 1]) + abs(sh_dc[i, 2])
    for k in range(sh_rest.shape[1]):
        total += abs(sh_rest[i, k, 0]) + abs(sh_rest[i, k, 1]) + abs(sh_rest[i, k, 2])
    return total < math.inf


@_kernel
def _survey(_slice, begin, end, means, log_scales, quats, opacity, log_amp, sh_dc, sh_rest, view, support, table, keep):
    """Decides which Gaussians survive, and writes mean2d, factor, opacity, depth, q_max and radius of these into rows of the
    table."""
    for i in range(begin, end):
        keep[i] = False
        point = _apply(view.rotation, _sum(1.0, _vector(means, i), -1.0, view.eye))
        raw = _amplified(opacity[i], log_amp[i])[0]
        if not (point[2] > view.near and raw >= ALPHA_MIN and abs(opacity[i]) + abs(log_amp[i]) < math.inf):
            continue
        shown = min(raw, AMP_MAX)
        q_max = min(math.log(shown / ALPHA_MIN), support)
        s = _vector(log_scales, i)
        scale = math.exp(s[0]), math.exp(s[1]), math.exp(s[2])
        _, _, m, n = _spread(point, scale, _rotation(quats, i)[0], view)
        xx, xy, yy, determinant, factor = _factor(m, n)
        x = point[0] / point[2] * view.focal[0] + view.centre[0]
        y = point[1] / point[2] * view.focal[1] + view.centre[1]
        if not (abs(x) + abs(y) < FARTHEST and determinant < FARTHEST * FARTHEST):
            continue
        if not (view.mean_range[0] < min(x, y) and max(x, y) < view.mean_range[1]):
            continue
        left, top = 0.5 - x, 0.5 - y
        nearest = smallest_exponent(left, top, left + view.size[0] - 1, top + view.size[1] - 1, factor)
        if nearest <= q_max + FRAME_SLACK and _finite_colour(sh_dc, sh_rest, i):
            keep[i] = True
            widest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
            table[i, 0], table[i, 1], table[i, 5], table[i, 6] = x, y, shown, point[2]
            table[i, 2], table[i, 3], table[i, 4] = factor
            table[i, 7], table[i, 8] = q_max, math.sqrt(2 * q_max * widest)


@_kernel
def _basis(direction, count, basis):
    """The first `count` harmonics beyond degree 0, in the order and signs of `golden.oracle.harmonics`."""
    x, y, z = direction
    xx, yy, zz = x * x, y * y, z * z
    basis[0], basis[1], basis[2] = -C1 * y, C1 * z, -C1 * x
    if count > 3:
        basis[3], basis[4], basis[5] = C2 * x * y, -C2 * y * z, C2_Z * (2 * zz - xx - yy)
        basis[6], basis[7] = -C2 * x * z, C2 / 2 * (xx - yy)
    if count > 8:
        ring = 4 * zz - xx - yy
        basis[8], basis[9], basis[10] = -C3_3 * y * (3 * xx - yy), C3_2 * x * y * z, -C3_1 * y * ring
        basis[11], basis[12] = C3_0 * z * (2 * zz - 3 * (xx + yy)), -C3_1 * x * ring
        basis[13], basis[14] = C3_2 / 2 * z * (xx - yy), -C3_3 * x * (xx - 3 * yy)


@_kernel
def _basis_backward(direction, count, g):
    """Gradient of the direction from the gradients of the harmonics."""
    x, y, z = direction
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    g_x, g_y, g_z = -C1 * g[2], -C1 * g[0], C1 * g[1]
    if count > 3:
        g_x += C2 * (y * g[3] - z * g[6] + x * g[7]) - 2 * C2_Z * x * g[5]
        g_y += C2 * (x * g[3] - z * g[4] - y * g[7]) - 2 * C2_Z * y * g[5]
        g_z += -C2 * (y * g[4] + x * g[6]) + 4 * C2_Z * z * g[5]
    if count > 8:
        g_x += (C3_2 * (yz * g[9] + xz * g[13]) - 6 * C3_0 * xz * g[11] - 3 * C3_3 * (2 * xy * g[8] + (xx - yy) * g[14])
                + C3_1 * (2 * xy * g[10] - (4 * zz - 3 * xx - yy) * g[12]))
        g_y += (C3_2 * (xz * g[9] - yz * g[13]) - 6 * C3_0 * yz * g[11] - 3 * C3_3 * ((xx - yy) * g[8] - 2 * xy * g[14])
                + C3_1 * (2 * xy * g[12] - (4 * zz - xx - 3 * yy) * g[10]))
        g_z += (C3_2 * (xy * g[9] + 0.5 * (xx - yy) * g[13]) + 3 * C3_0 * (2 * zz - xx - yy) * g[11]
                - 8 * C3_1 * (yz * g[10] + xz * g[12]))
    return g_x, g_y, g_z


@_kernel
def _direction(means, i, eye):
    """Unit vector from the eye to the mean, and the inverse of the distance."""
    offset = _sum(1.0, _vector(means, i), -1.0, eye)
    inverse = 1 / math.sqrt(_dot(offset, offset))
    return _sum(inverse, offset, 0.0, offset), inverse


@_kernel
def _colour(sh_dc, sh_rest, i, basis):
    """Red, green and blue before they are clamped."""
    total = _sum(SH_C0, _vector(sh_dc, i), 0.5, (1.0, 1.0, 1.0))
    for k in range(sh_rest.shape[1]):
        total = _sum(1.0, total, basis[k], _rest(sh_rest, i, k))
    return total


@_kernel
def _write(_slice, begin, end, index, means, sh_dc, sh_rest, eye, table, mean2d, factor, opacity, colour, depth, q_max, radius):
    """Writes the results of the survivors."""
    count, basis = sh_rest.shape[1], np.empty(15)
    for k in range(begin, end):
        i = index[k]
        mean2d[k, 0], mean2d[k, 1], opacity[k], depth[k] = table[i, 0], table[i, 1], table[i, 5], table[i, 6]
        factor[k, 0], factor[k, 1], factor[k, 2] = table[i, 2], table[i, 3], table[i, 4]
        q_max[k], radius[k] = table[i, 7], table[i, 8]
        if count:
            _basis(_direction(means, i, eye)[0], count, basis)
        total = _colour(sh_dc, sh_rest, i, basis)
        colour[k, 0], colour[k, 1], colour[k, 2] = max(total[0], 0.0), max(total[1], 0.0), max(total[2], 0.0)


@_kernel
def _colour_backward(g, i, means, sh_dc, sh_rest, eye, basis, g_basis, g_dc, g_rest):
    """Writes the gradients of the SH coefficients; returns that of the mean, which comes through the direction."""
    count = sh_rest.shape[1]
    direction, inverse = _direction(means, i, eye)
    if count:
        _basis(direction, count, basis)
    total = _colour(sh_dc, sh_rest, i, basis)
    g = g[0] if total[0] > 0 else 0.0, g[1] if total[1] > 0 else 0.0, g[2] if total[2] > 0 else 0.0
    g_dc[i, 0], g_dc[i, 1], g_dc[i, 2] = SH_C0 * g[0], SH_C0 * g[1], SH_C0 * g[2]
    for k in range(count):
        g_basis[k] = _dot(g, _rest(sh_rest, i, k))
        if len(g_rest):
            g_rest[i, k, 0], g_rest[i, k, 1], g_rest[i, k, 2] = basis[k] * g[0], basis[k] * g[1], basis[k] * g[2]
    if not count:
        return 0.0, 0.0, 0.0
    g_direction = _basis_backward(direction, count, g_basis)
    return _sum(inverse, g_direction, -inverse * _dot(direction, g_direction), direction)


@_kernel
def _shape_backward(k, g_mean2d, g_factor, g_depth, i, means, log_scales, quats, view, g_log_scales, g_quats):
    """Writes the gradients of scales and rotation; returns that of the mean, which comes through the position on the screen."""
    point = _apply(view.rotation, _sum(1.0, _vector(means, i), -1.0, view.eye))
    rotation, unit, unit_scale = _rotation(quats, i)
    s = _vector(log_scales, i)
    scale = math.exp(s[0]), math.exp(s[1]), math.exp(s[2])
    a, b, m, n = _spread(point, scale, rotation, view)
    g_m, g_n = _factor_backward(_vector(g_factor, k), m, n)
    g_log_scales[i, 0], g_log_scales[i, 1], g_log_scales[i, 2] = _sum(1.0, _by(g_m, m), 1.0, _by(g_n, n))
    g_m, g_n = _by(g_m, scale), _by(g_n, scale)
    g_rotation = _sum(a[0], g_m, b[0], g_n), _sum(a[1], g_m, b[1], g_n), _sum(a[2], g_m, b[2], g_n)
    g_quats[i, 0], g_quats[i, 1], g_quats[i, 2], g_quats[i, 3] = _rotation_backward(g_rotation, unit, unit_scale)
    g_a, g_b = _apply(rotation, g_m), _apply(rotation, g_n)

    inverse, (focal_x, focal_y), forward = 1 / point[2], view.focal, view.rotation[2]
    ratio_x, ratio_y = point[0] * inverse, point[1] * inverse
    g_x, g_y = g_mean2d[k, 0] * focal_x, g_mean2d[k, 1] * focal_y
    if view.low[0] <= ratio_x <= view.high[0]:
        g_x -= focal_x * inverse * _dot(forward, g_a)
    if view.low[1] <= ratio_y <= view.high[1]:
        g_y -= focal_y * inverse * _dot(forward, g_b)
    # a and b are proportional to 1/z at a fixed slope, and so are the slopes at a fixed x and y
    g_z = g_depth[k] - inverse * (_dot(g_a, a) + _dot(g_b, b) + g_x * ratio_x + g_y * ratio_y)
    return _apply_transposed(view.rotation, (g_x * inverse, g_y * inverse, g_z))


@_kernel
def _backward(
    _slice, begin, end, slot, means, log_scales, quats, opacity, log_amp, sh_dc, sh_rest, view, g_mean2d, g_factor, g_opacity,
    g_colour, g_depth, g_means, g_log_scales, g_quats, g_logit, g_log_amp, g_dc, g_rest
):
    """Writes the gradients of every Gaussian, 0 for those without a slot. `g_means` and `g_rest` are empty if they are not
    wanted."""
    basis, g_basis = np.empty(15), np.empty(15)
    geometry, rest = len(g_means) > 0, len(g_rest) > 0
    for i in range(begin, end):
        k = slot[i]
        if k < 0:
            g_logit[i], g_log_amp[i], g_dc[i] = 0, 0, 0
            if geometry:
                g_means[i], g_log_scales[i], g_quats[i] = 0, 0, 0
            if rest:
                g_rest[i] = 0
            continue
        raw, moved = _amplified(opacity[i], log_amp[i])
        through = g_opacity[k] * raw if raw <= AMP_MAX else 0.0
        g_logit[i], g_log_amp[i] = through * moved, through
        toward = _colour_backward(
            _vector(g_colour, k), i, means, sh_dc, sh_rest, view.eye, basis, g_basis, g_dc, g_rest)
        if geometry:
            across = _shape_backward(
                k, g_mean2d, g_factor, g_depth, i, means, log_scales, quats, view, g_log_scales, g_quats)
            g_means[i, 0], g_means[i, 1], g_means[i, 2] = _sum(1.0, toward, 1.0, across)


def project_forward(fields: tuple[np.ndarray, ...], view: View, support: float) -> tuple[np.ndarray, ...]:
    """Index, mean2d, factor, opacity, colour, depth, q_max and radius of the survivors: see `projection.Projection`."""
    count = len(fields[0])
    table, keep = np.empty((count, 9), np.float32), np.empty(count, np.bool_)
    run_slices(_survey, count, *fields, view, float(support), table, keep)
    index = np.flatnonzero(keep)
    results = tuple(np.empty((len(index), *c), np.float32) for c in ((2,), (3,), (), (3,), (), (), ()))
    run_slices(_write, len(index), index, fields[0], fields[5], fields[6], view.eye, table, *results)
    return index, *results


def project_backward(
    fields: tuple[np.ndarray, ...], view: View, index: np.ndarray, gradients: tuple[np.ndarray, ...], geometry: bool, rest: bool
) -> tuple[np.ndarray, ...]:
    """Gradients of the fields from those of mean2d, factor, opacity, colour and depth; a gradient that is not wanted has no
    rows."""
    slot = np.full(len(fields[0]), -1, np.int64)
    slot[index] = np.arange(len(index))
    wanted = (geometry, geometry, geometry, True, True, True, rest)
    results = tuple(np.empty(f.shape if w else (0, *f.shape[1:]), np.float32) for f, w in zip(fields, wanted, strict=True))
    run_slices(_backward, len(slot), slot, *fields, view, *gradients, *results)
    return results
