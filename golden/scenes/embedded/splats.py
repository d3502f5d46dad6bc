"""A Gaussian model of the embedded scene, made directly from the patches of its surfaces, without training.

A patch's mean and covariance become its Gaussian, which is flat on walls and needle-shaped on wires. Its colour is the mean of
its samples. On glossy materials, spherical harmonics are fitted to the colours that rays from many cameras see. Values are
rounded on the way (`portable`), so that a model is the same on every CPU, bit for bit.
"""

from __future__ import annotations

import os
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from golden.scenes.embedded.patches import Samples, cluster, contract, label_sums, sample_views
from golden.scenes.embedded.portable import on_grid, on_relative_grid, symmetric_eigen
from golden.scenes.embedded.raytrace import BALL, DISC, MISS, TUBE, trace
from golden.scenes.embedded.views import UP, embedded_cameras
from golden.scenes.embedded.world import CENTRE, embedded_world
from golden.scenes.model import SH_REST_COUNT, GaussianModel
from spec.constants import SH_C0
from spec.harmonics import basis_beyond_dc
from spec.paths import cache_folder
from spec.sources import fingerprint, sources_of

SAMPLE_VIEWS = 48
"""Number of cameras that samples are taken from: twice the default number, so that other cameras on the ring find no gaps."""

SAMPLE_ZOOM = 0.85
"""Focal length of those cameras relative to the default ones: they see a margin around every frame."""

SAMPLES_PER_SPLAT = 15
"""Rays traced for each splat: enough to estimate the nine moments (mean and covariance) of a patch."""

INFLATION = (1.7, 2.4)
"""Standard deviations of a Gaussian relative to those of its patch, in textured and in even places. Patches tile a surface,
but Gaussians have to overlap; in textured places they overlap less, because overlap blurs."""

EVEN_CONTRAST = 0.12
"""Sum of the colour differences to the neighbouring patches at which a place stops counting as even."""

EDGE_SIGMAS = 1.4
"""Smallest distance between a Gaussian's mean and the edge of its primitive, in standard deviations: it keeps silhouettes
sharp."""

TUBE_WIDTH = 0.6
"""Largest width of a Gaussian across a tube: EDGE_SIGMAS of its standard deviations may be this many radii of the tube."""

THINNEST = 1e-4
"""Smallest standard deviation in metres inside the room: a flat patch has it along its normal."""

FOOTPRINT = 0.006
"""Size in metres of the renderers' low-pass filter, 0.55 px, at a distance of 2.2 m from a 256x256 camera. Thinner splats
get less opacity."""

OPACITY = 0.99
"""Opacity of a splat wider than FOOTPRINT."""

GLOSS_VIEWS = 120
"""Number of cameras that look at the glossy patches; the spherical harmonics are fitted to the colours that they see."""

NEARBY = 0.06
"""Largest distance in metres between a patch's mean and the point where a ray towards it meets its primitive."""

RIDGE = (0.02, 0.0005, 0.001, 0.002)
"""Ridge parameter of the SH fit for degrees 0 to 3, as shares of GLOSS_VIEWS. Higher degrees need more evidence; degree 0
falls back on the mean of the samples."""

SAMPLE_BITS, COVARIANCE_BITS, FIELD_BITS, QUATERNION_BITS = 24, 26, 16, 30
"""Fraction bits to which samples (metres, colours), covariances (relative to their largest entry) and the model's fields are
rounded. A sample's 60 nm and a covariance's 2^-26 stay far below THINNEST, a field's 2^-16 far below what a pixel shows;
quaternions keep more, so that their length is 1."""

CACHE = cache_folder("scenes")
"""Folder in which `cached_embedded_model` keeps its files."""


