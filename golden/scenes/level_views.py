"""What fitting levels needs of a camera: where the splats lie on its screen, and which of them meet each tile, in depth order.

The geometry of a splat is the same at all levels, so this is computed once for each camera. It is the float arithmetic of 3DGS;
nothing here has to equal the machine's pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.kernels import compiled
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.constants import EXPONENT_SCALE, FRUSTUM_MARGIN, LOW_PASS, SUPPORT_SIGMA, TILE
from spec.harmonics import basis_beyond_dc

GEOMETRY = 5
"""Columns of a splat's geometry: the mean in pixels (0, 1), and the conic factor for exponents of 2 (2-4)."""

REACH = (SUPPORT_SIGMA * EXPONENT_SCALE) ** 2
"""The largest exponent of 2 at which a splat covers a pixel, whatever its opacity."""

_kernel = compiled(nogil=True, error_model="numpy")


@dataclass
class LevelView:
    """One camera's splats and tile lists. M splats may meet the frame; they make E intersections in T tiles.

    Attributes:
        camera: the camera.
        index: (M,) int64 points of the model.
        geometry: (M, GEOMETRY) float32.
        rest: (M, 3) float32, the part of the colour that no level changes: 0.5 and the harmonics beyond DC.
        start: (T + 1,) int64; tile t, row-major, blends splat[start[t] : start[t + 1]] from front to back.
        splat: (E,) int32 rows of `index`.
        target: (height, width, 4) float32, what the full model shows on black: red, green, blue in 0..1 and the transmittance.
    """

    camera: Camera
    index: np.ndarray
    geometry: np.ndarray
    rest: np.ndarray
    start: np.ndarray
    splat: np.ndarray
    target: np.ndarray | None = None

    def keep(self, chosen: np.ndarray) -> None:
        """Drops the points for which `chosen` (N,) bool, one for each point of the model, is False."""
        stays = chosen[self.index]
        renamed = (np.cumsum(stays) - 1).astype(np.int32)
        self.index, self.geometry, self.rest = self.index[stays], self.geometry[stays], self.rest[stays]
        used = stays[self.splat]
        before = np.concatenate([[0], np.cumsum(used)])
        self.start, self.splat = before[self.start], renamed[self.splat[used]]

    def tiles_met(self, count: int) -> np.ndarray:
        """(count,) int64: the number of tiles that each of the model's `count` points meets."""
        met = np.zeros(count, np.int64)
        met[self.index] = np.bincount(self.splat, minlength=len(self.index))
        return met


@dataclass(frozen=True)
class Shapes:
    """A model's points as projections need them: means (N, 3) and principal axes (N, 3, 3), scaled, float64, world units."""

    means: np.ndarray
    axes: np.ndarray

    @classmethod
    def of(cls, model: GaussianModel) -> Shapes:
        norm = np.linalg.norm(model.quats, axis=1, keepdims=True)
        w, x, y, z = (model.quats / np.where(norm > 0, norm, 1)).T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        axes = np.moveaxis(np.array(rows), -1, 0) * np.exp(model.log_scales)[:, None, :]
        return cls(model.means, np.ascontiguousarray(axes))


def look(model: GaussianModel, shapes: Shapes, camera: Camera) -> LevelView:
    """The splats and tile lists of a camera, without its target."""
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
    row, count = np.zeros((len(model), GEOMETRY + 1)), np.zeros(len(model), np.int64)
    _project(shapes.means, shapes.axes, camera.rotation, camera.translation, intrinsics, camera.width, camera.height,
             row, count)
    index = np.flatnonzero(count)
    index = index[np.argsort(row[index, GEOMETRY], kind="stable")]  # by depth, then by number
    geometry = row[index, :GEOMETRY]
    start, splat = _lists(geometry, count[index], camera.width, camera.height)
    rest = np.full((len(index), 3), 0.5)
    if model.sh_rest.shape[1]:
        direction = model.means[index] - camera.position
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        rest += np.einsum("nk,nkc->nc", basis_beyond_dc(direction, model.sh_rest.shape[1]), model.sh_rest[index])
    return LevelView(camera, index, geometry.astype(np.float32), rest.astype(np.float32), start, splat)


@_kernel
def _columns(row, low, high):
    """The range of x in which a splat's ellipse has points with y in low..high; the first is larger if there are none."""
    x, y, f0, f1, f2 = row[0], row[1], row[2], row[3], row[4]
    reach = np.sqrt(REACH)
    top, bottom = max(low - y, -reach / f2), min(high - y, reach / f2)
    if top > bottom:
        return 1.0, 0.0
    tip = -reach * f1 / (f2 * np.sqrt(f0 * f0 + f1 * f1))  # dy of the ellipse's rightmost point; the leftmost is opposite
    right, left = min(max(tip, top), bottom), min(max(-tip, top), bottom)
    most = np.sqrt(max(REACH - (f2 * right) ** 2, 0.0))
    least = np.sqrt(max(REACH - (f2 * left) ** 2, 0.0))
    return x - (f1 * left + least) / f0, x + (most - f1 * right) / f0


