"""Culling and conversion: Gaussian words to projected splats, in the machine's small floats.

Every `rnd` is one operation rounded to V, the `view` format, or W, the `work` format: the dataflow the unit implements.
The conic leaves as its upper Cholesky factor, scaled to the log2 domain, so that the falloff is u^2 + v^2 >= 0 whatever
the rounding, and needles lose no precision to cancellation.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from golden.msv2_ref.parallel import for_slices
from golden.msv2_ref.quantise import GaussianWords
from golden.msv2_ref.registers import FrameRegisters
from golden.msv2_ref.rounding import RoundTo, dot3, pattern, rnd, round_to
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import EXPONENT_SCALE, LOW_PASS, TILE

VISIBLE, NEAR, FAINT, OUTSIDE = 0, 1, 2, 3
REASONS = {NEAR: "near", FAINT: "opacity", OUTSIDE: "outside"}
"""Why a Gaussian was culled: at or behind the near plane, too faint for an alpha of 1/255, or off the frame."""

REACH_MARGIN = 2.0**-5
"""Added to the falloff limit (log2 units) of the tile test: covers the exponent's rounding, so that no pixel is missed."""

EDGE_MARGIN = 2.0**-5
"""Pixels by which the tile test widens every interval: covers the rounding of the work format at 2,048 pixels."""


class Projected(NamedTuple):
    """Culling's result per Gaussian.

    Attributes:
        reason: (N,) uint8, VISIBLE or why it was culled.
        mean2d: (N, 2) int32 raw `mean2d`.
        conic: (N, 3) float64 values of the `conic` format.
        depth, depth_key: (N,) int32 raw.
        box: (N, 4) int16 first and last tile column, first and last tile row of the footprint's bounding box.
    """

    reason: np.ndarray
    mean2d: np.ndarray
    conic: np.ndarray
    depth: np.ndarray
    depth_key: np.ndarray
    box: np.ndarray


class CullingConstants(NamedTuple):
    """Formats and constants of one configuration, as the kernels take them."""

    to_view: RoundTo
    to_work: RoundTo
    to_conic: RoundTo
    low_pass: float
    scale: float
    quat_one: int
    mean_one: float
    mean_min: float
    mean_max: float
    depth_one: float
    depth_max: float
    key_max: int
    cut_ulp: float
    faintest: int
    widest: int


@cache
def culling_constants(config: AcceleratorConfig) -> CullingConstants:
    """The constants of `config`; `faintest` and `widest` are raw with the fraction of `cut`, which `log2_opacity` shares."""
    n = config.formats
    support = tables.support_exponent(config)
    return CullingConstants(
        to_view=round_to(n.view), to_work=round_to(n.work), to_conic=round_to(n.conic), low_pass=float(n.work.round(LOW_PASS)),
        scale=float(n.work.round(EXPONENT_SCALE)), quat_one=1 << (2 * n.quaternion.frac_bits), mean_one=2.0**n.mean2d.frac_bits,
        mean_min=float(n.mean2d.raw_min), mean_max=float(n.mean2d.raw_max), depth_one=2.0**n.depth.frac_bits,
        depth_max=float(n.depth.raw_max), key_max=n.depth_key.raw_max, cut_ulp=2.0**-n.cut.frac_bits,
        faintest=tables.log2_alpha_min(n), widest=1 << 30 if support is None else support)


class _Camera(NamedTuple):
    """The registers the projection reads."""

    position: np.ndarray
    rotation: np.ndarray
    focal: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
    near: float
    width: int
    height: int
    key_near: int
    depth_scale: float


@numba.njit(cache=True)
def falloff_limit(opacity, k):
    """Largest u^2 + v^2 (a real number) at which an opacity (raw log2) still shows; negative: nowhere."""
    return min(opacity - k.faintest, k.widest) * k.cut_ulp


