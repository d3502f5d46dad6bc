"""Projection: Gaussian words to projected splats, in the machine's small floats.

Every `rnd` is one operation rounded to V (the `view` format) or to W (the `work` format), or the conversion of a value from one
to the other. This is the dataflow that the hardware unit implements.

The result is the conic's upper Cholesky factor, in the log2 domain. So the falloff is u^2 + v^2 >= 0 whatever the rounding, and
needle-shaped splats lose no precision to cancellation. Multiplying by the focal lengths and dividing by EXPONENT_SCALE cost the
unit nothing, because the host has applied both to the rotation that it writes: slopes come out in pixels, and covariances in
units in which the inverse root of a variance is a factor of the conic.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters
from golden.host.rounding import RoundTo, dot3, operation, pattern, rnd, round_to
from golden.kernels import compiled
from golden.msv2_ref.chunk_test import read_chunks, read_points
from golden.threads import for_slices
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import EXTENT_SHARE, TILE, TILE_EDGE_MARGIN, TILE_REACH_MARGIN
from spec.records import opacities_carried, projected_splat

VISIBLE, NEAR, FAINT, OUTSIDE, UNREAD = 0, 1, 2, 3, 4
REASONS = {NEAR: "near", FAINT: "opacity", OUTSIDE: "outside"}
"""Why a Gaussian was culled: it lies at or behind the near plane, is too faint for an alpha of 1/255, or is outside: its box
lies off the frame or its mean beyond the guard band (`spec.guard_band`).

A Gaussian is UNREAD where the chunk test skipped its chunk. No unit sees it, so that no counter counts it."""

class Projected(NamedTuple):
    """The projection's result for each Gaussian.

    Attributes:
        reason: (N,) uint8, VISIBLE or why it was culled, or UNREAD.
        mean2d: (N, 2) int32 raw `mean2d`.
        conic: (N, 3) float64 values of the `conic` format.
        depth, depth_key: (N,) int32 raw.
        box: (N, 4) int16, first and last tile column, first and last tile row of the footprint's bounding box; first > last
            along an axis on which it lies off the frame.
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
    to_extent: RoundTo
    low_pass: float
    quat_ulp: float
    mean_one: float
    mean_min: float
    mean_max: float
    band_low: float
    band_high: float
    depth_one: float
    depth_max: float
    key_max: int
    cut_ulp: float
    faintest: int
    widest: int


@cache
def culling_constants(config: AcceleratorConfig) -> CullingConstants:
    """The constants of `config`. `faintest` and `widest` are raw numbers with the fraction bits of `cut`, which are
    `log2_opacity`'s; a raw `mean2d` between `band_low` and `band_high`, without these two, lies within the guard band."""
    n = config.formats
    support = tables.support_exponent(config)
    return CullingConstants(
        to_view=round_to(n.view), to_work=round_to(n.work), to_conic=round_to(n.conic), to_extent=round_to(n.extent),
        low_pass=tables.scaled_low_pass(n), quat_ulp=2.0**-n.quaternion.frac_bits, mean_one=2.0**n.mean2d.frac_bits,
        mean_min=float(n.mean2d.raw_min), mean_max=float(n.mean2d.raw_max),
        band_low=float(n.mean2d.raw_min), band_high=float(n.mean2d.raw_max), depth_one=2.0**n.depth.frac_bits,
        depth_max=float(n.depth.raw_max), key_max=n.depth_key.raw_max, cut_ulp=2.0**-n.cut.frac_bits,
        faintest=tables.log2_alpha_min(n), widest=1 << 30 if support is None else support)


class _Camera(NamedTuple):
    """The registers that the projection reads; `key_near` is the near plane's bit pattern, which depth keys count from."""

    position: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
    near: float
    width: int
    height: int
    key_near: int
    depth_scale: float


@operation
def falloff_limit(opacity, k):
    """Largest u^2 + v^2 (a real number) at which a splat of this opacity (raw log2) is still visible; negative if it never
    is."""
    return min(opacity - k.faintest, k.widest) * k.cut_ulp