@_kernel
def _tiles(row, width, height, out):
    """Writes the numbers of the tiles that a splat meets into `out`, as far as it reaches; returns how many they are."""
    met, tiles_x = 0, (width + TILE - 1) // TILE
    reach = np.sqrt(REACH) / row[4]
    first = int(max(np.floor((row[1] - reach) / TILE), 0.0))
    last = int(min(np.floor((row[1] + reach) / TILE), float((height - 1) // TILE)))
    for tile_y in range(first, last + 1):
        left, right = _columns(row, tile_y * TILE + 0.5, min(tile_y * TILE + TILE, height) - 0.5)
        if left > right or right < 0.5 or left > width - 0.5:
            continue
        begin = int(max(np.ceil((left - TILE + 0.5) / TILE), 0.0))
        end = int(min(np.floor((right - 0.5) / TILE), float(tiles_x - 1)))
        for tile_x in range(begin, end + 1):
            if met < len(out):
                out[met] = tile_y * tiles_x + tile_x
            met += 1
    return met


@_kernel
def _covariance(axes, i, turn, x, y, fx, fy):
    """xx, xy, yy of a point's covariance on the screen in px^2, for x, y in units of its depth; `turn` is R / depth."""
    xx, xy, yy = LOW_PASS, 0.0, LOW_PASS
    for k in range(3):
        a = turn[0, 0] * axes[i, 0, k] + turn[0, 1] * axes[i, 1, k] + turn[0, 2] * axes[i, 2, k]
        b = turn[1, 0] * axes[i, 0, k] + turn[1, 1] * axes[i, 1, k] + turn[1, 2] * axes[i, 2, k]
        c = turn[2, 0] * axes[i, 0, k] + turn[2, 1] * axes[i, 1, k] + turn[2, 2] * axes[i, 2, k]
        u, v = fx * (a - x * c), fy * (b - y * c)
        xx, xy, yy = xx + u * u, xy + u * v, yy + v * v
    return xx, xy, yy


@_kernel
def _project(means, axes, rotation, translation, intrinsics, width, height, row, count):
    """Projects all points: writes geometry and depth into `row`, and the number of tiles that each meets into `count`."""
    fx, fy, cx, cy, near = intrinsics
    none = np.empty(0, np.int32)
    for i in range(len(means)):
        count[i] = 0
        p = rotation @ means[i] + translation
        if not p[2] > near:
            continue
        x, y = p[0] / p[2], p[1] / p[2]
        row[i, 0], row[i, 1], row[i, GEOMETRY] = fx * x + cx, fy * y + cy, p[2]
        x = min(max(x, -FRUSTUM_MARGIN * cx / fx), FRUSTUM_MARGIN * (width - cx) / fx)
        y = min(max(y, -FRUSTUM_MARGIN * cy / fy), FRUSTUM_MARGIN * (height - cy) / fy)
        xx, xy, yy = _covariance(axes, i, rotation / p[2], x, y, fx, fy)
        determinant = xx * yy - xy * xy
        if not (determinant > 0 and np.isfinite(determinant) and np.isfinite(row[i, 0] + row[i, 1])):
            continue
        f0 = np.sqrt(yy / determinant)
        row[i, 2], row[i, 3] = EXPONENT_SCALE * f0, -EXPONENT_SCALE * f0 * xy / yy
        row[i, 4] = EXPONENT_SCALE / np.sqrt(yy)
        count[i] = _tiles(row[i], width, height, none)


@_kernel
def _lists(geometry, count, width, height):
    """The tile lists of splats that are sorted by depth and meet `count` tiles each: `start` and `splat` of a LevelView."""
    tiles = ((width + TILE - 1) // TILE) * ((height + TILE - 1) // TILE)
    end = np.cumsum(count)
    tile_of, splat = np.empty(end[-1] if len(end) else 0, np.int32), np.empty(end[-1] if len(end) else 0, np.int32)
    start = np.zeros(tiles + 1, np.int64)
    for i in range(len(geometry)):
        _tiles(geometry[i], width, height, tile_of[end[i] - count[i] : end[i]])
    for tile in tile_of:
        start[tile + 1] += 1
    start = np.cumsum(start)
    cursor = start[:-1].copy()
    for i in range(len(geometry)):
        for tile in tile_of[end[i] - count[i] : end[i]]:
            splat[cursor[tile]] = i
            cursor[tile] += 1
    return start, splat