@numba.njit(cache=True)
def _rotation_column(quat, axis, k):
    """One column of the rotation matrix of a raw quaternion, exact products, rounded once to W."""
    w, x, y, z = np.int64(quat[0]), np.int64(quat[1]), np.int64(quat[2]), np.int64(quat[3])
    if axis == 0:
        c0, c1, c2 = k.quat_one - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    elif axis == 1:
        c0, c1, c2 = 2 * (x * y - w * z), k.quat_one - 2 * (x * x + z * z), 2 * (y * z + w * x)
    else:
        c0, c1, c2 = 2 * (x * z + w * y), 2 * (y * z - w * x), k.quat_one - 2 * (x * x + y * y)
    W = k.to_work
    return rnd(c0 / k.quat_one, W), rnd(c1 / k.quat_one, W), rnd(c2 / k.quat_one, W)


@numba.njit(cache=True)
def _jacobian_row(focal, rz, slope, along, forward, W):
    """One row of J R: focal / z * (R_axis - clamped slope * R_z)."""
    gain = rnd(focal * rz, W)
    return (rnd(gain * rnd(along[0] - rnd(slope * forward[0], W), W), W),
            rnd(gain * rnd(along[1] - rnd(slope * forward[1], W), W), W),
            rnd(gain * rnd(along[2] - rnd(slope * forward[2], W), W), W))


@numba.njit(cache=True)
def _splatted_axes(quat, axis, a, b, k):
    """The three scaled axes of the ellipsoid on the image plane: (p0, p1, p2) along x, (t0, t1, t2) along y."""
    W = k.to_work
    r = _rotation_column(quat, 0, k)
    p0 = rnd(dot3(W, a[0], a[1], a[2], r[0], r[1], r[2]) * axis[0], W)
    t0 = rnd(dot3(W, b[0], b[1], b[2], r[0], r[1], r[2]) * axis[0], W)
    r = _rotation_column(quat, 1, k)
    p1 = rnd(dot3(W, a[0], a[1], a[2], r[0], r[1], r[2]) * axis[1], W)
    t1 = rnd(dot3(W, b[0], b[1], b[2], r[0], r[1], r[2]) * axis[1], W)
    r = _rotation_column(quat, 2, k)
    p2 = rnd(dot3(W, a[0], a[1], a[2], r[0], r[1], r[2]) * axis[2], W)
    t2 = rnd(dot3(W, b[0], b[1], b[2], r[0], r[1], r[2]) * axis[2], W)
    return p0, p1, p2, t0, t1, t2


@numba.njit(cache=True)
def _conic(p0, p1, p2, t0, t1, t2, k):
    """Cholesky factors l1, l2, l3 and the 2D variances of the splatted axes, low-pass included."""
    W, C = k.to_work, k.to_conic
    bare_xx, bare_yy = dot3(W, p0, p1, p2, p0, p1, p2), dot3(W, t0, t1, t2, t0, t1, t2)
    cov_xy = dot3(W, p0, p1, p2, t0, t1, t2)
    cov_xx, cov_yy = rnd(bare_xx + k.low_pass, W), rnd(bare_yy + k.low_pass, W)
    m01 = rnd(rnd(p0 * t1, W) - rnd(p1 * t0, W), W)
    m02 = rnd(rnd(p0 * t2, W) - rnd(p2 * t0, W), W)
    m12 = rnd(rnd(p1 * t2, W) - rnd(p2 * t1, W), W)
    # Cauchy-Binet: the determinant as a sum of squares neither cancels nor underflows.
    det = rnd(dot3(W, m01, m02, m12, m01, m02, m12) + rnd(k.low_pass * rnd(bare_xx + cov_yy, W), W), W)
    root_yy = rnd(1.0 / np.sqrt(cov_yy), W)
    factor = rnd(rnd(root_yy * rnd(1.0 / np.sqrt(det), W), W) * k.scale, W)
    # A footprint too wide for the format is as good as flat: its factors stay at the smallest number, never zero.
    l1 = max(rnd(cov_yy * factor, C), C.smallest)
    l2 = rnd(-(cov_xy * factor), C)
    l3 = max(rnd(root_yy * k.scale, C), C.smallest)
    return l1, l2, l3, cov_xx, cov_yy


@numba.njit(cache=True)
def _tile_range(mean, extent, size):
    """First and last tile along one axis whose pixel centres lie within `extent` of the mean; first > last: none."""
    first = np.ceil(mean - extent - 0.5)
    last = np.floor(mean + extent - 0.5)
    if first > last or first > size - 1 or last < 0:
        return 1, 0
    return int(max(first, 0.0)) // TILE, int(min(last, size - 1.0)) // TILE


