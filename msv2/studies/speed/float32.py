"""A renderer in float32 with the structure of the integer golden renderer, for speed comparisons, as fast as numba makes it.

The algorithm is the same in every stage: camera depths, survivors in blocks of vectors, one pass over tile rows, count and
scatter, intersections set up in blocks, rows of 16 pixels as vectors, and the same tests that skip rows and stop tiles. It
differs only in what integer arithmetic forces on the golden renderer: intermediate results are not rounded, the exponential is
a polynomial instead of a table, and `fastmath` is on. It renders one level, with depth.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from golden.kernels import compiled
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.threads import SLICES, for_slices
from spec import constants
from spec.constants import FRUSTUM_MARGIN, SH_C0, TILE
from spec.guard_band import MEAN_RANGE
from spec.harmonics import C1, C2, C2_Z, C3_0, C3_1, C3_2, C3_3

kernel = compiled(nogil=True, fastmath=True, error_model="numpy")
inlined = compiled(forceinline=True, fastmath=True, error_model="numpy")
F = np.float32

_ONE, _HALF, _TWO, _ZERO = F(1), F(0.5), F(2), F(0)
_SCALE, _SMOOTH, _FAINTEST = F(constants.EXPONENT_SCALE), F(constants.LOW_PASS), F(-math.log2(constants.ALPHA_MIN))
_SUPPORT = F(constants.LOG2E_HALF * constants.SUPPORT_SIGMA**2)
_ALPHA_MAX, _T_STOP, (_BAND_LOW, _BAND_HIGH) = F(constants.ALPHA_MAX_L1), F(constants.T_STOP), map(F, MEAN_RANGE)
_SH1, _SH2 = F(C1), tuple(map(F, (C2, -C2, C2_Z, -C2, C2 / 2)))
_SH3 = tuple(map(F, (-C3_3, C3_2, -C3_1, C3_0, -C3_1, C3_2 / 2, -C3_3)))
_EXP2 = tuple(map(F, (1.00000349, 0.69297292, 0.24160436, 0.051745, 0.01367031)))  # 2^f on [0, 1] to 3.5e-6

_BLOCK = 64
_PAIRS = 32  # intersections that are set up at once
_MEAN, _AXIS, _QUAT, _CONIC, _MEAN2D, _EXTENT = (_BLOCK * row for row in (0, 3, 6, 10, 13, 15))
_X, _Y, _Z, _BASIS = (_BLOCK * row for row in range(4))
_T, _RED, _GREEN, _BLUE, _FAR = range(0, 5 * TILE, TILE)


class FloatModel(NamedTuple):
    """A model as the float32 renderer keeps it, computed once per model. All arrays are float32 with N rows.

    Attributes:
        mean: (N, 3) relative to `origin`.
        axis: (N, 3) standard deviations.
        quat: (N, 4) normalised wxyz.
        log2_opacity: (N,).
        limit: (N,) largest falloff exponent (in log2 units) that is visible; negative if there is none.
        base: (N, 3) colour without its view-dependent part.
        rest: (N, 3 K) higher harmonics.
        origin: (3,) float64 world position.
    """

    mean: np.ndarray
    axis: np.ndarray
    quat: np.ndarray
    log2_opacity: np.ndarray
    limit: np.ndarray
    base: np.ndarray
    rest: np.ndarray
    origin: np.ndarray


class FloatFrame(NamedTuple):
    """A frame: `image` (H, W, 3), `depth_sum` and `transmittance` (H, W), all float32, and the `seconds` of each stage."""

    image: np.ndarray
    depth_sum: np.ndarray
    transmittance: np.ndarray
    seconds: dict[str, float]


def prepare(model: GaussianModel) -> FloatModel:
    """The first level of the model, prepared for `render`."""
    origin = np.median(model.means, axis=0)
    log2_opacity = np.log2(np.maximum(model.opacity[:, 0], 2.0**-16)).astype(F)
    return FloatModel(
        (model.means - origin).astype(F), np.exp(model.log_scales).astype(F),
        (model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)).astype(F), log2_opacity,
        np.minimum(log2_opacity + _FAINTEST, _SUPPORT), (SH_C0 * model.sh_dc[:, 0] + 0.5).astype(F),
        model.sh_rest.reshape(len(model), -1).astype(F), origin)


class _View(NamedTuple):
    position: np.ndarray
    rotation: np.ndarray
    focal: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
    width: int
    height: int


@kernel
def _view_depth(_slice, begin, end, mean, view, depth):
    r0, r1, r2 = view.rotation[2, 0], view.rotation[2, 1], view.rotation[2, 2]
    px, py, pz = view.position[0], view.position[1], view.position[2]
    for i in range(begin, end):
        depth[i] = r0 * (mean[i, 0] - px) + r1 * (mean[i, 1] - py) + r2 * (mean[i, 2] - pz)


@inlined
def _splatted_axis(a0, a1, a2, b0, b1, b2, r0, r1, r2, length):
    return (a0 * r0 + a1 * r1 + a2 * r2) * length, (b0 * r0 + b1 * r1 + b2 * r2) * length


@kernel
def _project_block(block, view):
    rot, limits = view.rotation, view.limits
    a0, a1, a2, b0, b1, b2 = rot[0, 0], rot[0, 1], rot[0, 2], rot[1, 0], rot[1, 1], rot[1, 2]
    c0, c1, c2 = rot[2, 0], rot[2, 1], rot[2, 2]
    px, py, pz = view.position[0], view.position[1], view.position[2]
    fx, fy, centre_x, centre_y = view.focal[0], view.focal[1], view.centre[0], view.centre[1]
    low_x, high_x, low_y, high_y = limits[0], limits[1], limits[2], limits[3]
    for j in range(_BLOCK):
        dx, dy, dz = block[_MEAN + j] - px, block[_MEAN + _BLOCK + j] - py, block[_MEAN + 2 * _BLOCK + j] - pz
        rz = _ONE / (c0 * dx + c1 * dy + c2 * dz)
        x, y = (a0 * dx + a1 * dy + a2 * dz) * rz, (b0 * dx + b1 * dy + b2 * dz) * rz
        sx, sy, gx, gy = min(max(x, low_x), high_x), min(max(y, low_y), high_y), fx * rz, fy * rz
        j0, j1, j2 = gx * (a0 - sx * c0), gx * (a1 - sx * c1), gx * (a2 - sx * c2)
        k0, k1, k2 = gy * (b0 - sy * c0), gy * (b1 - sy * c1), gy * (b2 - sy * c2)
        q, qx = block[_QUAT + j], block[_QUAT + _BLOCK + j]
        qy, qz = block[_QUAT + 2 * _BLOCK + j], block[_QUAT + 3 * _BLOCK + j]
        p0, t0 = _splatted_axis(j0, j1, j2, k0, k1, k2, _ONE - _TWO * (qy * qy + qz * qz), _TWO * (qx * qy + q * qz),
                                _TWO * (qx * qz - q * qy), block[_AXIS + j])
        p1, t1 = _splatted_axis(j0, j1, j2, k0, k1, k2, _TWO * (qx * qy - q * qz), _ONE - _TWO * (qx * qx + qz * qz),
                                _TWO * (qy * qz + q * qx), block[_AXIS + _BLOCK + j])
        p2, t2 = _splatted_axis(j0, j1, j2, k0, k1, k2, _TWO * (qx * qz + q * qy), _TWO * (qy * qz - q * qx),
                                _ONE - _TWO * (qx * qx + qy * qy), block[_AXIS + 2 * _BLOCK + j])
        bare_xx, cov_xy, bare_yy = p0 * p0 + p1 * p1 + p2 * p2, p0 * t0 + p1 * t1 + p2 * t2, t0 * t0 + t1 * t1 + t2 * t2
        m0, m1, m2 = p0 * t1 - p1 * t0, p0 * t2 - p2 * t0, p1 * t2 - p2 * t1
        cov_yy = bare_yy + _SMOOTH
        det = m0 * m0 + m1 * m1 + m2 * m2 + _SMOOTH * (bare_xx + cov_yy)
        root_yy = _ONE / np.sqrt(cov_yy)
        factor = root_yy * _SCALE / np.sqrt(det)
        block[_CONIC + j], block[_CONIC + _BLOCK + j] = cov_yy * factor, -cov_xy * factor
        block[_CONIC + 2 * _BLOCK + j] = root_yy * _SCALE
        block[_MEAN2D + j], block[_MEAN2D + _BLOCK + j] = fx * x + centre_x, fy * y + centre_y
        block[_EXTENT + j], block[_EXTENT + _BLOCK + j] = np.sqrt(bare_xx + _SMOOTH) / _SCALE, np.sqrt(cov_yy) / _SCALE


@inlined
def _tile_range(mean, extent, size):
    first, last = np.ceil(mean - extent - _HALF), np.floor(mean + extent - _HALF)
    if first > last or first > size - 1 or last < 0 or not _BAND_LOW < mean < _BAND_HIGH:
        return 1, 0
    return int(max(first, _ZERO)) // TILE, int(min(last, F(size - 1))) // TILE


@kernel
def _project(_slice, begin, end, rows, mean, axis, quat, limit, view, mean2d, conic, box):
    block = np.ones(_BLOCK * 17, np.float32)
    for start in range(begin, end, _BLOCK):
        count = min(end - start, _BLOCK)
        for j in range(count):
            i = rows[start + j]
            for c in range(3):
                block[_MEAN + c * _BLOCK + j], block[_AXIS + c * _BLOCK + j] = mean[i, c], axis[i, c]
            for c in range(4):
                block[_QUAT + c * _BLOCK + j] = quat[i, c]
        _project_block(block, view)
        for j in range(count):
            i = rows[start + j]
            reach = np.sqrt(limit[i])
            for c in range(3):
                conic[i, c] = block[_CONIC + c * _BLOCK + j]
            mean2d[i, 0], mean2d[i, 1] = block[_MEAN2D + j], block[_MEAN2D + _BLOCK + j]
            box[i, 0], box[i, 1] = _tile_range(mean2d[i, 0], block[_EXTENT + j] * reach, view.width)
            box[i, 2], box[i, 3] = _tile_range(mean2d[i, 1], block[_EXTENT + _BLOCK + j] * reach, view.height)


@inlined
def _columns(mx, my, l1, l2, l3, limit, rim, steep, row, view):
    """The first and last tile column that the ellipse meets in tile row `row`; first > last if there is none."""
    low = max(F(row * TILE) + _HALF - my, -rim)
    high = min(F(min(row * TILE + TILE, view.height)) - _HALF - my, rim)
    if low > high:
        return 1, 0
    left_y, right_y = min(max(steep, low), high), min(max(-steep, low), high)
    left = -np.sqrt(max(limit - (l3 * left_y) ** 2, _ZERO)) - l2 * left_y
    right = np.sqrt(max(limit - (l3 * right_y) ** 2, _ZERO)) - l2 * right_y
    first, last = np.ceil(mx + left / l1 - _HALF), np.floor(mx + right / l1 - _HALF)
    if first > view.width - 1 or last < 0 or first > last:
        return 1, 0
    return int(max(first, _ZERO)) // TILE, int(min(last, F(view.width - 1))) // TILE


@kernel
def _visit(part, begin, end, splats, room, mean2d, conic, box, limits, view, tiles_x, tile_of, splat_of, counts, passed):
    at = room[begin]
    for n in range(begin, end):
        i = splats[n]
        mx, my, limit = mean2d[i, 0], mean2d[i, 1], limits[i]
        l1, l2, l3 = conic[i, 0], conic[i, 1], conic[i, 2]
        root = np.sqrt(limit)
        rim, steep = root / l3, l2 * root / (l3 * np.sqrt(l2 * l2 + l3 * l3))
        for row in range(box[i, 2], box[i, 3] + 1):
            first, last = _columns(mx, my, l1, l2, l3, limit, rim, steep, row, view)
            for tile in range(row * tiles_x + first, row * tiles_x + last + 1):
                tile_of[at], splat_of[at] = tile, i
                counts[part, tile] += 1
                at += 1
    passed[part] = at - room[begin]


@kernel
def _scatter(part, begin, _end, room, passed, tile_of, splat_of, cursor, splat):
    for e in range(room[begin], room[begin] + passed[part]):
        splat[cursor[part, tile_of[e]]] = splat_of[e]
        cursor[part, tile_of[e]] += 1


@kernel
def _basis(block, position):
    """Computes the directions from the camera to the positions in rows X, Y, Z, and the basis functions beyond the first, from
    row BASIS on."""
    px, py, pz = position[0], position[1], position[2]
    (c20, c21, c22, c23, c24), (c30, c31, c32, c33, c34, c35, c36) = _SH2, _SH3
    for j in range(_BLOCK):
        dx, dy, dz = block[_X + j] - px, block[_Y + j] - py, block[_Z + j] - pz
        inverse = _ONE / np.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = dx * inverse, dy * inverse, dz * inverse
        xx, yy, zz, at = x * x, y * y, z * z, _BASIS + j
        block[at], block[at + _BLOCK], block[at + 2 * _BLOCK] = -_SH1 * y, _SH1 * z, -_SH1 * x
        block[at + 3 * _BLOCK], block[at + 4 * _BLOCK] = c20 * x * y, c21 * y * z
        block[at + 5 * _BLOCK] = c22 * (_TWO * zz - xx - yy)
        block[at + 6 * _BLOCK], block[at + 7 * _BLOCK] = c23 * x * z, c24 * (xx - yy)
        block[at + 8 * _BLOCK], block[at + 9 * _BLOCK] = c30 * y * (F(3) * xx - yy), c31 * x * y * z
        block[at + 10 * _BLOCK] = c32 * y * (F(4) * zz - xx - yy)
        block[at + 11 * _BLOCK] = c33 * z * (_TWO * zz - F(3) * (xx + yy))
        block[at + 12 * _BLOCK] = c34 * x * (F(4) * zz - xx - yy)
        block[at + 13 * _BLOCK], block[at + 14 * _BLOCK] = c35 * z * (xx - yy), c36 * x * (xx - F(3) * yy)


@kernel
def _colours(_slice, begin, end, rows, mean, base, rest, position, colour):
    block, coefficient = np.ones(18 * _BLOCK, np.float32), np.zeros(_BLOCK, np.float32)
    total = np.zeros((3, _BLOCK), np.float32)
    for start in range(begin, end, _BLOCK):
        count = min(end - start, _BLOCK)
        for j in range(count):
            i = rows[start + j]
            block[_X + j], block[_Y + j], block[_Z + j] = mean[i, 0], mean[i, 1], mean[i, 2]
            total[0, j], total[1, j], total[2, j] = base[i, 0], base[i, 1], base[i, 2]
        if rest.shape[1]:
            _basis(block, position)
        for n in range(rest.shape[1]):
            term, c = n // 3, n % 3
            for j in range(count):
                coefficient[j] = rest[rows[start + j], n]
            for j in range(_BLOCK):
                total[c, j] += block[_BASIS + _BLOCK * term + j] * coefficient[j]
        for j in range(count):
            for c in range(3):
                colour[rows[start + j], c] = max(total[c, j], _ZERO)


@inlined
def _exp2(t):
    """2^t for t in -126..127, from the exponent's bits and a polynomial of the fraction."""
    whole = np.floor(t)
    f = t - whole
    c0, c1, c2, c3, c4 = _EXP2
    return np.int32((np.int32(whole) + np.int32(127)) << 23).view(np.float32) * (c0 + f * (c1 + f * (c2 + f * (c3 + f * c4))))


