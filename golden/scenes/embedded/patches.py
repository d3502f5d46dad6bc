"""Samples of the embedded scene's visible surfaces, and their division into patches: one patch becomes one Gaussian.

Rays through the pixels of the cameras give the samples. They are clustered by k-means, whose distance also counts the normal
and the colour and which never joins samples of two primitives. So a patch ends where texture, shape or object end.
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
"""Distance in metres from the camera at which the sky's samples are placed: behind the farthest hill."""

ROUNDS = 5
"""Number of k-means rounds; further rounds move few samples."""

NORMAL_WEIGHT, COLOUR_WEIGHT = 2.0, 30.0
"""Weights of the squared chord between normals and of the squared colour difference in the clustering's distance. The squared
distance in units of the local spacing has weight 1."""

CHANGE_DETAIL, SLENDER_DETAIL, MIRROR_DETAIL = 6.0, 7.0, 10.0
"""Added to a sample's detail, which is 1 elsewhere, so that more patches lie there: at a full change of colour or object, on a
wire, and on a full mirror."""

SLENDER = 0.021
"""Metres. A box or tube counts as a wire if two of its half extents are below this; wires, glazing bars and legs do."""


@dataclass(frozen=True)
class Samples:
    """Traced samples, one for each pixel of each camera, in the order of the cameras.

    Attributes:
        position: (N, 3) float64, metres; the sky lies at SKY_RADIUS from the camera.
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
    """Traces one ray through a random place in each pixel. A sample's detail is higher where colour or primitive change
    beside it."""
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
    """Positions (N, 3) in which everything beyond the room is drawn onto a sphere that grows slowly with distance.

    Distances between far points then follow the angle between them as seen from the room.
    """
    offset = position - CENTRE
    radius = np.linalg.norm(offset, axis=1, keepdims=True)
    inner = np.sqrt(3.0) * HALF
    return np.where(radius > inner, inner * (1.0 + 0.25 * np.log(np.maximum(radius, inner) / inner)) / radius, 1.0) * offset


def label_sums(label: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, K) float64 sums of `values` (N, K) by `label` (N,) in [0, count)."""
    return np.stack([np.bincount(label, column, count) for column in values.T], axis=1)


def cluster(samples: Samples, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N,) int64 label of each sample, found by k-means over the eight nearest centres of the sample's primitive.

    Labels lie in [0, count), or in [0, number of primitives seen) if that is more, because every primitive has a cluster.
    """
    order = rng.exponential(size=len(samples.detail)) / samples.detail  # the smallest values are a draw weighted by detail
    order[np.unique(samples.primitive, return_index=True)[1]] = -1.0
    seeds = np.argsort(order, kind="stable")[: max(count, (order < 0.0).sum())]
    # The primitive is a fourth coordinate in steps wider than the room, so the nearest centres belong to the same primitive.
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