def _edges(samples: Samples, first: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where patches' primitives end: (N, 3, 3) orthonormal axes as columns, and (N, 3) metres from `mean` to the edge along
    them.

    The axes are the primitive's own; on discs the first axis is radial. The distance is inf where a surface closes on itself,
    and for the sky, which has no edge.
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
    distance[tube, :2] = TUBE_WIDTH * size[tube, :2] * np.maximum(1.0, world.param[primitive[tube], :1])
    distance[world.shape[primitive] == BALL] = np.inf
    distance[primitive == MISS] = np.inf
    return axes / size[:, None, :], distance


def _covariances(samples: Samples, label: np.ndarray, mean: np.ndarray, spacing: np.ndarray, even: np.ndarray) -> np.ndarray:
    """(N, 3, 3) covariances: those of the patches, widened so that they overlap, and kept off the edges of their primitives."""
    count = len(mean)
    offset = samples.position - mean[label]
    moments = label_sums(label, (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9), count).reshape(-1, 3, 3)
    first = np.unique(label, return_index=True)[1]
    normal = samples.normal[first]
    # One more member, flat on the surface and as wide as the local spacing, helps patches that have few samples.
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


def _fit_harmonics(primitive: np.ndarray, mean: np.ndarray, base: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours from ridge regression on what GLOSS_VIEWS cameras see: (N, 3) constant terms and (N, K, 3) harmonics.

    A ray from each camera to each patch of a glossy material is a sample if the patch's primitive is the first thing it meets.
    Patches of other materials look alike from everywhere, so their constant is `base` and their harmonics are 0.
    """
    world, terms = embedded_world(), SH_REST_COUNT[degree]
    material = world.material[primitive]
    glossy = np.flatnonzero(((world.mirror[material] > 0) | (world.shine[material] > 0)) & (primitive != MISS))
    constant, rest = base.copy(), np.zeros((len(base), terms, 3))
    eyes = np.array([camera.position for camera in embedded_cameras(views=GLOSS_VIEWS)])
    toward = mean[glossy, None] - eyes
    direction = (toward / np.linalg.norm(toward, axis=2, keepdims=True)).reshape(-1, 3)
    distance, hit, _, colour = trace(world, np.tile(eyes, (len(glossy), 1)), direction)
    # The mean of a curved patch lies inside the surface: the ray meets the patch itself or, from behind, the far side first.
    near = np.abs(distance - np.linalg.norm(toward, axis=2).ravel()) < NEARBY
    seen = near & (hit == np.repeat(primitive[glossy], len(eyes)))
    basis = np.column_stack([np.ones(len(direction)), basis_beyond_dc(direction, terms)]) * seen[:, None]
    basis = basis.reshape(len(glossy), len(eyes), terms + 1)
    residual = colour.reshape(len(glossy), len(eyes), 3) - base[glossy, None]
    ridge = np.repeat(RIDGE, (1, 3, 5, 7))[: terms + 1] * len(eyes)
    transposed = basis.transpose(0, 2, 1)
    solved = np.linalg.solve(transposed @ basis + np.diag(ridge), transposed @ residual)
    constant[glossy] += solved[:, 0]
    rest[glossy] = solved[:, 1:]
    return constant, rest


def embedded_model(count: int = 20000, seed: int = 0, sh_degree: int = 3) -> GaussianModel:
    """A Gaussian model of the embedded scene, made from traced samples without training.

    Args:
        count: number of Gaussians wanted. The model has a few less where patches end up without a sample, and never less than
            one for each primitive that a camera sees.
        seed: seed of the samples; the same seed gives the same model, bit for bit.
        sh_degree: 0..3.

    Returns:
        A model of one level, in metres, z up. SH coefficients beyond degree 0 are non-zero on glossy objects only.

    Raises:
        ValueError: `count` is below 1, or `sh_degree` is not 0..3.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count!r}")
    if sh_degree not in SH_REST_COUNT:
        raise ValueError(f"sh_degree must be 0, 1, 2 or 3, not {sh_degree!r}")
    rng = np.random.default_rng(seed)
    side = max(32, round(np.sqrt(SAMPLES_PER_SPLAT * count / SAMPLE_VIEWS)))
    cameras = [replace(c, fx=c.fx * SAMPLE_ZOOM, fy=c.fy * SAMPLE_ZOOM) for c in embedded_cameras(side, side, SAMPLE_VIEWS)]
    samples = sample_views(cameras, rng)
    samples = replace(samples, **{name: on_grid(getattr(samples, name), SAMPLE_BITS)
                                  for name in ("position", "normal", "colour", "detail")})
    label = cluster(samples, count, rng)
    members = np.bincount(label)[:, None]
    mean, base = (label_sums(label, field, len(members)) / members for field in (samples.position, samples.colour))
    first = np.unique(label, return_index=True)[1]
    place = contract(mean)
    distance, near = cKDTree(place).query(place, k=6)
    growth = np.linalg.norm(mean - CENTRE, axis=1) / np.linalg.norm(place, axis=1)
    contrast = np.abs(base[near[:, 1:]] - base[:, None]).sum(axis=2).mean(axis=1)
    covariance = _covariances(samples, label, mean, distance[:, 2] * growth, np.exp(-((contrast / EVEN_CONTRAST) ** 2)))
    variance, axes = symmetric_eigen(on_relative_grid(covariance, COVARIANCE_BITS))
    deviation = np.sqrt(np.maximum(variance, 0.0)) + THINNEST * growth[:, None]
    thin = np.minimum(1.0, 1.5 * deviation[:, 1] / np.hypot(deviation[:, 1], FOOTPRINT * growth))
    constant, rest = _fit_harmonics(samples.primitive[first], mean, base, sh_degree)
    mean, log_scales, opacity, colour, rest = (
        on_grid(values, FIELD_BITS) for values in (mean, np.log(deviation), OPACITY * thin, (constant - 0.5) / SH_C0, rest))
    return GaussianModel(
        mean, log_scales, on_grid(_quaternions(axes), QUATERNION_BITS), opacity[:, None], colour[:, None], rest,
        np.ones(len(mean), np.uint8), UP.copy(), "embedded")


def _source_hash() -> str:
    """A hash of all code that the model depends on."""
    return fingerprint(sources_of("golden.scenes.embedded.splats"))


def cached_embedded_model(count: int = 20000, seed: int = 0, sh_degree: int = 3, folder: Path = CACHE) -> GaussianModel:
    """As `embedded_model`, but keeps the model in `folder`, one `.npz` for each set of arguments and state of the source code.

    A file that cannot be read is made anew.
    """
    path = folder / f"embedded-{count}-{seed}-{sh_degree}-{_source_hash()}.npz"
    arrays = [field.name for field in fields(GaussianModel) if field.name not in ("name", "dropped")]
    try:
        with np.load(path) as stored:
            return GaussianModel(**{name: stored[name] for name in arrays}, name="embedded")
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        model = embedded_model(count, seed, sh_degree)
    folder.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}.tmp.npz")
    np.savez(temporary, **{name: getattr(model, name) for name in arrays})
    temporary.replace(path)
    return model