@inlined
def _composite(rows, y, u, l1, room, top, red, green, blue, depth):
    """Blends one splat into row `y`. `u` is its value at the first pixel and `l1` its step; `room` is the part of the falloff
    limit that remains in the row."""
    for x in range(TILE):
        before = rows[y, _T + x]
        at = u + F(x) * l1
        square = at * at
        alpha = min(_exp2(max(top - square, F(-16))), _ALPHA_MAX)
        share = before * alpha if (square <= room) & (before >= _T_STOP) else _ZERO
        rows[y, _T + x] = before - share
        rows[y, _RED + x] += share * red
        rows[y, _GREEN + x] += share * green
        rows[y, _BLUE + x] += share * blue
        rows[y, _FAR + x] += share * depth


@kernel
def _stopped(rows):
    """Whether every pixel of the tile has stopped."""
    for y in range(TILE):
        most = _ZERO
        for x in range(TILE):
            most = max(most, rows[y, _T + x])
        if most >= _T_STOP:
            return False
    return True


@kernel
def _set_up(order, begin, count, left, top, mean2d, conic, log2_opacity, limits, colour, depth, pairs):
    """Sets up the intersections from `begin` on, one per row of `pairs`. Here no load waits for another, as loads would between
    loops over pixels."""
    for j in range(count):
        i = order[begin + j]
        dx, dy, limit = left - mean2d[i, 0], top - mean2d[i, 1], limits[i]
        rim = np.sqrt(limit) / conic[i, 2]
        pairs[j, 0], pairs[j, 1], pairs[j, 2] = max(np.ceil(-rim - dy), _ZERO), min(np.floor(rim - dy), F(TILE - 1)), dy
        pairs[j, 3], pairs[j, 4], pairs[j, 5] = conic[i, 0] * dx + conic[i, 1] * dy, conic[i, 0], conic[i, 1]
        pairs[j, 6], pairs[j, 7], pairs[j, 8] = conic[i, 2], limit, log2_opacity[i]
        pairs[j, 9], pairs[j, 10], pairs[j, 11], pairs[j, 12] = colour[i, 0], colour[i, 1], colour[i, 2], depth[i]


