"""Samples of the embedded scene's visible surfaces, and their division into patches: one patch becomes one Gaussian.

Rays through the pixels of the cameras give samples. Clustering them by k-means, whose distance also counts normal and
colour, and which never joins two primitives, splits surfaces into patches that end where texture, shape or object end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from golden.scenes.camera import Camera
from golden.scenes.embedded.raytrace import BOX, MISS, TUBE, trace
from golden.scenes.embedded.views import camera_rays
from golden.scenes.embedded.world import CENTRE, HALF, embedded_world

SKY_RADIUS = 250.0
"""Metres from the camera at which the sky's samples stand: behind the farthest hill."""

ROUNDS = 5
"""k-means rounds; more move few samples."""

NORMAL_WEIGHT, COLOUR_WEIGHT = 2.0, 30.0
"""Squared distances of the clustering, against 1 for the local spacing: per squared chord between normals, and per
squared colour difference."""

CHANGE_DETAIL, SLENDER_DETAIL, MIRROR_DETAIL = 6.0, 7.0, 10.0
"""What asks for patches beyond the even share: a full change of colour or object, a wire, a full mirror."""

SLENDER = 0.021
"""Metres: what is thinner than twice this both ways counts as a wire: wires, glazing bars, legs."""


@dataclass(frozen=True)
class Samples:
    """Traced samples, one a pixel, camera by camera.

    Attributes:
        position: (N, 3) float64, metres; the sky at SKY_RADIUS from the camera.
        normal: (N, 3) float64, unit, facing the camera.
        colour: (N, 3) float64 in [0, 1].
        primitive: (N,) int64, MISS for the sky.
        detail: (N,) float64 >= 1, how strongly the sample asks for a patch of its own.
    """

    position: np.ndarray
    normal: np.ndarray
    colour: np.ndarray
    primitive: np.ndarray
    detail: np.ndarray


def sample_views(cameras: list[Camera], rng: np.random.Generator) -> Samples:
    """One jittered ray a pixel. A sample has more detail where the colour or the primitive changes beside it."""
    world = embedded_world()
    slender = np.isin(world.shape, (BOX, TUBE)) & (np.sort(world.size, axis=1)[:, 1] < SLENDER)
    special = SLENDER_DETAIL * slender + MIRROR_DETAIL * world.mirror[world.material]
    height, width = cameras[0].height, cameras[0].width
    row, column = (axis.ravel() for axis in np.indices((height, width)))
    parts = []
    for camera in cameras:
        jitter = rng.random((2, len(row)))
        direction = camera_rays(camera, column + jitter[0], row + jitter[1])
        origin = np.broadcast_to(camera.position, direction.shape)
        distance, primitive, normal, colour = trace(world, origin, direction)
        position = origin + np.where(primitive == MISS, SKY_RADIUS, distance)[:, None] * direction
        change = np.zeros((height, width))
        image, owner = colour.reshape(height, width, 3), primitive.reshape(height, width)
        change[:, 1:] += np.abs(np.diff(image, axis=1)).sum(axis=2) + 0.6 * (np.diff(owner, axis=1) != 0)
        change[1:] += np.abs(np.diff(image, axis=0)).sum(axis=2) + 0.6 * (np.diff(owner, axis=0) != 0)
        detail = 1.0 + CHANGE_DETAIL * np.minimum(change.ravel(), 1.0) + np.where(primitive == MISS, 0.0, special[primitive])
        parts.append((position, normal, colour, primitive, detail))
    return Samples(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def contract(position: np.ndarray) -> np.ndarray:
    """Positions (N, 3) with what lies beyond the room drawn onto a slowly growing sphere: distances follow the angle seen."""
    offset = position - CENTRE
    radius = np.linalg.norm(offset, axis=1, keepdims=True)
    inner = np.sqrt(3.0) * HALF
    return np.where(radius > inner, inner * (1.0 + 0.25 * np.log(np.maximum(radius, inner) / inner)) / radius, 1.0) * offset


def label_sums(label: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, K) float64 sums of `values` (N, K) by `label` (N,) in [0, count)."""
    return np.stack([np.bincount(label, column, count) for column in values.T], axis=1)


def cluster(samples: Samples, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N,) int64 label of each sample: k-means over the eight nearest centres of the sample's primitive.

    Labels are in [0, count), or in [0, primitives seen) where that is more: every primitive has a cluster.
    """
    order = rng.exponential(size=len(samples.detail)) / samples.detail  # its smallest values are a weighted draw
    order[np.unique(samples.primitive, return_index=True)[1]] = -1.0
    seeds = np.argsort(order, kind="stable")[: max(count, (order < 0.0).sum())]
    # The primitive is a fourth coordinate, in steps wider than the room: neighbours belong to the same one.
    place = np.column_stack([contract(samples.position), 100.0 * samples.primitive])
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
        centre, normal, colour = (np.where(members, label_sums(label, new, len(seeds)) / kept, old) for old, new in fields)
    return np.unique(label, return_inverse=True)[1]