@numba.njit(cache=True)
def _to_pixels(slope, focal, centre, k):
    """Raw `mean2d` of a perspective slope: focal * slope rounded HALF_UP onto the grid, plus the principal point."""
    return min(max(np.floor(rnd(focal * slope, k.to_view) * k.mean_one + 0.5) + centre, k.mean_min), k.mean_max)


@numba.njit(cache=True, nogil=True)
def _project(_slice, begin, end, mean, axis, quat, opacity, cam, k, reason, mean2d, conic, depth, depth_key, box):
    V, W = k.to_view, k.to_work
    rot, limits = cam.rotation, cam.limits
    for i in range(begin, end):
        dx, dy, dz = (rnd(mean[i, 0] - cam.position[0], V), rnd(mean[i, 1] - cam.position[1], V),
                      rnd(mean[i, 2] - cam.position[2], V))
        z = dot3(V, rot[2, 0], rot[2, 1], rot[2, 2], dx, dy, dz)
        limit = falloff_limit(opacity[i], k)
        if not z > cam.near or limit < 0:
            reason[i] = FAINT if z > cam.near else NEAR
            continue
        rz = rnd(1.0 / z, V)
        x = rnd(dot3(V, rot[0, 0], rot[0, 1], rot[0, 2], dx, dy, dz) * rz, V)
        y = rnd(dot3(V, rot[1, 0], rot[1, 1], rot[1, 2], dx, dy, dz) * rz, V)
        a = _jacobian_row(cam.focal[0], rz, min(max(x, limits[0]), limits[1]), rot[0], rot[2], W)
        b = _jacobian_row(cam.focal[1], rz, min(max(y, limits[2]), limits[3]), rot[1], rot[2], W)
        p0, p1, p2, t0, t1, t2 = _splatted_axes(quat[i], axis[i], a, b, k)
        l1, l2, l3, cov_xx, cov_yy = _conic(p0, p1, p2, t0, t1, t2, k)
        conic[i, 0], conic[i, 1], conic[i, 2] = l1, l2, l3
        mx, my = _to_pixels(x, cam.focal[0], cam.centre[0], k), _to_pixels(y, cam.focal[1], cam.centre[1], k)
        mean2d[i, 0], mean2d[i, 1] = int(mx), int(my)
        reach = rnd(rnd(np.sqrt(rnd(limit + REACH_MARGIN, W)), W) / k.scale, W)
        x0, x1 = _tile_range(mx / k.mean_one, rnd(rnd(np.sqrt(cov_xx), W) * reach, W) + EDGE_MARGIN, cam.width)
        y0, y1 = _tile_range(my / k.mean_one, rnd(rnd(np.sqrt(cov_yy), W) * reach, W) + EDGE_MARGIN, cam.height)
        box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x0, x1, y0, y1
        reason[i] = OUTSIDE if x0 > x1 or y0 > y1 else VISIBLE
        depth[i] = int(min(np.floor(rnd(z * cam.depth_scale, V) * k.depth_one + 0.5), k.depth_max))
        depth_key[i] = min(pattern(z, V) - cam.key_near, k.key_max)


def project(config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters) -> Projected:
    """Projects every Gaussian: near test before the division, then mean, conic, footprint and depth."""
    n, count, g, r = config.formats, len(words.geometry), words.geometry, registers
    out = Projected(
        np.zeros(count, np.uint8), np.zeros((count, 2), np.int32), np.zeros((count, 3)),
        np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros((count, 4), np.int16))
    used = np.arange(g["log2_opacity"].shape[1]) <= g["bound"][:, None]
    strongest = np.where(used, g["log2_opacity"], n.log2_opacity.raw_min).max(axis=1).astype(np.int32)
    camera = _Camera(r.position, r.rotation, r.focal, r.centre.astype(np.float64), r.limits, r.near, r.width, r.height,
                     r.key_near, r.depth_scale)
    for_slices(_project, count, n.position.to_float(g["mean"]), n.scale.to_float(g["scale"]), np.ascontiguousarray(g["quat"]),
               strongest, camera, culling_constants(config), *out)
    return out