@kernel
def _tile(order, tile_x, tile_y, mean2d, conic, log2_opacity, limits, colour, depth, pairs, rows):
    rows[:] = _ZERO
    rows[:, _T : _T + TILE] = _ONE
    left, top = F(tile_x * TILE) + _HALF, F(tile_y * TILE) + _HALF
    for n in range(len(order)):
        j = n % _PAIRS
        if j == 0:
            if _stopped(rows):
                break
            _set_up(order, n, min(_PAIRS, len(order) - n), left, top, mean2d, conic, log2_opacity, limits, colour, depth, pairs)
        dy, u_first, l1, l2, l3 = pairs[j, 2], pairs[j, 3], pairs[j, 4], pairs[j, 5], pairs[j, 6]
        limit, opacity = pairs[j, 7], pairs[j, 8]
        red, green, blue, far = pairs[j, 9], pairs[j, 10], pairs[j, 11], pairs[j, 12]
        for y in range(int(pairs[j, 0]), int(pairs[j, 1]) + 1):
            v = l3 * (dy + F(y))
            u, room = u_first + l2 * F(y), limit - v * v
            last = u + F(TILE - 1) * l1
            nearest = u if u >= 0 else (last if last <= 0 else _ZERO)
            if nearest * nearest <= room:
                _composite(rows, y, u, l1, room, opacity - v * v, red, green, blue, far)


