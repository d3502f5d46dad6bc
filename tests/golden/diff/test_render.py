"""The differentiable renderer: images against the float64 oracle, usage against brute force, refusals, sameness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians, from_model, to_model  # noqa: E402
from golden.diff.render import render, render_foveated  # noqa: E402
from golden.oracle.project import project as project_oracle  # noqa: E402
from golden.oracle.render import render as render_oracle  # noqa: E402
from golden.oracle.tiles import tile_lists as oracle_lists  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras  # noqa: E402
from golden.scenes.gaze import Display, foveation_map, no_foveation  # noqa: E402
from golden.scenes.levels import smfr_levels  # noqa: E402
from spec.constants import ALPHA_MIN, T_STOP, TILE  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.helpers.training_dense_compositor import dense_render  # noqa: E402
from tests.helpers.training_scenes import (  # noqa: E402
    BACKGROUND,
    CAMERA,
    gradients,
    images,
    random_gaussians,
    random_loss,
    single,
    tilted_camera,
    trainable,
)

UP = np.array([0.0, -1.0, 0.0])


def check_image(ours, theirs, *, common=2e-5, flips=1e-3):
    """All but a share `flips` of the values within `common` of float64; those others are pixels at a footprint's edge, where an
    alpha of 1/255 is in one image and not in the other."""
    error = np.abs(ours.detach().numpy() - theirs)
    scale = max(1.0, np.abs(theirs).max())
    assert np.mean(error > common * scale) <= flips
    assert error.max() <= 2 * ALPHA_MIN * scale


@pytest.mark.parametrize("camera", [CAMERA, tilted_camera(), CAMERA.resized(16, 16), CAMERA.resized(1, 1)])
@pytest.mark.parametrize(("alpha_max", "support"), [(0.99, 3.0), (1.0, 3.0), (0.99, None)])
def test_images_are_the_oracles(camera, alpha_max, support):
    gaussians = random_gaussians(150, seed=3)
    ours = render(gaussians, camera, alpha_max=alpha_max, background=BACKGROUND, support_sigma=support)
    theirs = render_oracle(to_model(gaussians, up=UP, name="random"), camera, background=BACKGROUND, support_sigma=support,
                           alpha_max=(alpha_max,))
    check_image(ours.image, theirs.image)
    check_image(ours.transmittance, theirs.transmittance)
    covered = theirs.coverage >= 0.5
    check_image(ours.depth_sum[covered], theirs.depth[covered] * theirs.coverage[covered])
    assert ours.entries == theirs.entries
    assert len(ours.index) == theirs.visible + theirs.culled["no_tile"]


@pytest.mark.parametrize("size", [(160, 120), (131, 97)])
def test_embedded_scene_is_the_oracles(size):
    model, camera = cached_embedded_model(), embedded_cameras()[3].resized(*size)
    ours = render(from_model(model), camera)
    theirs = render_oracle(model, camera)
    check_image(ours.image, theirs.image)
    check_image(ours.transmittance, theirs.transmittance)
    assert abs(ours.entries - theirs.entries) <= 1e-4 * theirs.entries


@pytest.fixture(scope="module")
def levelled():
    """The embedded scene with four levels, farther ones amplified, as a model and as Gaussians a level."""
    model = smfr_levels(cached_embedded_model(), seed=0)
    amplify = np.array([1.0, 1.2, 1.5, 2.0])
    model = replace(model, opacity=model.opacity * amplify, sh_dc=model.sh_dc + 0.05 * np.arange(4)[None, :, None])
    levels = []
    for k in range(4):
        rows = model.quality_bound > k
        shown = replace(model.select(rows), opacity=model.opacity[rows][:, k : k + 1], sh_dc=model.sh_dc[rows][:, k : k + 1],
                        quality_bound=np.ones(rows.sum(), np.uint8))
        levels.append(from_model(shown))
    return model, levels


@pytest.mark.parametrize(("gaze", "count"), [((40.0, 70.0), 4), ((150.0, 100.0), 4), ((75.0, 50.0), 2)])
def test_foveated_image_is_the_oracles(levelled, gaze, count):
    model, levels = levelled
    camera = embedded_cameras()[0].resized(150, 104)
    foveation = foveation_map(Display(150, 104), gaze, count)
    ours = render_foveated(levels[:count], camera, foveation, background=BACKGROUND)
    check_image(ours, render_oracle(model, camera, foveation=foveation, background=BACKGROUND).image)


def test_foveated_without_a_gaze_is_level_1(levelled):
    camera = embedded_cameras()[0].resized(70, 50)
    ours = render_foveated(levelled[1], camera, no_foveation(Display(70, 50)))
    assert torch.equal(ours, render(levelled[1][0], camera).image)


def test_foveated_gradients_reach_each_level_where_it_shows():
    camera = CAMERA.resized(96, 64)
    foveation = foveation_map(Display(96, 64), (0.0, 32.0))
    levels = [random_gaussians(40, seed) for seed in range(4)]
    shares = []
    for k in range(4):
        expanded = [tiles.repeat(TILE, 0).repeat(TILE, 1)[:64, :96] for tiles in (
            foveation.tile_level == k, foveation.blend & (foveation.tile_level == k - 1))]
        farther = foveation.blend_weights_exact
        shares.append(torch.from_numpy(expanded[0] * (1 - farther) + expanded[1] * farther)[..., None])
    alpha_max = (0.99, 1.0, 1.0, 1.0)
    trained, dense = [trainable(level) for level in levels], [trainable(level) for level in levels]
    ours = render_foveated(trained, camera, foveation, background=BACKGROUND)
    drawn = [dense_render(g, camera, a, BACKGROUND)[0] for g, a in zip(dense, alpha_max, strict=True)]
    theirs = sum(share * image for share, image in zip(shares, drawn, strict=True))
    assert (ours - theirs).abs().max() < 2e-5
    random_loss([ours], 5).backward()
    random_loss([theirs], 5).backward()
    for level, expected in zip(trained, dense, strict=True):
        for name, tensor in level.tensors().items():
            reference = getattr(expected, name).grad
            assert (tensor.grad - reference).abs().max() <= 2e-5 * max(1e-3, float(reference.abs().max())), name


def test_usage_is_brute_forces():
    gaussians = random_gaussians(80, seed=9)
    gaussians.opacity += 2  # so that tiles stop
    camera = CAMERA.resized(60, 45)
    shown = render(gaussians, camera, usage=True)
    _, _, _, shares = dense_render(gaussians, camera, 0.99, (0, 0, 0))
    weight = shares.sum((0, 1))[shown.index]
    assert (shown.weight - weight).abs().max() <= 1e-5 * weight.max()
    largest, strongest = shares.max(-1)
    counts = torch.bincount(strongest[largest > 0], minlength=80)[shown.index]
    assert torch.equal(shown.dominated.long(), counts)
    assert shown.dominated.sum() == (largest > 0).sum()
    assert shown.dominated.dtype == shown.tiles.dtype == torch.int32


def test_tiles_count_until_the_whole_tile_stops():
    gaussians = random_gaussians(300, seed=10)
    gaussians.opacity += 3
    gaussians.log_scales += 0.5
    camera = CAMERA.resized(60, 45)
    shown = render(gaussians, camera)
    splats, _ = project_oracle(to_model(gaussians, up=UP, name="random"), camera, 3.0)
    lists = oracle_lists(splats, no_foveation(Display(60, 45)))
    shares = dense_render(gaussians, camera, 0.99, (0, 0, 0))[3]
    expected, stopped = np.zeros(len(splats), int), 0
    for tile in range(len(lists.start) - 1):
        y, x = TILE * (tile // 4), TILE * (tile % 4)
        light = np.ones((min(TILE, 45 - y), min(TILE, 60 - x)))
        for i in lists.entries[lists.start[tile] : lists.start[tile + 1]]:
            if light.max() < T_STOP:
                stopped += 1
                break
            expected[i] += 1
            light = light - shares[y : y + TILE, x : x + TILE, splats.index[i]].numpy()
    assert stopped >= 3
    assert np.array_equal(shown.index.numpy(), splats.index)
    assert np.array_equal(shown.tiles.numpy(), expected)


def test_masked_tiles_show_the_background():
    gaussians, camera = random_gaussians(80, seed=2), CAMERA
    mask = np.zeros((3, 4), bool)
    mask[1, 2] = mask[2, 0] = True
    pixels = torch.from_numpy(mask.repeat(TILE, 0).repeat(TILE, 1)[: camera.height, : camera.width])
    full = render(gaussians, camera, background=BACKGROUND)
    part = render(gaussians, camera, background=BACKGROUND, tile_mask=mask)
    assert torch.equal(part.image[pixels], full.image[pixels])
    assert torch.equal(part.image[~pixels], torch.tensor(BACKGROUND).expand(int((~pixels).sum()), 3))
    assert (part.transmittance[~pixels] == 1).all() and (part.depth_sum[~pixels] == 0).all()
    assert part.entries < full.entries

    def inside(tile_mask):
        return lambda g: [image[pixels] for image in images(render(g, camera, background=BACKGROUND, tile_mask=tile_mask))]

    for masked, whole in zip(gradients(gaussians, inside(mask)).values(), gradients(gaussians, inside(None)).values(),
                             strict=True):
        assert torch.equal(masked, whole)
    assert torch.equal(render(gaussians, camera, background=BACKGROUND, tile_mask=torch.from_numpy(mask)).image, part.image)


def test_same_bits_every_time_and_for_any_number_of_threads():
    model, camera = cached_embedded_model(), embedded_cameras()[1].resized(120, 90)
    gaussians, threads, results = from_model(model), torch.get_num_threads(), []
    try:
        for count in (1, 2, 2, 3):
            torch.set_num_threads(count)
            trained = trainable(gaussians)
            shown = render(trained, camera, usage=True)
            random_loss(images(shown), 4).backward()
            results.append([*images(shown), shown.mean2d.grad, shown.weight, shown.dominated, shown.tiles,
                            *(tensor.grad for tensor in trained.tensors().values())])
    finally:
        torch.set_num_threads(threads)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_rendering_describes_the_projected():
    gaussians = single(means=[[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [90.0, 0.0, 2.0]], log_scales=[[-2.0, -2.0, -2.0]])
    shown = render(trainable(gaussians), CAMERA)
    assert shown.index.tolist() == [0]
    assert shown.mean2d.tolist() == [[25.0, 18.0]]
    sigma = np.sqrt((42 * np.exp(-2) / 2) ** 2 + 0.3)
    assert shown.radius[0] == pytest.approx(3 * sigma, rel=1e-5)
    assert shown.dominated is None and shown.weight is None
    shown.image.sum().backward()
    assert shown.mean2d.grad.shape == (1, 2)
    assert shown.image.dtype == shown.depth_sum.dtype == shown.transmittance.dtype == torch.float32


BAD = {
    "sh_rest must be": {"sh_rest": torch.zeros(1, 4, 3)},
    "quats must have shape": {"quats": torch.ones(1, 3)},
    "opacity must have shape": {"opacity": torch.zeros(2)},
    "means must be float32": {"means": torch.zeros(1, 3, dtype=torch.float64)},
}


@pytest.mark.parametrize("message", BAD)
def test_malformed_gaussians_are_refused(message):
    with pytest.raises((TypeError, ValueError), match=message):
        render(Gaussians(**(single().tensors() | BAD[message])), CAMERA)


@pytest.mark.parametrize(("settings", "message"), [
    ({"alpha_max": 1.5}, "alpha_max"), ({"alpha_max": 0.0}, "alpha_max"), ({"alpha_max": float("nan")}, "alpha_max"),
    ({"background": (0, 0)}, "background"), ({"background": (0, 0, float("inf"))}, "background"),
    ({"support_sigma": 0.0}, "support_sigma"), ({"support_sigma": float("nan")}, "support_sigma"),
    ({"tile_mask": np.ones((3, 3), bool)}, r"tile_mask must have shape \(3, 4\)"),
    ({"tile_mask": np.ones((3, 4))}, "must be bool"),
])
def test_malformed_settings_are_refused(settings, message):
    with pytest.raises((TypeError, ValueError), match=message):
        render(single(), CAMERA, **settings)


def test_malformed_frames_are_refused():
    with pytest.raises(ValueError, match="0x37"):
        render(single(), replace(CAMERA, width=0))
    foveation = foveation_map(Display(53, 37), (1, 1))
    with pytest.raises(InputError, match="4 levels"):
        render_foveated([single()] * 3, CAMERA, foveation)
    with pytest.raises(InputError, match="53x37"):
        render_foveated([single()] * 4, CAMERA.resized(54, 37), foveation)
    with pytest.raises(InputError, match="8 pixels"):
        render_foveated([single()] * 4, CAMERA, foveation_map(Display(53, 37), (1, 1), tile=8))
