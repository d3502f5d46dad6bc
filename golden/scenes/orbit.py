"""Cameras for models that came without: an orbit that frames what was captured, and which way is up.

Captures have no sky box but floaters, a far background that only looks right from inside, and trees before the lens. So nothing
here trusts extremes: positions are summarised by opacity-weighted percentiles, and the orbit's radius is chosen by how the
views come out, judged by a coarse estimate of each (`_optical_depth`), not by a bounding box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel

FOV_DEG = 60.0
"""Default horizontal field of view."""
ELEVATION_DEG = 20.0
"""Default height of the camera above the horizon of what it looks at."""
RADIUS_STEPS = tuple(0.35 * 1.25**i for i in range(9))
"""Tried radii, as multiples of the core's half diagonal: from among the things to well outside."""
PROBES = 8
"""Views judged per radius, evenly over the orbit."""
MIN_COVERAGE = 0.65
"""Estimated mean coverage that a radius must keep: 0.5 is promised, the rest is the estimate's error."""
MAX_OBSTRUCTION = 0.10
"""Share of a view that may be hidden by things nearer than NEAR_SHARE of the way to the focus, averaged over the orbit."""
NEAR_SHARE = 0.4
SAMPLE = 60_000
"""Splats used for the estimates; larger models are thinned evenly and each splat counts for several."""
GRID = (32, 64)  # rows and columns of the finest grid of the estimate


@dataclass(frozen=True)
class Orbit:
    """A circle of cameras around a model.

    Attributes:
        focus: (3,) the point looked at, world units.
        up: (3,) unit vector.
        radius: distance from focus to camera, world units.
        elevation_deg: angle of the camera above the focus' horizon.
        start_deg: azimuth of the first view.
        coverage: estimated mean coverage of the probed views, 0..1.
    """

    focus: np.ndarray
    up: np.ndarray
    radius: float
    elevation_deg: float
    start_deg: float
    coverage: float

    def camera(self, index: int, count: int, width: int, height: int, fov_deg: float = FOV_DEG) -> Camera:
        """View `index` of `count`, evenly spaced in azimuth."""
        azimuth = math.radians(self.start_deg + 360.0 * index / count)
        elevation = math.radians(self.elevation_deg)
        east, north = _horizontal_axes(self.up)
        outward = math.cos(elevation) * (math.cos(azimuth) * east + math.sin(azimuth) * north) + math.sin(elevation) * self.up
        return look_at(self.focus + self.radius * outward, self.focus, self.up, width, height, fov_deg,
                       near=min(Camera.near, 0.02 * self.radius), name=f"orbit-{index}-of-{count}")


def orbit_camera(
    model: GaussianModel, index: int, count: int, width: int, height: int, *, up: np.ndarray | None = None,
    fov_deg: float = FOV_DEG, elevation_deg: float = ELEVATION_DEG, radius: float | None = None,
) -> Camera:
    """View `index` of an orbit of `count` around a model; the same arguments give the same camera.

    Args:
        width, height: frame size in pixels.
        up: (3,) world up; the model's own by default.
        fov_deg: horizontal field of view.
        radius: world units; by default the largest whose views stay covered and unobstructed (`plan_orbit`).

    Raises:
        ValueError: count below 1.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count!r}")
    orbit = plan_orbit(model, up=up, fov_deg=fov_deg, elevation_deg=elevation_deg, aspect=height / width, radius=radius)
    return orbit.camera(index, count, width, height, fov_deg)


def plan_orbit(
    model: GaussianModel, *, up: np.ndarray | None = None, fov_deg: float = FOV_DEG, elevation_deg: float = ELEVATION_DEG,
    aspect: float = 9 / 16, radius: float | None = None,
) -> Orbit:
    """The orbit whose radius is the largest that keeps the views covered and unobstructed, or, where none does, the best.

    The first view is the probed one with the most coverage and least obstruction.

    Args:
        aspect: frame height over width; the rest as in `orbit_camera`.
    """
    up = _unit(model.up if up is None else np.asarray(up, np.float64))
    sample, thinning = _thin(model)
    focus, size = _focus(sample, up)
    radii = [radius] if radius is not None else [step * size for step in RADIUS_STEPS]
    best = None
    for candidate in radii:
        orbit = Orbit(focus, up, candidate, elevation_deg, 0.0, 0.0)
        seen = np.array([_judge(sample, thinning, orbit.camera(i, PROBES, 64, max(1, round(64 * aspect)), fov_deg), candidate)
                         for i in range(PROBES)])
        coverage, obstruction = seen.mean(axis=0)
        good = coverage >= MIN_COVERAGE and obstruction <= MAX_OBSTRUCTION
        rank = (good, candidate if good else min(coverage, MIN_COVERAGE) - obstruction)
        if best is None or rank > best[0]:
            start = int(np.argmax(seen[:, 0] - 2 * seen[:, 1]))
            best = rank, replace(orbit, start_deg=360.0 * start / PROBES, coverage=float(coverage))
    return best[1]


def look_at(
    position: np.ndarray, target: np.ndarray, up: np.ndarray, width: int, height: int, fov_deg: float, *,
    near: float = Camera.near, name: str = "camera",
) -> Camera:
    """A camera at `position` that looks at `target`, upright; principal point in the middle, square pixels.

    Args:
        fov_deg: horizontal field of view.
    """
    forward = _unit(np.asarray(target, np.float64) - position)
    right = _unit(np.cross(forward, up))
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    return Camera(rotation=rotation, translation=-rotation @ position, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
                  width=width, height=height, near=near, name=name)


def estimate_up(model: GaussianModel) -> GaussianModel:
    """The model with `up` set to the axis that stands on the ground, if there is ground.

    Ground is a thin, dense layer across one axis, and things stand on one side of it: along that axis a slab of 5 % of the
    robust extent holds the most opacity, and the extent beyond the slab is larger upwards. The model keeps its `up` unless
    another axis' slab holds clearly more.
    """
    weights = model.opacity[:, 0]
    share, direction = zip(*(_ground_slab(model.means[:, axis], weights) for axis in range(3)), strict=True)
    own = int(np.argmax(np.abs(model.up)))
    axis = int(np.argmax(share))
    if share[axis] < 1.5 * share[own]:  # an object without ground has no preferred axis
        return model
    return replace(model, up=direction[axis] * np.eye(3)[axis])


def _ground_slab(x: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Share of the weight in the densest slab along one axis, and the sign of the side on which things stand."""
    low, high = _weighted_percentiles(x, weights, (1, 99))
    counts, edges = np.histogram(x, bins=20, range=(low, max(high, low + 1e-12)), weights=weights)
    slab = int(np.argmax(counts))
    centre = (edges[slab] + edges[slab + 1]) / 2
    return counts[slab] / weights.sum(), 1.0 if high - centre > centre - low else -1.0