@kernel
def _tiles(_slice, begin, end, start, splat, tiles_x, mean2d, conic, log2_opacity, limits, colour, depth, background, out):
    pairs, rows = np.empty((_PAIRS, 13), np.float32), np.empty((TILE, 5 * TILE), np.float32)
    for tile in range(begin, end):
        order = splat[start[tile] : start[tile + 1]]
        _tile(order, tile % tiles_x, tile // tiles_x, mean2d, conic, log2_opacity, limits, colour, depth, pairs, rows)
        for c in range(3):
            out[tile, :, :, c] = rows[:, (c + 1) * TILE : (c + 2) * TILE] + rows[:, _T : _T + TILE] * background[c]
        out[tile, :, :, 3], out[tile, :, :, 4] = rows[:, _FAR : _FAR + TILE], rows[:, _T : _T + TILE]


def render(model: FloatModel, camera: Camera, background: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatFrame:
    """Renders one frame, with the same stages as `golden.msv2_ref.pipeline.render`."""
    seconds, clock, count = {}, time.perf_counter, len(model.mean)
    width, height = camera.width, camera.height
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    tiles = tiles_x * tiles_y

    begin = clock()
    margin = FRUSTUM_MARGIN
    limits = (-margin * camera.cx / camera.fx, margin * (width - camera.cx) / camera.fx,
              -margin * camera.cy / camera.fy, margin * (height - camera.cy) / camera.fy)
    settings = camera.position - model.origin, camera.rotation, (camera.fx, camera.fy), (camera.cx, camera.cy), limits
    view = _View(*(np.asarray(a, F) for a in settings), width, height)
    depth, box = np.empty(count, F), np.empty((count, 4), np.int16)
    mean2d, conic = np.empty((count, 2), F), np.empty((count, 3), F)
    for_slices(_view_depth, count, model.mean, view, depth)
    rows = np.flatnonzero((depth > camera.near) & (model.limit >= 0))
    for_slices(_project, len(rows), rows, model.mean, model.axis, model.quat, model.limit, view, mean2d, conic, box)
    seconds["culling"] = clock() - begin

    begin = clock()
    met = (box[rows, 0] <= box[rows, 1]) & (box[rows, 2] <= box[rows, 3])
    order = rows[met].astype(np.int32)
    order = order[np.argsort(depth[order].view(np.int32), kind="stable")]  # positive floats have the order of their bits
    seconds["sort"] = clock() - begin

    begin = clock()
    reach = box[order].astype(np.int64)
    room = np.concatenate(([0], np.cumsum((reach[:, 1] - reach[:, 0] + 1) * (reach[:, 3] - reach[:, 2] + 1))))
    tile_of, splat_of = np.empty(room[-1], np.int32), np.empty(room[-1], np.int32)
    counts, passed = np.zeros((SLICES, tiles), np.int64), np.zeros(SLICES, np.int64)
    for_slices(_visit, len(order), order, room, mean2d, conic, box, model.limit, view, tiles_x, tile_of, splat_of, counts,
               passed)
    start = np.concatenate(([0], np.cumsum(counts.sum(axis=0))))
    cursor = start[:-1] + np.concatenate((np.zeros((1, tiles), np.int64), np.cumsum(counts, axis=0)[:-1]))
    splat = np.empty(start[-1], np.int32)
    for_slices(_scatter, len(order), room, passed, tile_of, splat_of, cursor, splat)
    seconds["tiles"] = clock() - begin

    begin = clock()
    colour = np.zeros((count, 3), F)
    for_slices(_colours, len(order), order, model.mean, model.base, model.rest, view.position, colour)
    seconds["colour"] = clock() - begin

    begin = clock()
    out = np.empty((tiles, TILE, TILE, 5), F)
    for_slices(_tiles, tiles, start, splat, tiles_x, mean2d, conic, model.log2_opacity, model.limit, colour, depth,
               np.asarray(background, F), out)
    seconds["array"] = clock() - begin

    grid = out.reshape(tiles_y, tiles_x, TILE, TILE, 5).swapaxes(1, 2).reshape(tiles_y * TILE, -1, 5)[: height, : width]
    return FloatFrame(grid[..., :3], grid[..., 3], grid[..., 4], seconds)
