"""The oracle against a renderer without tiles: every pixel meets every splat, in global depth order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from golden.oracle.render import render
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display
from golden.scenes.model import GaussianModel

STARTS, BANDS = (0, 18, 27, 33), (14, 23.5, 30)  # degrees, from the paper


def random_model(rng: np.random.Generator, n: int, levels: int = 1, sh: int = 0) -> GaussianModel:
    """Splats of many shapes in front of, beside and behind a camera at the origin; equal depths among them."""
    means = rng.uniform((-4, -3, -1), (4, 3, 8), (n, 3))
    means[: n // 4, 2] = np.round(means[: n // 4, 2])
    return GaussianModel(
        means=means,
        log_scales=rng.normal(-1.5, 0.9, (n, 3)),
        quats=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0, 1, (n, levels)) ** 2 * np.geomspace(1, 8, levels),
        sh_dc=rng.normal(0, 1.5, (n, levels, 3)),
        sh_rest=rng.normal(0, 0.4, (n, (sh + 1) ** 2 - 1, 3)),
        quality_bound=rng.integers(1, levels + 1, n).astype(np.uint8),
    )


def camera(width: int, height: int) -> Camera:
    """A turned camera with unequal focal lengths and its principal point off the centre."""
    turn = np.deg2rad(12)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    return Camera(rotation, np.array([0.3, -0.2, 1.0]), 0.8 * width, 0.9 * width, 0.55 * width, 0.4 * height, width, height)


def eccentricities(width: int, height: int, gaze: tuple[float, float], fov_deg: float) -> np.ndarray:
    """(height, width) degrees, from the angle between two vectors."""
    distance = width / 2 / np.tan(np.deg2rad(fov_deg / 2))
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    g = np.array([gaze[0] - width / 2, gaze[1] - height / 2, distance])
    cosine = (x * g[0] + y * g[1] + distance * g[2]) / np.sqrt((x**2 + y**2 + distance**2) * (g @ g))
    return np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))


def pixel_levels(width: int, height: int, gaze: tuple[float, float], fov_deg: float, levels: int) -> tuple:
    """Per pixel: its tile's level and the weight of the next one."""
    eccentricity = eccentricities(width, height, gaze, fov_deg)
    level, weight = np.zeros((height, width), int), np.zeros((height, width))
    for y, x in itertools.product(range(0, height, 16), range(0, width, 16)):
        here = (slice(y, y + 16), slice(x, x + 16))
        level[here] = current = sum(eccentricity[here].min() >= start for start in STARTS[1:levels])
        if current < levels - 1:
            t = (eccentricity[here] - BANDS[current]) / (STARTS[current + 1] - BANDS[current])
            t = np.clip(t, 0, 1)
            weight[here] = 3 * t**2 - 2 * t**3
    return level, weight


def brute_force(model, view, level, weight, support_sigma=3.0, background=(0, 0, 0)):
    """Image, depth and transmittance, by whole-image operations, one splat after another."""
    sums = []
    for step in (0, 1):  # the tile's level, then the next
        sums.append(brute_force_level(model, view, np.minimum(level + step, model.levels - 1), support_sigma))
    (colour, depth, t), (colour_2, depth_2, t_2) = sums
    image = (1 - weight)[..., None] * (colour + t[..., None] * np.array(background))
    image += weight[..., None] * (colour_2 + t_2[..., None] * np.array(background))
    depth = (1 - weight) * depth + weight * depth_2
    t = (1 - weight) * t + weight * t_2
    return image, np.where(1 - t < 0.5, np.nan, depth / np.maximum(1 - t, 1e-300)), t


