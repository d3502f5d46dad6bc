"""A coarse picture of a model, for choosing cameras: what a camera sees, without a renderer, in a few milliseconds.

A model is thinned to a few thousand discs. A picture is a grid of cells. The discs are sorted into slices of depth, and each
slice absorbs light in the cells that its discs cover. So a disc's visibility is the transmittance of all slices before its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel

SAMPLE = 5_000
"""Number of splats that stand for the model, chosen evenly in the order of the file."""
GIANTS = 1_000
"""Number of splats with the largest area times opacity that are kept besides: a single one of them may cover a view."""
ROWS, COLUMNS = 32, 64
"""Cells of a picture."""
PYRAMID = 6
"""Number of grids over which discs are spread, by their size: each grid has half the rows and columns of the one before."""
WIDE, BLOCK = 4.0, 4
"""Giants whose standard deviation is more than WIDE cells are projected as 3DGS does and evaluated at the middles of blocks of
BLOCK by BLOCK cells; they may lie outside the frame."""
GUARD = 1.3
"""Half frames from the middle at which the projection's linear approximation is held, as in 3DGS."""
SLICES = 24
"""Number of slices of depth; their limits grow geometrically."""
LARGEST_LOG = 60.0
"""Scales are clipped to exp(-60)..exp(60), so that products of three stay finite."""
NEAREST, FARTHEST = 0.02, 20.0
"""Depths of the first and last limit of the slices, as multiples of the distance to what the camera looks at."""


