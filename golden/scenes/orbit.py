"""Cameras for models that came without any: an orbit that frames what was captured, and an estimate of which way is up.

A captured scene has no sky box. It has floaters, a far background that looks right only from inside, and often trees in front
of the orbiting camera. So nothing here relies on extreme values: positions are summarised by opacity-weighted percentiles, and
the orbit's radius is chosen by how its images would look according to a coarse estimate (`_optical_depth`), not by a bounding
box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.scenes.subject import weighted_percentiles

FOV_DEG = 60.0
"""Default horizontal field of view in degrees."""
ELEVATION_DEG = 20.0
"""Default angle, in degrees, of the camera above the horizontal plane through the point that it looks at."""
RADIUS_STEPS = tuple(0.2 * 1.35**i for i in range(8, -1, -1))
"""Radii that are tried, as multiples of the core's half diagonal: from well outside it (2.2) to inside it (0.2)."""
PROBES = 8
"""Number of cameras judged for each radius, evenly spaced on the orbit."""
MIN_COVERAGE = 0.65
"""Estimated mean coverage that a radius must keep. The true coverage has to be at least 0.5, and the estimate was up to 0.12
too high on captures."""
MAX_OBSTRUCTION = 0.15
"""Largest estimated share of the images that may be hidden by splats nearer than NEAR_SHARE of the distance to the focus. On
captures of an object the estimate is up to 0.10 at a good radius (the object's own near side); in a garden it passes 0.2
once trees stand in front of the camera."""
NEAR_SHARE = 0.6
SAMPLE = 30_000
"""Number of splats used for the estimates. Larger models are thinned evenly, and each remaining splat counts for several."""
GRID = (32, 64)
"""Rows and columns of the finest grid on which coverage is estimated."""
GRID_LEVELS = 6
"""Number of grids in the pyramid; each has half the rows and columns of the one before, and the coarsest is 1 x 2."""


@dataclass(frozen=True)
class Orbit:
    """A circle of cameras around a model.

    Attributes:
        focus: (3,) the point that the cameras look at, world units.
        up: (3,) unit vector.
        radius: distance from focus to camera, world units.
        elevation_deg: angle of the cameras above the horizontal plane through the focus.
        start_deg: azimuth of the first camera.
        coverage: estimated mean coverage of the probed cameras' images, 0..1.
    """

    focus: np.ndarray
    up: np.ndarray
    radius: float
    elevation_deg: float
    start_deg: float
    coverage: float

    def camera(self, index: int, count: int, width: int, height: int, fov_deg: float = FOV_DEG) -> Camera:
        """Camera `index` of `count` cameras that are evenly spaced in azimuth."""
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
    """Camera `index` of an orbit of `count` cameras around a model; the same arguments give the same camera.

    Args:
        width, height: frame size in pixels.
        up: (3,) world up; the model's own by default.
        fov_deg: horizontal field of view.
        elevation_deg: angle above the horizontal plane through the focus.
        radius: world units; by default the largest at which the images stay covered and unobstructed (`plan_orbit`).

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
    """Chooses the largest radius at which the images stay covered and unobstructed, or the best radius if there is none.

    The first camera is the probed one with the most coverage and the least obstruction.

    Args:
        aspect: frame height over frame width. The other arguments are those of `orbit_camera`.
    """
    up = _unit(model.up if up is None else np.asarray(up, np.float64))
    discs = _Discs.of(model)
    middle, subject, size = _foci(discs, up)
    best = None
    for candidate in [radius] if radius is not None else [step * size for step in RADIUS_STEPS]:
        focus = subject if candidate > size else middle  # a camera inside the core looks at the open place in its middle
        orbit = Orbit(focus, up, candidate, elevation_deg, 0.0, 0.0)
        seen = np.array([_judge(discs, orbit.camera(i, PROBES, 64, max(1, round(64 * aspect)), fov_deg), candidate)
                         for i in range(PROBES)])
        coverage, obstruction = seen.mean(axis=0)
        merit = min(coverage, MIN_COVERAGE) - max(obstruction, MAX_OBSTRUCTION)
        if best is None or merit > best[0]:
            start = int(np.argmax(seen[:, 0] - 2 * seen[:, 1]))
            best = merit, replace(orbit, start_deg=360.0 * start / PROBES, coverage=float(coverage))
        if merit == MIN_COVERAGE - MAX_OBSTRUCTION:  # both limits are kept, and this is the largest such radius
            break
    return best[1]


def look_at(
    position: np.ndarray, target: np.ndarray, up: np.ndarray, width: int, height: int, fov_deg: float, *,
    near: float = Camera.near, name: str = "camera",
) -> Camera:
    """An upright camera at `position` that looks at `target`, with the principal point in the middle and square pixels.

    Args:
        fov_deg: horizontal field of view.
    """
    forward = _unit(np.asarray(target, np.float64) - position)
    right = _unit(_cross(forward, up))
    rotation = np.stack([right, _cross(forward, right), forward])
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    return Camera(rotation=rotation, translation=-rotation @ position, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
                  width=width, height=height, near=near, name=name)


def estimate_up(model: GaussianModel) -> GaussianModel:
    """Returns the model with `up` set to the axis that is perpendicular to the ground, if the scene has a ground.

    The ground is a thin, dense layer across one axis, and objects stand on one side of it. So a slab of 5 % of the robust
    extent along that axis holds the most opacity, and the extent beyond the slab is larger upwards. The model keeps its `up`
    unless the slab of another axis holds clearly more (1.5 times).
    """
    weights = model.opacity[:, 0]
    share, direction = zip(*(_ground_slab(model.means[:, axis], weights) for axis in range(3)), strict=True)
    own = int(np.argmax(np.abs(model.up)))
    axis = int(np.argmax(share))
    if share[axis] < 1.5 * share[own]:  # an object without ground has no preferred axis
        return model
    return replace(model, up=direction[axis] * np.eye(3)[axis])


def _ground_slab(x: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Share of the weight in the densest slab along one axis, and the sign of the side on which objects stand."""
    low, high = weighted_percentiles(x, weights, (1, 99))
    counts, edges = np.histogram(x, bins=20, range=(low, max(high, low + 1e-12)), weights=weights)
    slab = int(np.argmax(counts))
    centre = (edges[slab] + edges[slab + 1]) / 2
    return counts[slab] / weights.sum(), 1.0 if high - centre > centre - low else -1.0