@operation
def _rotation_columns(w, x, y, z, W):
    """The columns of the rotation matrix of a quaternion."""
    x2, y2, z2 = 2 * x, 2 * y, 2 * z
    xx, xy, xz, wx = rnd(x2 * x, W), rnd(x2 * y, W), rnd(x2 * z, W), rnd(x2 * w, W)
    yy, yz, wy = rnd(y2 * y, W), rnd(y2 * z, W), rnd(y2 * w, W)
    zz, wz = rnd(z2 * z, W), rnd(z2 * w, W)
    return ((rnd(1.0 - rnd(yy + zz, W), W), rnd(xy + wz, W), rnd(xz - wy, W)),
            (rnd(xy - wz, W), rnd(1.0 - rnd(xx + zz, W), W), rnd(yz + wx, W)),
            (rnd(xz + wy, W), rnd(yz - wx, W), rnd(1.0 - rnd(xx + yy, W), W)))


@operation
def _jacobian_row(slope, along, forward, W):
    """One row of J R times z: focal * R_axis - clamped slope * R_z, with the slope in pixels."""
    s = rnd(slope, W)
    return (rnd(along[0] - rnd(s * forward[0], W), W), rnd(along[1] - rnd(s * forward[1], W), W),
            rnd(along[2] - rnd(s * forward[2], W), W))


@operation
def _splatted_axis(a, b, column, scale, rz, W):
    """One scaled axis of the ellipsoid projected onto the image plane: its components along x and y."""
    length = rnd(scale * rz, W)
    return (rnd(dot3(W, a[0], a[1], a[2], column[0], column[1], column[2]) * length, W),
            rnd(dot3(W, b[0], b[1], b[2], column[0], column[1], column[2]) * length, W))


@operation
def _conic(first, second, third, k):
    """Cholesky factors l1, l2, l3 and the 2D variances of the projected axes, including the low-pass."""
    W, C = k.to_work, k.to_conic
    (p0, t0), (p1, t1), (p2, t2) = first, second, third
    bare_xx, bare_yy = dot3(W, p0, p1, p2, p0, p1, p2), dot3(W, t0, t1, t2, t0, t1, t2)
    cov_xy = dot3(W, p0, p1, p2, t0, t1, t2)
    cov_xx, cov_yy = rnd(bare_xx + k.low_pass, W), rnd(bare_yy + k.low_pass, W)
    m01 = rnd(rnd(p0 * t1, W) - rnd(p1 * t0, W), W)
    m02 = rnd(rnd(p0 * t2, W) - rnd(p2 * t0, W), W)
    m12 = rnd(rnd(p1 * t2, W) - rnd(p2 * t1, W), W)
    # Cauchy-Binet: the determinant as a sum of squares suffers from neither cancellation nor underflow.
    det = rnd(dot3(W, m01, m02, m12, m01, m02, m12) + rnd(k.low_pass * rnd(bare_xx + cov_yy, W), W), W)
    root_yy = rnd(1.0 / np.sqrt(cov_yy), W)
    factor = rnd(root_yy * rnd(1.0 / np.sqrt(det), W), W)
    # A footprint that is too wide for the format is practically flat: its factors are the smallest number, never zero.
    l1 = max(rnd(rnd(cov_yy * factor, W), C), C.smallest)
    l2 = rnd(-rnd(cov_xy * factor, W), C)
    l3 = max(rnd(root_yy, C), C.smallest)
    return l1, l2, l3, cov_xx, cov_yy


@operation
def _extent(variance, limit, k):
    """Half extent of the footprint along an axis in ulps of `mean2d`, an integer that rounding never makes too small.

    The share of 2^-8 that is added exceeds the root's error of 2^-9, and the margin exceeds what fixed point truncates.
    """
    root = rnd(np.sqrt(rnd(variance * limit, k.to_work)), k.to_extent)
    raw = min(np.floor(root * k.mean_one + 0.5), k.mean_max * 2 + 1)
    return raw + np.floor(raw * 2.0**-EXTENT_SHARE) + TILE_EDGE_MARGIN * k.mean_one


@operation
def _tile_range(mean, extent, size, k):
    """First and last tile along one axis whose pixel centres lie within `extent` of the mean; 1, 0 if there is none."""
    first, last = np.ceil((mean - extent) / k.mean_one - 0.5), np.floor((mean + extent) / k.mean_one - 0.5)
    if first > last or first > size - 1 or last < 0:
        return 1, 0
    return int(max(first, 0.0)) // TILE, int(min(last, size - 1.0)) // TILE


@operation
def _to_pixels(slope, centre, k):
    """Raw `mean2d` of a perspective slope in pixels, rounded HALF_UP with one bit more than `mean2d`, plus the principal
    point."""
    raw = min(max(np.floor(slope * k.mean_one + 0.5), 2 * k.mean_min), 2 * k.mean_max + 1)
    return min(max(raw + centre, k.mean_min), k.mean_max)


