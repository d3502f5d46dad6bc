"""A Gaussian model of the embedded scene, made directly: clusters of traced samples become Gaussians, without training.

Rays through the pixels of the embedded cameras give samples: position, normal, colour and primitive. Clustering them
(k-means whose distance also counts normal, colour and primitive) splits every surface into patches that end where
texture, shape or object end. A patch's moments are its Gaussian: the mean, and a covariance that is flat on walls and a
needle on wires. Its colour is the members' mean; on glossy materials spherical harmonics are fitted to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from golden.oracle.harmonics import basis_beyond_dc
from golden.scenes.camera import Camera
from golden.scenes.embedded import UP, camera_rays, embedded_cameras
from golden.scenes.embedded_world import CENTRE, HALF, embedded_world
from golden.scenes.model import SH_REST_COUNT, GaussianModel
from golden.scenes.raytrace import BALL, DISC, MISS, TUBE, trace
from spec.constants import SH_C0

SKY_RADIUS = 250.0
"""Metres from the camera at which the sky's splats stand: behind the farthest hill."""

SAMPLES_PER_SPLAT = 15
"""Rays traced for each splat: enough for the nine moments of a patch."""

ROUNDS = 5
"""k-means rounds; more move few samples."""

INFLATION = (1.85, 2.5)
"""Standard deviations of a Gaussian over those of its patch, in textured and in even places: patches tile a surface,
Gaussians have to overlap, and blur only where there is something to blur."""

EDGE_SIGMAS = 1.15
"""Standard deviations between a Gaussian's mean and the edge of its primitive, at least: silhouettes stay sharp."""

TUBE_WIDTH = 0.7

FOOTPRINT = 0.006
"""Metres: the renderers' low-pass, 0.55 px, at 2.2 m from a 256x256 camera. Thinner splats get less opacity."""

OPACITY = 0.97
"""Opacity of a splat wider than FOOTPRINT."""

NORMAL_WEIGHT, COLOUR_WEIGHT = 2.0, 30.0
"""Squared distances of the clustering, against 1 for the local spacing: per squared chord between normals, and per
squared colour difference."""

RIDGE = (0.02, 0.1, 0.4)
"""Ridge of the SH fit for degrees 1, 2 and 3, as shares of a patch's samples: higher degrees need more evidence."""


@dataclass(frozen=True)
class _Samples:
    """Samples, one a pixel, camera by camera: (N, 3) position, normal, colour, direction; (N,) primitive, detail."""

    position: np.ndarray
    normal: np.ndarray
    colour: np.ndarray
    direction: np.ndarray
    primitive: np.ndarray
    detail: np.ndarray