@dataclass(frozen=True)
class Discs:
    """A thinned model.

    Attributes:
        means: (n, 3) float64, world units.
        opacity: (n,) float64 in 0..1.
        sigma: (n,) float64, largest standard deviation, world units.
        faces: (n, 3, 3) float64; in each row of three an axis of the splat, as long as the product of the standard deviations
            across it, so that `faces @ direction` has the length of the area seen from there over 2 pi.
        count: (n,) float64, the number of the model's splats that each disc stands for.
        covariance: (g, 3, 3) float64, covariances of the first discs, which stand for themselves, world units squared.
    """

    means: np.ndarray
    opacity: np.ndarray
    sigma: np.ndarray
    faces: np.ndarray
    count: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, model: GaussianModel, sample: int = SAMPLE, giants: int = GIANTS) -> Discs:
        """The discs of a model: at most about `giants + 2 * sample` of them."""
        opacity = model.opacity[:, 0].clip(0.0, 1.0)
        scales = np.clip(model.log_scales, -LARGEST_LOG, LARGEST_LOG)
        size = (scales.sum(axis=1) - scales.min(axis=1)) + np.log(opacity + 1e-12)
        large = np.zeros(len(model), bool)
        if len(model) > giants:
            large[np.argpartition(size, -giants)[-giants:]] = True
        small = np.flatnonzero(~large)
        stride = max(1, len(small) // sample)
        kept = np.concatenate([np.flatnonzero(large), small[::stride]])
        count = np.concatenate([np.ones(int(large.sum())), np.full(len(small[::stride]), float(stride))])
        sigma = np.exp(scales[kept])
        across = sigma[:, [1, 2, 0]] * sigma[:, [2, 0, 1]]
        axes = rotations(model.quats[kept]).transpose(0, 2, 1)
        spread = axes[: large.sum()] * sigma[: large.sum(), :, None]
        covariance = np.matmul(spread.transpose(0, 2, 1), spread)
        return cls(model.means[kept], opacity[kept], sigma.max(axis=1), axes * across[:, :, None], count, covariance)

    @property
    def weight(self) -> np.ndarray:
        """(n,) float64: opacity times the number of splats. Detail counts by it, since training puts many splats where the
        photographs show much."""
        return self.opacity * self.count


def rotations(quats: np.ndarray) -> np.ndarray:
    """(N, 3, 3) float64 rotation matrices of (N, 4) quaternions in wxyz order, of any length above 0."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return np.array(rows).transpose(2, 0, 1)


@dataclass(frozen=True)
class Picture:
    """What a camera sees of a thinned model.

    Attributes:
        coverage: mean coverage of the frame, 0..1.
        obstruction: share of the frame that is hidden by splats nearer than the `near` given to `picture_of`.
        framed: (n,) bool, whether a disc's middle is inside the frame, hidden or not.
        visible: (n,) float64 in 0..1, for each disc the transmittance before it; 0 outside the frame.
        spread: share of the frame over which the visible discs' weight is spread, 0..1: 1 if every block of cells shows as
            much, 1/n if one of n blocks shows everything.
    """

    coverage: float
    obstruction: float
    framed: np.ndarray
    visible: np.ndarray
    spread: float


def picture_of(discs: Discs, camera: Camera, distance: float, near: float) -> Picture:
    """The coarse picture of a camera.

    Args:
        discs: the thinned model.
        camera: the camera.
        distance: world units from the camera to what it looks at; it scales the slices of depth.
        near: depth in world units; splats before it obstruct.
    """
    points = discs.means @ camera.rotation.T + camera.translation
    depth = np.maximum(points[:, 2], camera.near)
    x = (points[:, 0] / depth * camera.fx + camera.cx) * (COLUMNS / camera.width)
    y = (points[:, 1] / depth * camera.fy + camera.cy) * (ROWS / camera.height)
    ahead = points[:, 2] > camera.near
    framed = ahead & (x >= 0) & (x < COLUMNS) & (y >= 0) & (y < ROWS)
    scale = math.sqrt(camera.fx * camera.fy * ROWS * COLUMNS / (camera.width * camera.height)) / depth  # cells per world unit
    wide = ahead & (np.arange(len(depth)) < len(discs.covariance)) & (discs.sigma * scale > WIDE)
    limits = np.sort(np.append(distance * np.geomspace(NEAREST, FARTHEST, SLICES - 1), near))  # no slice is on both sides of it
    slice_of = np.searchsorted(limits, depth)
    area = np.zeros(len(depth))
    some = np.flatnonzero(framed)
    away = np.linalg.norm(points[some], axis=1, keepdims=True)
    sight = np.matmul(discs.faces[some], (points[some] @ camera.rotation / away)[:, :, None])[:, :, 0]
    area[some] = np.linalg.norm(sight, axis=1) * scale[some] ** 2
    small = np.flatnonzero(framed & ~wide)
    column, row = x[small].astype(int), y[small].astype(int)
    mass = discs.opacity[small] * discs.count[small] * 2.0 * math.pi * area[small]
    reach = 2.0 * discs.sigma[small] * scale[small] * np.sqrt(discs.count[small])  # one that stands for several covers as much
    level = np.ceil(np.log2(np.clip(reach, 1.0, 2.0 ** (PYRAMID - 1)))).astype(int)
    absorbed = _spread(row, column, slice_of[small], level, mass, len(limits) + 1)
    large = np.flatnonzero(wide)
    absorbed += _blurs(discs, camera, large, points[large], slice_of[large], len(limits) + 1)
    before = np.exp(-np.concatenate([np.zeros((1, ROWS, COLUMNS)), np.cumsum(absorbed, axis=0)]))
    visible = np.zeros(len(discs.means))
    shown = np.flatnonzero(framed)
    visible[shown] = before[slice_of[shown], y[shown].astype(int), x[shown].astype(int)]
    hidden = before[int(np.searchsorted(limits, near)) + 1]
    block = (y[shown] // BLOCK).astype(int) * (COLUMNS // BLOCK) + (x[shown] // BLOCK).astype(int)
    seen = np.bincount(block, (discs.weight * visible)[shown], ROWS * COLUMNS // BLOCK**2)
    spread = seen.sum() ** 2 / max(len(seen) * float(seen @ seen), 1e-300)
    return Picture(float(1 - before[-1].mean()), float(1 - hidden.mean()), framed, visible, float(spread))


def _spread(row: np.ndarray, column: np.ndarray, slice_of: np.ndarray, level: np.ndarray, mass: np.ndarray,
            slices: int) -> np.ndarray:
    """(slices, ROWS, COLUMNS) float64: each disc's mass over one cell of the pyramid's grid that suits its size."""
    total = np.zeros((slices, ROWS, COLUMNS))
    for k in range(PYRAMID):
        here = np.flatnonzero(level == k)
        rows, columns = ROWS >> k, COLUMNS >> k
        if not len(here) or not rows:
            continue
        flat = (slice_of[here] * rows + (row[here] >> k)) * columns + (column[here] >> k)
        grid = np.bincount(flat, mass[here] / 4**k, slices * rows * columns).reshape(slices, rows, columns)
        total += grid.repeat(2**k, axis=1).repeat(2**k, axis=2)
    return total


def _blurs(
    discs: Discs, camera: Camera, large: np.ndarray, points: np.ndarray, slice_of: np.ndarray, slices: int,
) -> np.ndarray:
    """(slices, ROWS, COLUMNS) float64: optical depth of wide splats, projected as 3DGS does, at the middles of blocks.

    Args:
        discs: the thinned model.
        camera: the camera.
        large: (m,) int, which discs these are.
        points: (m, 3) their means in camera axes.
        slice_of: (m,) int, their slices of depth.
        slices: number of slices.
    """
    rows, columns = ROWS // BLOCK, COLUMNS // BLOCK
    total = np.zeros((slices, rows, columns))
    if not len(large):
        return total.repeat(BLOCK, axis=1).repeat(BLOCK, axis=2)
    fx, fy = camera.fx * columns / camera.width, camera.fy * rows / camera.height  # from here on in blocks
    cx, cy = camera.cx * columns / camera.width, camera.cy * rows / camera.height
    depth = points[:, 2]
    slope = points[:, :2] / depth[:, None]
    bound = GUARD * np.array([columns / 2 / fx, rows / 2 / fy])
    held = np.clip(slope, -bound, bound)  # the linear approximation is taken no farther outside the frame
    jacobian = np.zeros((len(large), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = fx / depth, fy / depth
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -held[:, 0] * fx / depth, -held[:, 1] * fy / depth
    turned = np.matmul(jacobian, camera.rotation)
    spread = np.matmul(np.matmul(turned, discs.covariance[large]), turned.transpose(0, 2, 1))
    a, b, c = spread[:, 0, 0] + 0.05, spread[:, 0, 1], spread[:, 1, 1] + 0.05
    across = np.arange(columns) + 0.5 - (slope[:, :1] * fx + cx)
    down = np.arange(rows) + 0.5 - (slope[:, 1:] * fy + cy)
    square = (c[:, None, None] * across[:, None, :] ** 2 - 2 * b[:, None, None] * across[:, None, :] * down[:, :, None]
              + a[:, None, None] * down[:, :, None] ** 2) / np.maximum(a * c - b * b, 1e-300)[:, None, None]
    absorbed = -np.log1p(-0.99 * discs.opacity[large, None, None] * np.exp(-0.5 * square))
    np.add.at(total, slice_of, absorbed)
    return total.repeat(BLOCK, axis=1).repeat(BLOCK, axis=2)