@operation
def _beyond(x, y, k):
    """Whether a raw `mean2d` lies at the end of its range along an axis, where it may have been clamped."""
    return not (k.band_low < x < k.band_high and k.band_low < y < k.band_high)


@operation
def _relative(x, y, z, px, py, pz, V):
    """World coordinates relative to the camera."""
    return rnd(x - px, V), rnd(y - py, V), rnd(z - pz, V)


@compiled(nogil=True, error_model="numpy")
def _view_depth(_slice, begin, end, mean, cam, k, depth):
    """Writes the camera z of the Gaussians begin..end."""
    V, rot = k.to_view, cam.rotation
    r0, r1, r2 = rot[2, 0], rot[2, 1], rot[2, 2]
    px, py, pz = cam.position[0], cam.position[1], cam.position[2]
    for i in range(begin, end):
        dx, dy, dz = _relative(mean[i, 0], mean[i, 1], mean[i, 2], px, py, pz, V)
        depth[i] = dot3(V, r0, r1, r2, dx, dy, dz)


_BLOCK = 64
_MEAN, _SCALE, _QUAT, _LIMIT, _CONIC, _MEAN2D, _EXTENT, _DEPTH = (_BLOCK * row for row in (0, 3, 6, 10, 11, 14, 16, 18))
_BLOCK_ROWS = 19


@compiled(error_model="numpy")
def _project_block(block, cam, k):
    """Mean, conic, extent and depth of _BLOCK Gaussians. One array and no branches, so that LLVM vectorises the loop."""
    V, W = k.to_view, k.to_work
    rot, turn, limits, position = cam.rotation, cam.turn, cam.limits, cam.position
    a0, a1, a2, b0, b1, b2 = rot[0, 0], rot[0, 1], rot[0, 2], rot[1, 0], rot[1, 1], rot[1, 2]
    c0, c1, c2 = rot[2, 0], rot[2, 1], rot[2, 2]
    wa0, wa1, wa2, wb0, wb1, wb2 = turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2]
    wc0, wc1, wc2 = turn[2, 0], turn[2, 1], turn[2, 2]
    centre_x, centre_y = cam.centre[0], cam.centre[1]
    low_x, high_x, low_y, high_y = limits[0], limits[1], limits[2], limits[3]
    px, py, pz = position[0], position[1], position[2]
    for j in range(_BLOCK):
        dx, dy, dz = _relative(block[_MEAN + j], block[_MEAN + _BLOCK + j], block[_MEAN + 2 * _BLOCK + j], px, py, pz, V)
        z = dot3(V, c0, c1, c2, dx, dy, dz)
        rz = rnd(1.0 / z, V)
        x = rnd(dot3(V, a0, a1, a2, dx, dy, dz) * rz, V)
        y = rnd(dot3(V, b0, b1, b2, dx, dy, dz) * rz, V)
        a = _jacobian_row(min(max(x, low_x), high_x), (wa0, wa1, wa2), (wc0, wc1, wc2), W)
        b = _jacobian_row(min(max(y, low_y), high_y), (wb0, wb1, wb2), (wc0, wc1, wc2), W)
        first, second, third = _rotation_columns(
            block[_QUAT + j] * k.quat_ulp, block[_QUAT + _BLOCK + j] * k.quat_ulp, block[_QUAT + 2 * _BLOCK + j] * k.quat_ulp,
            block[_QUAT + 3 * _BLOCK + j] * k.quat_ulp, W)
        near = rnd(rz, W)
        l1, l2, l3, cov_xx, cov_yy = _conic(
            _splatted_axis(a, b, first, block[_SCALE + j], near, W),
            _splatted_axis(a, b, second, block[_SCALE + _BLOCK + j], near, W),
            _splatted_axis(a, b, third, block[_SCALE + 2 * _BLOCK + j], near, W), k)
        limit = rnd(block[_LIMIT + j] + TILE_REACH_MARGIN, W)
        block[_CONIC + j], block[_CONIC + _BLOCK + j], block[_CONIC + 2 * _BLOCK + j] = l1, l2, l3
        block[_MEAN2D + j], block[_MEAN2D + _BLOCK + j] = _to_pixels(x, centre_x, k), _to_pixels(y, centre_y, k)
        block[_EXTENT + j], block[_EXTENT + _BLOCK + j] = _extent(cov_xx, limit, k), _extent(cov_yy, limit, k)
        block[_DEPTH + j] = min(np.floor(rnd(z * cam.depth_scale, V) * k.depth_one + 0.5), k.depth_max)