@dataclass(frozen=True)
class _Discs:
    """A thinned model with only what the estimates need.

    Attributes:
        means: (n, 3), world units.
        opacity: (n,), in 0..1.
        sigma: (n, 2), standard deviations along the two larger axes, world units.
        count: the number of the model's splats that each of these stands for.
    """

    means: np.ndarray
    opacity: np.ndarray
    sigma: np.ndarray
    count: int

    @classmethod
    def of(cls, model: GaussianModel) -> _Discs:
        stride = max(1, len(model) // SAMPLE)
        sigma = np.exp(np.sort(model.log_scales[::stride], axis=1)[:, 1:])
        return cls(model.means[::stride], model.opacity[::stride, 0].clip(0, 1), sigma, stride)


def _foci(discs: _Discs, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The middle of the core, the point to look at from outside, and the core's half diagonal.

    The core lies between the 10th and 90th percentiles along each axis. To find the point to look at, each splat on the core's
    ground area counts by its height, because the subject of a capture stands upright while its surroundings are flat. The
    height is limited, so that lamp posts and tree tops do not dominate.
    """
    axes = np.stack([*_horizontal_axes(up), up])
    local = discs.means @ axes.T
    bounds = np.array([weighted_percentiles(x, discs.opacity, (10, 50, 90)) for x in local.T])
    core = np.all((local >= bounds[:, 0]) & (local <= bounds[:, 2]), axis=1, where=[True, True, False])
    height = np.clip(local[:, 2] - bounds[2, 0], 0, bounds[2, 2] - bounds[2, 0])
    standing = discs.opacity * core * height**2
    middle, subject = bounds[:, 1], bounds[:, 1].copy()
    if standing.sum() > 0:
        subject[:2] = standing @ local[:, :2] / standing.sum()
    size = float(np.linalg.norm(bounds[:, 2] - bounds[:, 0])) / 2
    return middle @ axes, subject @ axes, size or 3 * float(discs.sigma.max()) or 1.0  # a single splat has its own extent


def _judge(discs: _Discs, camera: Camera, distance: float) -> tuple[float, float]:
    """Estimated mean coverage of a camera's image, and the share that is hidden by splats much nearer than `distance`."""
    points = discs.means @ camera.rotation.T + camera.translation
    seen = points[:, 2] > camera.near
    points, sigma = points[seen], discs.sigma[seen] / points[seen, 2:]
    place = points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    place *= [GRID[1] / camera.width, GRID[0] / camera.height]
    sigma *= math.sqrt(camera.fx * camera.fy * GRID[0] * GRID[1] / (camera.width * camera.height))  # cells of the finest grid
    # a disc's opacity integrates to 2 pi sigma_1 sigma_2 seen face on, and to half of that on average over orientations
    mass = discs.opacity[seen] * math.pi * sigma[:, 0] * sigma[:, 1] * discs.count
    near = points[:, 2] < NEAR_SHARE * distance
    hidden = _optical_depth(place[near], sigma[near, 1], mass[near])
    beyond = _optical_depth(place[~near], sigma[~near, 1], mass[~near])
    return float(1 - np.exp(-hidden - beyond).mean()), float(1 - np.exp(-hidden).mean())


def _optical_depth(place: np.ndarray, sigma: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """(rows, columns) of GRID: an estimate of -log of the transmittance, from the discs' positions, sizes and absorption.

    Each disc is spread over one cell of a grid whose cells are about as large as the disc. The grids form a pyramid, and the
    coarser ones are added to the finest.
    """
    level = np.ceil(np.log2(np.clip(2 * sigma, 1, 2 ** (GRID_LEVELS - 1)))).astype(int)
    inside = np.all((place >= 0) & (place < GRID[::-1]), axis=1)
    depth = np.zeros(GRID)
    for k in np.unique(level[inside]):
        here = inside & (level == k)
        column, row = place[here].astype(int).T >> k
        coarse = np.zeros((GRID[0] >> k, GRID[1] >> k))
        np.add.at(coarse, (row, column), mass[here] / 4**k)
        depth += coarse.repeat(2**k, axis=0).repeat(2**k, axis=1)
    return depth


def _horizontal_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with `up`."""
    east = _unit(_cross(np.eye(3)[int(np.argmin(np.abs(up)))], up))
    return east, _cross(up, east)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of two vectors, each (3,). `np.cross` gives the same bits and takes much longer."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
