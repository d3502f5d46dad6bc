"""The embedded scene: determinism, geometry against closed forms, agreement between views, and its Gaussian model."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from golden.oracle.render import render
from golden.scenes.camera import Camera
from golden.scenes.embedded import splats
from golden.scenes.embedded.raytrace import MISS, trace
from golden.scenes.embedded.scene import (
    UP,
    cached_embedded_model,
    embedded_cameras,
    embedded_model,
    render_reference,
    surface_points,
)
from golden.scenes.embedded.views import camera_rays, look_at
from golden.scenes.embedded.world import HALF, HEIGHT, MATERIALS, WINDOW, embedded_world

COUNT = 1500
BALL_CENTRE, BALL_RADIUS = np.array([0.19, 0.0, 0.91]), 0.17


@pytest.fixture(scope="module")
def model():
    return embedded_model(COUNT, seed=3)


def shoot(origin, direction):
    """Trace one ray; the direction is normalised here."""
    direction = np.asarray(direction, float)
    results = trace(embedded_world(), np.array([origin], float), (direction / np.linalg.norm(direction))[None])
    return [result[0] for result in results]


def material_of(primitive):
    return list(MATERIALS)[embedded_world().material[primitive]]


def psnr(image, reference):
    return -10 * np.log10(np.mean((np.clip(image, 0, 1) - reference) ** 2))


def test_views_are_posed_as_a_camera_should_be():
    cameras = embedded_cameras(64, 48, 9)
    assert [(camera.width, camera.height) for camera in cameras] == [(64, 48)] * 9
    for camera in cameras:
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
        assert camera.rotation[1] @ UP < -0.7, "image y points down"
        assert np.abs(camera.position[:2]).max() < HALF
        assert 0.2 < camera.position[2] < HEIGHT
        assert camera.rotation[2] @ (np.array([0, 0, 1]) - camera.position) > 0.9, "the table's middle is ahead"


def test_rays_go_through_the_pixels_they_are_named_for():
    camera = embedded_cameras(64, 48)[5]
    x, y = np.array([0.5, 31.2, 63.5]), np.array([0.5, 40.7, 12.5])
    points = (camera.position + 3.0 * camera_rays(camera, x, y)) @ camera.rotation.T + camera.translation
    np.testing.assert_allclose(camera.fx * points[:, 0] / points[:, 2] + camera.cx, x)
    np.testing.assert_allclose(camera.fy * points[:, 1] / points[:, 2] + camera.cy, y)


def test_reference_images_and_points_are_bit_identical():
    camera = embedded_cameras(32, 24)[2]
    for first, second in (
        (render_reference(camera), render_reference(camera)), (surface_points(300, 5), surface_points(300, 5)),
    ):
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one, other)
    assert not np.array_equal(surface_points(300, 5)[0], surface_points(300, 6)[0])


def test_model_is_bit_identical(model):
    again = embedded_model(COUNT, seed=3)
    for field in fields(model):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(model, field.name), err_msg=field.name)


@pytest.mark.parametrize(
    ("origin", "direction", "distance", "material"),
    [
        ((-1.8, -1.9, 1.0), (0, 0, -1), 1.0, "floor"),
        ((-1.8, -1.9, 1.0), (0, 0, 1), HEIGHT - 1.0, "ceiling"),
        ((-1.0, -1.5, 2.2), (-1, 0, 0), HALF - 1.0, "brick"),
        ((1.0, -1.5, 2.2), (1, 0, 0), HALF - 1.0, "stripes"),
        ((-1.0, -1.5, 2.2), (-1, -1, 0), 0.8 * np.sqrt(2), "plaster"),
        (BALL_CENTRE - np.array([0, 1.5, 0]), (0, 1, 0), 1.5 - BALL_RADIUS, "mirror_ball"),
        ((0.0, -0.6, 2.3), (0, 0.45, -1.56), np.hypot(0.45, 1.56), "table"),
        ((1.22, 0.0, 1.12), (0, 1, 0), None, "wire"),
    ],
)
def test_rays_hit_what_they_should_where_they_should(origin, direction, distance, material):
    t, primitive, normal, _ = shoot(origin, direction)
    assert material_of(primitive) == material
    if distance is not None:
        assert t == pytest.approx(distance, abs=1e-9)
    assert normal @ np.asarray(direction, float) < 0.0


def test_an_offset_ray_meets_the_sphere_at_the_quadratics_root():
    offset = 0.11
    t, _, normal, _ = shoot(BALL_CENTRE + np.array([offset, -1.5, 0.0]), (0, 1, 0))
    half_chord = np.sqrt(BALL_RADIUS**2 - offset**2)
    assert t == pytest.approx(1.5 - half_chord, abs=1e-9)
    np.testing.assert_allclose(normal, np.array([offset, -half_chord, 0]) / BALL_RADIUS, atol=1e-9)


def test_a_ray_leaves_through_the_window_only():
    t, primitive, _, _ = shoot((0.2, 2.0, 1.5), (0, 1, 0.9))
    assert primitive == MISS
    assert t == np.inf
    beside = shoot((WINDOW[0] + 0.3, 2.0, 1.5), (0, 1, 0))
    assert material_of(beside[1]) == "plaster"
    assert beside[0] == pytest.approx(HALF - 2.0, abs=1e-9)


def test_depth_is_z_of_the_pixel_centre_and_infinite_in_the_sky():
    rotation, translation = look_at(np.array([0.0, -1.0, 2.3]), np.array([-0.8, -2.3, 2.3]), UP)
    camera = Camera(rotation, translation, 40.0, 40.0, 12.0, 8.0, 24, 16)
    depth = render_reference(camera, samples=1)[1]
    row, column = np.indices(depth.shape)
    ray = camera_rays(camera, column.ravel() + 0.5, row.ravel() + 0.5)
    reach = ((-HALF - camera.position[1]) / ray[:, 1])[:, None] * ray
    at = camera.position + reach
    wall = (reach @ rotation[2]).reshape(depth.shape)
    on_wall = ((at[:, 2] < HEIGHT) & (at[:, 2] > 2.05) & (at[:, 0] > -HALF)).reshape(depth.shape)  # above the poster
    assert on_wall.mean() > 0.4
    np.testing.assert_allclose(depth[on_wall], wall[on_wall], rtol=1e-6)
    rotation, translation = look_at(np.array([0.2, 1.9, 1.5]), np.array([0.2, 2.9, 2.2]), UP)
    assert np.isinf(render_reference(Camera(rotation, translation, 40.0, 40.0, 4.0, 4.0, 8, 8), 1)[1]).any()


def test_images_are_in_range_and_more_samples_converge():
    camera = embedded_cameras(48, 48)[0]
    fine = render_reference(camera, 32)[0]
    assert fine.dtype == np.float32
    assert fine.min() >= 0.0
    assert fine.max() <= 1.0
    assert fine.std() > 0.1
    errors = [np.mean((render_reference(camera, samples)[0] - fine) ** 2) for samples in (1, 4, 16)]
    assert errors[0] > errors[1] > errors[2]


def test_diffuse_points_look_alike_from_two_views_and_the_mirror_does_not():
    cameras = embedded_cameras()
    points, _, normals = surface_points(1500, 1)
    world = embedded_world()
    seen = []
    for camera in (cameras[2], cameras[5]):
        offset = points - camera.position
        length = np.linalg.norm(offset, axis=1)
        origin = np.broadcast_to(camera.position, points.shape)
        distance, primitive, _, colour = trace(world, origin, offset / length[:, None])
        seen.append((np.abs(distance - length) < 1e-6, primitive, colour))
    both = seen[0][0] & seen[1][0] & (seen[0][1] == seen[1][1])
    material = world.material[seen[0][1]]
    glossy = (world.mirror[material] > 0) | (world.shine[material] > 0)
    difference = np.abs(seen[0][2] - seen[1][2]).max(axis=1)
    assert (both & ~glossy).sum() > 300
    # A few points lie within rounding of a texture's or a shadow's edge, where the colour jumps.
    assert np.quantile(difference[both & ~glossy], 0.98) < 1e-6
    assert np.median(difference[both & glossy]) > 0.02
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_surface_points_lie_on_surfaces():
    points, colours, normals = surface_points(400, 2)
    assert points.shape == colours.shape == normals.shape == (400, 3)
    start = points + 1e-3 * normals
    distance, primitive, found, _ = trace(embedded_world(), start, -normals)
    assert (primitive != MISS).all()
    # Where two surfaces meet, the probe may start behind the other one.
    assert np.mean(np.abs(distance - 1e-3) < 1e-7) > 0.98
    assert np.quantile(np.einsum("ij,ij->i", found, normals), 0.05) > 0.999
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0


def test_model_is_valid(model):
    assert 0.95 * COUNT <= len(model) <= COUNT
    for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest"):
        assert np.isfinite(getattr(model, name)).all(), name
    np.testing.assert_allclose(np.linalg.norm(model.quats, axis=1), 1.0, atol=1e-12)
    assert model.opacity.min() > 0.0
    assert model.opacity.max() < 1.0
    assert model.levels == 1
    assert model.sh_degree == 3
    assert (model.quality_bound == 1).all()
    glossy = np.abs(model.sh_rest).max(axis=(1, 2)) > 0.01
    assert 0.01 < glossy.mean() < 0.3
    assert np.mean(np.linalg.norm(model.means[glossy] - BALL_CENTRE, axis=1) < BALL_RADIUS + 0.01) > 0.5
    anisotropy = np.exp(model.log_scales.max(axis=1) - np.sort(model.log_scales, axis=1)[:, 1])
    assert (anisotropy > 5.0).sum() > 30, "needles on wires"
    assert (np.linalg.norm(model.means, axis=1) > 20.0).sum() > 20, "a far background"


def test_model_looks_like_the_scene(model):
    for camera in (embedded_cameras(128, 128)[k] for k in (0, 8)):
        frame = render(model, camera)
        assert psnr(frame.image, render_reference(camera)[0]) > 16.0
        assert frame.transmittance.mean() < 0.15


def test_harmonics_bring_the_mirror_nearer_to_the_truth(model):
    camera = embedded_cameras(128, 128)[0]
    centre = camera.rotation @ BALL_CENTRE + camera.translation
    x, y = camera.fx * centre[0] / centre[2] + camera.cx, camera.fy * centre[1] / centre[2] + camera.cy
    window = np.s_[int(y) - 7 : int(y) + 8, int(x) - 7 : int(x) + 8]
    truth = render_reference(camera)[0][window]
    full, flat = (render(each, camera).image[window] for each in (model, model.with_sh_degree(0)))
    assert psnr(full, truth) > psnr(flat, truth) + 0.5


def test_cache_returns_the_model_and_survives_a_broken_file(model, tmp_path, monkeypatch):
    first = cached_embedded_model(COUNT, 3, folder=tmp_path)
    (path,) = tmp_path.iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(splats, "embedded_model", lambda *_: pytest.fail("the cache was not used"))
        stored = cached_embedded_model(COUNT, 3, folder=tmp_path)
    for field in fields(model):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(model, field.name))
        np.testing.assert_array_equal(getattr(stored, field.name), getattr(model, field.name))
    path.write_bytes(path.read_bytes()[:500])
    monkeypatch.setattr(splats, "embedded_model", lambda *_: model)
    assert len(cached_embedded_model(COUNT, 3, folder=tmp_path)) == len(model)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_size > 500


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: embedded_cameras(views=0), "not 0"),
        (lambda: render_reference(embedded_cameras(8, 8)[0], 0), "not 0"),
        (lambda: surface_points(0), "not 0"),
        (lambda: embedded_model(0), "not 0"),
        (lambda: embedded_model(10, sh_degree=4), "not 4"),
    ],
)
def test_bad_parameters_are_named(call, message):
    with pytest.raises(ValueError, match=f"{message}$"):
        call()