@compiled(nogil=True, error_model="numpy")
def _project(
    _slice, begin, end, rows, view_depth, mean, scale, quat, opacity, cam, k, reason, mean2d, conic, depth, depth_key, box,
):
    """Gathers the Gaussians at `rows` in blocks, projects each block and scatters the results."""
    block = np.ones(_BLOCK * _BLOCK_ROWS)
    for start in range(begin, end, _BLOCK):
        count = min(end - start, _BLOCK)
        for j in range(count):
            i = rows[start + j]
            for c in range(3):
                block[_MEAN + c * _BLOCK + j], block[_SCALE + c * _BLOCK + j] = mean[i, c], scale[i, c]
            for c in range(4):
                block[_QUAT + c * _BLOCK + j] = quat[i, c]
            block[_LIMIT + j] = falloff_limit(opacity[i], k)
        _project_block(block, cam, k)
        for j in range(count):
            i = rows[start + j]
            for c in range(3):
                conic[i, c] = block[_CONIC + c * _BLOCK + j]
            mx, my = block[_MEAN2D + j], block[_MEAN2D + _BLOCK + j]
            mean2d[i, 0], mean2d[i, 1] = int(mx), int(my)
            x0, x1 = _tile_range(mx, block[_EXTENT + j], cam.width, k)
            y0, y1 = _tile_range(my, block[_EXTENT + _BLOCK + j], cam.height, k)
            box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x0, x1, y0, y1
            reason[i] = OUTSIDE if x0 > x1 or y0 > y1 or _beyond(mx, my, k) else VISIBLE
            depth[i] = int(block[_DEPTH + j])
            depth_key[i] = min(pattern(view_depth[i], k.to_view) - cam.key_near, k.key_max)


def project(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, rendered: np.ndarray | None = None,
    read: np.ndarray | None = None,
) -> Projected:
    """Projects every Gaussian that is read: first the near test, which needs no division, then mean, conic, footprint and
    depth.

    Args:
        config: the machine.
        words: the DRAM image.
        registers: the frame's registers.
        rendered: (tiles,) bool: tiles that are rendered, which the chunk test asks for; None: all.
        read: (C,) bool: the chunks that are read; None: those that pass the chunk test.
    """
    count, r, k = len(words.geometry), registers, culling_constants(config)
    out = Projected(
        np.zeros(count, np.uint8), np.zeros((count, 2), np.int32), np.zeros((count, 3)),
        np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros((count, 4), np.int16))
    camera = _Camera(r.position, r.rotation, r.turn, r.centre.astype(np.float64), r.limits, r.near, r.width, r.height,
                     pattern(r.near, k.to_view), r.depth_scale)
    d = words.decoded
    view_depth = np.empty(count)
    for_slices(_view_depth, count, d.mean, camera, k, view_depth)
    near, faint = ~(view_depth > r.near), d.opacity < k.faintest
    out.reason[faint], out.reason[near] = FAINT, NEAR
    if words.chunks is not None:
        read = read_chunks(config, words.chunks, count, registers, rendered) if read is None else read
        out.reason[~read_points(words.chunks, read, count)] = UNREAD
    rows = np.flatnonzero(out.reason == VISIBLE)
    for_slices(_project, len(rows), rows, view_depth, d.mean, d.scale, d.quat, d.opacity, camera, k, *out)
    return out


def projected_splats(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, projected: Projected | None = None,
) -> np.ndarray:
    """(visible + 1,) ProjectedSplat records in index order, as the projection unit emits them; the last one is the frame's
    `end`. `projected` are the projection's results, where they are known."""
    n, g, projected = config.formats, words.geometry, projected or project(config, words, registers)
    rows = np.flatnonzero(projected.reason == VISIBLE)
    out = np.zeros(len(rows) + 1, projected_splat(config).dtype)
    splats = out[:-1]
    splats["index"], splats["bound"] = rows, g["bound"][rows]
    splats["log2_opacity"] = (words.decoded.opacity if opacities_carried(config) == 1 else g["log2_opacity"])[rows]
    for name in ("mean2d", "depth", "depth_key"):
        splats[name] = getattr(projected, name)[rows]
    splats["conic"] = n.conic.quantise(projected.conic[rows])
    splats["offset"] = n.view.quantise(words.decoded.mean[rows] - registers.position)
    for side, name in enumerate(("first_x", "last_x", "first_y", "last_y")):
        splats[name] = projected.box[rows, side]
    out["end"][-1] = 1
    return out