def brute_force_level(model, view, level, support_sigma):
    """Colour sum, depth sum and transmittance of the level `level` (height, width) says for each pixel."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    colour, depth, t = np.zeros((*x.shape, 3)), np.zeros(x.shape), np.ones(x.shape)
    points = model.means @ view.rotation.T + view.translation
    for i in sorted(range(len(model)), key=lambda i: (points[i, 2], i)):
        if points[i, 2] <= view.near:
            continue
        mean, inverse = splat_of(model, view, points[i], i)
        d = np.stack([x - mean[0], y - mean[1]], axis=-1)
        squared_radius = np.einsum("hwi,ij,hwj->hw", d, inverse, d)
        alpha = model.opacity[i, level] * np.exp(-squared_radius / 2)
        alpha = np.minimum(alpha, np.where(level == 0, 0.99, 1.0))
        shown = (alpha >= 1 / 255) & (level < model.quality_bound[i]) & (t >= 1e-4)
        if support_sigma is not None:
            shown &= squared_radius <= support_sigma**2
        share = np.where(shown, alpha * t, 0.0)
        colour += share[..., None] * colours_of(model, view, i)[level]
        depth += share * points[i, 2]
        t = np.where(shown, t * (1 - alpha), t)
    return colour, depth, t


def splat_of(model, view, point, i):
    """Mean and inverse covariance on the screen."""
    w, x, y, z = model.quats[i] / np.linalg.norm(model.quats[i])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + 2 * w * cross + 2 * cross @ cross  # Rodrigues
    sigma = rotation @ np.diag(np.exp(2 * model.log_scales[i])) @ rotation.T
    tx = np.clip(point[0] / point[2], -1.3 * view.cx / view.fx, 1.3 * (view.width - view.cx) / view.fx)
    ty = np.clip(point[1] / point[2], -1.3 * view.cy / view.fy, 1.3 * (view.height - view.cy) / view.fy)
    jacobian = np.array([[view.fx, 0, -view.fx * tx], [0, view.fy, -view.fy * ty]]) / point[2]
    projection = jacobian @ view.rotation
    mean = (view.fx * point[0] / point[2] + view.cx, view.fy * point[1] / point[2] + view.cy)
    return mean, np.linalg.inv(projection @ sigma @ projection.T + 0.3 * np.eye(2))


def colours_of(model, view, i):
    """(levels, 3) colours, with the constants as 3DGS prints them."""
    d = model.means[i] + view.rotation.T @ view.translation
    x, y, z = d / np.linalg.norm(d)
    basis = [
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]
    rest = sum((b * c for b, c in zip(basis, model.sh_rest[i], strict=False)), np.zeros(3))
    return np.maximum(0.28209479177387814 * model.sh_dc[i] + rest + 0.5, 0)


def assert_same(frame, expected) -> None:
    """Image, depth and transmittance agree to 1e-9, and there is something to see."""
    image, depth, t = expected
    assert frame.coverage.mean() > 0.3
    np.testing.assert_allclose(frame.image, image, rtol=0, atol=1e-9)
    np.testing.assert_allclose(frame.transmittance, t, rtol=0, atol=1e-9)
    assert np.array_equal(np.isnan(frame.depth), np.isnan(depth))
    np.testing.assert_allclose(frame.depth, depth, rtol=0, atol=1e-9)


@pytest.mark.parametrize("tile_test", ["exact", "obb"])
@pytest.mark.parametrize("support_sigma", [3.0, None])
@pytest.mark.parametrize("size", [(53, 37), (16, 16), (1, 1), (70, 5)])
def test_one_level(size, support_sigma, tile_test):
    rng = np.random.default_rng(size[0])
    model, view = random_model(rng, 120, sh=3), camera(*size)
    expected = brute_force(
        model, view, np.zeros(size[::-1], int), np.zeros(size[::-1]), support_sigma, background=(0.2, 0.5, 0.9)
    )
    frame = render(model, view, support_sigma=support_sigma, tile_test=tile_test, background=(0.2, 0.5, 0.9))
    assert_same(frame, expected)
    assert frame.visible + sum(frame.culled.values()) == len(model)


@pytest.mark.parametrize(("levels", "fov_deg"), [(4, 90.0), (4, 150.0), (3, 70.0), (2, 90.0)])
@pytest.mark.parametrize("gaze_fraction", [(0.5, 0.5), (0.1, 0.9), (1.0, 0.0)])
def test_levels_and_blend_bands(levels, fov_deg, gaze_fraction):
    size = (77, 51)
    gaze = (gaze_fraction[0] * size[0], gaze_fraction[1] * size[1])
    model, view = random_model(np.random.default_rng(7), 150, levels, sh=1), camera(*size)
    level, weight = pixel_levels(*size, gaze, fov_deg, levels)
    frame = render(model, view, display=Display(*size, fov_deg), gaze=gaze, background=(1, 0, 0.5))
    assert frame.foveation.blend.any() and (weight > 0).any()
    assert_same(frame, brute_force(model, view, level, weight, background=(1, 0, 0.5)))


def test_plane_weights_are_the_only_difference():
    size, gaze = (77, 51), (30.0, 20.0)
    model, view = random_model(np.random.default_rng(8), 150, 4), camera(*size)
    level, _ = pixel_levels(*size, gaze, 90.0, 4)
    frame = render(model, view, gaze=gaze, weights="plane")
    assert_same(frame, brute_force(model, view, level, frame.foveation.blend_weights_plane))
    assert not np.allclose(frame.image, render(model, view, gaze=gaze).image)