def _focus(model: GaussianModel, up: np.ndarray) -> tuple[np.ndarray, float]:
    """The point to look at and the core's half diagonal.

    The core lies between the 10th and 90th percentiles along each axis. Of it, what stands out of the ground counts by its
    height: the subject of a capture stands, its surroundings lie.
    """
    axes = np.stack([*_horizontal_axes(up), up])
    local, weights = model.means @ axes.T, model.opacity[:, 0]
    bounds = np.array([_weighted_percentiles(x, weights, (10, 50, 90)) for x in local.T])
    core = np.all((local >= bounds[:, 0]) & (local <= bounds[:, 2]), axis=1)
    height = np.clip(local[:, 2] - bounds[2, 0], 0, None)
    standing = weights * core * height**2
    focus = bounds[:, 1].copy()
    if standing.sum() > 0:
        focus[:2] = standing @ local[:, :2] / standing.sum()
    size = float(np.linalg.norm(bounds[:, 2] - bounds[:, 0])) / 2
    return focus @ axes, size or 1.0  # a single point has no size


def _judge(model: GaussianModel, thinning: float, camera: Camera, distance: float) -> tuple[float, float]:
    """Estimated mean coverage of a view, and the share that things much nearer than `distance` hide."""
    depth = model.means @ camera.rotation[2] + camera.translation[2]
    near = depth < NEAR_SHARE * distance
    visible = depth > camera.near
    hidden = _optical_depth(model, camera, visible & near, thinning)
    total = hidden + _optical_depth(model, camera, visible & ~near, thinning)
    return float(1 - np.exp(-total).mean()), float(1 - np.exp(-hidden).mean())


def _optical_depth(model: GaussianModel, camera: Camera, which: np.ndarray, thinning: float) -> np.ndarray:
    """(rows, columns) of GRID: roughly -log of the transmittance, from each splat's opacity and projected area.

    A splat is a disc of its two larger axes, spread over one cell of a grid whose cells are about its size: a pyramid of grids,
    the coarser added to the finer.
    """
    points = model.means[which] @ camera.rotation.T + camera.translation
    sigma = np.sort(np.exp(model.log_scales[which]), axis=1)[:, 1:]
    columns, rows = GRID[1], GRID[0]
    u, v = (points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]).T
    u, v = u * columns / camera.width, v * rows / camera.height
    pixel = np.sqrt(camera.fx * camera.fy / (camera.width * camera.height) * columns * rows)
    s = sigma * pixel / points[:, 2:]  # in cells of the finest grid
    # an edge-on disc covers less: a half on average over orientations; opacity integrates to 2 pi sigma^2
    mass = model.opacity[which, 0].clip(0, 0.99) * np.pi * s[:, 0] * s[:, 1] * thinning
    level = np.clip(np.ceil(np.log2(np.maximum(2 * s[:, 1], 1))), 0, 5).astype(int)
    depth = np.zeros(GRID)
    for k in range(6):
        cell = 2**k
        shape = (rows // cell, columns // cell)
        inside = (level == k) & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
        index = (v[inside] // cell).astype(int) * shape[1] + (u[inside] // cell).astype(int)
        coarse = np.bincount(index, mass[inside], shape[0] * shape[1]).reshape(shape) / cell**2
        depth += np.kron(coarse, np.ones((cell, cell)))
    return depth


def _thin(model: GaussianModel) -> tuple[GaussianModel, float]:
    """Every n-th splat, and n."""
    stride = max(1, len(model) // SAMPLE)
    return model.select(np.arange(0, len(model), stride)), float(stride)


def _weighted_percentiles(x: np.ndarray, weights: np.ndarray, percentiles: tuple[float, ...]) -> np.ndarray:
    order = np.argsort(x, kind="stable")
    cumulative = np.cumsum(weights[order])
    index = np.searchsorted(cumulative, np.array(percentiles) / 100 * cumulative[-1])
    return x[order][np.minimum(index, len(x) - 1)]


def _horizontal_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with `up`."""
    east = _unit(np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up))
    return east, np.cross(up, east)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