def _sample_views(cameras: list[Camera], rng: np.random.Generator) -> _Samples:
    """One jittered ray a pixel. The detail weight is large where the colour or the primitive changes."""
    row, column = (axis.ravel() for axis in np.indices((cameras[0].height, cameras[0].width)))
    world = embedded_world()
    slender = (world.shape == TUBE) & (world.size[:, 0] < 2 * FOOTPRINT)
    parts = []
    for camera in cameras:
        jitter = rng.random((2, len(row)))
        direction = camera_rays(camera, column + jitter[0], row + jitter[1])
        origin = np.broadcast_to(camera.position, direction.shape)
        distance, primitive, normal, colour = trace(world, origin, direction)
        position = origin + np.where(primitive == MISS, SKY_RADIUS, distance)[:, None] * direction
        image = np.concatenate([colour, 0.3 * (primitive % 2)[:, None]], axis=1).reshape(camera.height, camera.width, 4)
        slope = sum(np.abs(np.gradient(image, axis=axis)).sum(axis=2) for axis in (0, 1))
        detail = 1.0 + 6.0 * np.minimum(slope.ravel(), 1.0) + np.where(primitive == MISS, 0.0, 12.0 * slender[primitive])
        parts.append((position, normal, colour, direction, primitive, detail))
    return _Samples(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _contract(position: np.ndarray) -> np.ndarray:
    """The room as it is, everything beyond on a slowly growing sphere: distances then follow the angle seen."""
    offset = position - CENTRE
    radius = np.linalg.norm(offset, axis=1, keepdims=True)
    inner = np.sqrt(3.0) * HALF
    return np.where(radius > inner, inner * (1.0 + 0.25 * np.log(np.maximum(radius, inner) / inner)) / radius, 1.0) * offset


def _sums(label: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, K) sums of `values` (N, K) by `label` (N,)."""
    return np.stack([np.bincount(label, column, count) for column in values.T], axis=1)


def _cluster(samples: _Samples, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N,) int64 label of each sample: k-means over the eight nearest centres of the sample's primitive.

    Labels are in [0, count), or in [0, primitives seen) where that is more: every primitive has a cluster.
    """
    order = rng.exponential(size=len(samples.detail)) / samples.detail  # its smallest values are a weighted draw
    order[np.unique(samples.primitive, return_index=True)[1]] = -1.0
    seeds = np.argsort(order, kind="stable")[: max(count, (order < 0.0).sum())]
    # The primitive is a fourth coordinate, in steps wider than the room: neighbours belong to the same one.
    place = np.column_stack([_contract(samples.position), 100.0 * samples.primitive])
    centre, normal, colour = place[seeds], samples.normal[seeds], samples.colour[seeds]
    for _ in range(ROUNDS):
        tree = cKDTree(centre)
        spacing = tree.query(centre, k=min(5, len(seeds)))[0][:, -1] + 1e-9
        distance, near = tree.query(place, k=min(8, len(seeds)), workers=-1)
        cost = (distance / spacing[near]) ** 2
        cost += NORMAL_WEIGHT * ((samples.normal[:, None] - normal[near]) ** 2).sum(axis=2)
        cost += COLOUR_WEIGHT * ((samples.colour[:, None] - colour[near]) ** 2).sum(axis=2)
        cost[distance > 50.0] = np.inf
        label = near[np.arange(len(near)), cost.argmin(axis=1)]
        members = np.bincount(label, minlength=len(seeds))[:, None]
        kept = np.maximum(members, 1)
        fields = ((centre, place), (normal, samples.normal), (colour, samples.colour))
        centre, normal, colour = (np.where(members, _sums(label, new, len(seeds)) / kept, old) for old, new in fields)
    return np.unique(label, return_inverse=True)[1]


def _edges(samples: _Samples, first: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where patches' primitives end: (N, 3, 3) orthonormal axes as columns, (N, 3) metres from `mean` to the edge.

    The axes are the primitive's own (radial instead of x on discs); inf where a surface closes on itself. The sky has
    no edge.
    """
    world, primitive = embedded_world(), samples.primitive[first]
    axes = np.linalg.inv(world.to_local[primitive, :, :3])
    local = np.einsum("nij,nj->ni", world.to_local[primitive], np.column_stack([mean, np.ones(len(mean))]))
    disc = np.flatnonzero(world.shape[primitive] == DISC)
    radius = np.hypot(local[disc, 0], local[disc, 1])
    turn = np.arctan2(local[disc, 1], local[disc, 0])
    x, y = axes[disc, :, 0].copy(), axes[disc, :, 1].copy()
    axes[disc, :, 0] = x * np.cos(turn)[:, None] + y * np.sin(turn)[:, None]
    axes[disc, :, 1] = y * np.cos(turn)[:, None] - x * np.sin(turn)[:, None]
    room = 1.0 - np.abs(local)
    room[disc, 0] = 1.0 - radius
    room[disc, 1] = np.sqrt(np.maximum(0.0, 1.0 - radius**2))
    tube = world.shape[primitive] == TUBE
    room[tube, 2] = np.minimum(local[tube, 2], 1.0 - local[tube, 2])
    size = np.linalg.norm(axes, axis=1)
    distance = np.maximum(room, 0.0) * size
    distance[tube, :2] = TUBE_WIDTH * size[tube, :2]
    distance[world.shape[primitive] == BALL] = np.inf
    distance[primitive == MISS] = np.inf
    return axes / size[:, None, :], distance


def _covariances(samples: _Samples, label: np.ndarray, mean: np.ndarray, spacing: np.ndarray, even: np.ndarray) -> np.ndarray:
    """(N, 3, 3) covariances: the patches' own, widened to overlap, kept off the edges of their primitives."""
    count = len(mean)
    offset = samples.position - mean[label]
    moments = _sums(label, (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9), count).reshape(-1, 3, 3)
    first = np.unique(label, return_index=True)[1]
    normal = samples.normal[first]
    # One more member of the local width, flat on the surface, stands in where a patch has few.
    moments += (np.eye(3) - normal[:, :, None] * normal[:, None, :]) * (spacing**2 / 12.0)[:, None, None]
    covariance = moments / (np.bincount(label) + 1.0)[:, None, None]
    gain = INFLATION[0] + (INFLATION[1] - INFLATION[0]) * even
    covariance *= (gain**2)[:, None, None]
    axes, distance = _edges(samples, first, mean)
    width = np.sqrt(np.maximum(np.einsum("nik,nij,njk->nk", axes, covariance, axes), 1e-12))
    shrink = np.einsum("nik,nk,njk->nij", axes, np.minimum(1.0, distance / EDGE_SIGMAS / width), axes)
    return shrink @ covariance @ shrink


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz unit quaternions of proper rotations (N, 3, 3)."""
    return Rotation.from_matrix(rotation).as_quat()[:, [3, 0, 1, 2]]


def _fit_harmonics(samples: _Samples, label: np.ndarray, base: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Colour at each patch by ridge regression on its members: (N, 3) constant term, (N, K, 3) harmonics.

    Only patches of materials that look different from different sides have harmonics; elsewhere the texture within a
    patch would pass for a dependence on the view.
    """
    world, terms = embedded_world(), SH_REST_COUNT[degree]
    rest = np.zeros((len(base), terms, 3))
    first = np.unique(label, return_index=True)[1]
    material = world.material[samples.primitive]
    glossy = ((world.mirror[material] > 0) | (world.shine[material] > 0)) & (samples.primitive != MISS)
    if terms == 0 or not glossy.any():
        return base, rest
    which, member = np.unique(label[glossy & glossy[first][label]], return_inverse=True)
    mine = glossy & glossy[first][label]
    basis = np.column_stack([np.ones(mine.sum()), basis_beyond_dc(samples.direction[mine], terms)])
    size = terms + 1
    normal = _sums(member, (basis[:, :, None] * basis[:, None, :]).reshape(-1, size * size), len(which))
    residual = samples.colour[mine] - base[label[mine]]
    right = _sums(member, (basis[:, :, None] * residual[:, None, :]).reshape(-1, size * 3), len(which))
    degrees = np.array([0] + [d for d in (1, 2, 3) for _ in range(2 * d + 1)])[:size]
    ridge = np.append(1e-6, RIDGE)[degrees] * np.bincount(member)[:, None]
    solved = np.linalg.solve(
        normal.reshape(-1, size, size) + ridge[:, :, None] * np.eye(size), right.reshape(-1, size, 3)
    )
    fitted = base.copy()
    fitted[which] += solved[:, 0]
    rest[which] = solved[:, 1:]
    return fitted, rest


def embedded_model(count: int = 20000, seed: int = 0, sh_degree: int = 3) -> GaussianModel:
    """A Gaussian model of the embedded scene, made from traced samples without training.

    Args:
        count: number of Gaussians wanted; a few less where patches end up without a sample, and never less than one
            for each primitive that a camera sees.
        seed: of the samples; the same seed gives the same model, bit for bit.
        sh_degree: 0..3.

    Returns:
        A model of one level, in metres, z up. Colours beyond degree 0 are non-zero on glossy objects only.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count!r}")
    if sh_degree not in SH_REST_COUNT:
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, not {sh_degree!r}")
    rng = np.random.default_rng(seed)
    views = len(embedded_cameras())
    side = max(32, round(np.sqrt(SAMPLES_PER_SPLAT * count / views)))
    cameras = embedded_cameras(side, side)
    samples = _sample_views(cameras, rng)
    label = _cluster(samples, count, rng)
    members = np.bincount(label)[:, None]
    mean, base = (_sums(label, field, len(members)) / members for field in (samples.position, samples.colour))
    place = _contract(mean)
    distance, near = cKDTree(place).query(place, k=6)
    growth = np.linalg.norm(mean - CENTRE, axis=1) / np.linalg.norm(place, axis=1)
    contrast = np.abs(base[near[:, 1:]] - base[:, None]).sum(axis=2).mean(axis=1)
    covariance = _covariances(samples, label, mean, distance[:, 2] * growth, np.exp(-((contrast / 0.12) ** 2)))
    variance, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0] *= -1.0
    deviation = np.sqrt(np.maximum(variance, 0.0)) + 1e-4 * growth[:, None]
    thin = np.minimum(1.0, 1.5 * deviation[:, 1] / np.hypot(deviation[:, 1], FOOTPRINT * growth))
    constant, rest = _fit_harmonics(samples, label, base, sh_degree)
    return GaussianModel(
        mean, np.log(deviation), _quaternions(axes), (OPACITY * thin)[:, None], ((constant - 0.5) / SH_C0)[:, None], rest,
        np.ones(len(mean), np.uint8), UP.copy(), "embedded",
    )
