"""Mini-Splatting's densification: what pixels show, where their rays meet it, blur split, and dense training with both."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.render import render  # noqa: E402
from golden.diff.strongest import strongest  # noqa: E402
from golden.training.dense import DenseOptions, DenseStage  # noqa: E402
from golden.training.densify import densify  # noqa: E402
from golden.training.minisplatting import LargestAreas, chord_centres, pixel_rays, reinitialised  # noqa: E402
from golden.training.optimiser import RATES, Optimiser  # noqa: E402
from tests.helpers.training_dense_compositor import dense_render  # noqa: E402
from tests.helpers.training_samples import (  # noqa: E402
    forward_camera,
    guarded,
    round_gaussians,
    same,
    small_dense,
    small_scene,
)

OPTIONS = DenseOptions(iterations=60, max_points=900, densify_every=5, blurred=2e-4, reinitialised=(0.2, 0.4))


@pytest.fixture(scope="module")
def scene():
    return guarded(small_scene())


def test_the_strongest_is_the_one_with_the_largest_share(scene):
    """Against every share of every pixel in float64; where two are equal within rounding, either may be it."""
    model, camera = small_dense(150), scene.cameras[scene.train[0]].resized(40, 24)
    row, opacity = strongest(model, camera)
    _, _, light, shares = dense_render(model, camera, 0.99, (0.0, 0.0, 0.0))
    largest = shares.max(dim=-1).values.numpy()
    assert row.shape == (24, 40) and np.allclose(opacity, 1 - light.numpy(), atol=1e-5)
    assert ((row < 0) == (largest == 0)).all() and (row >= 0).mean() > 0.3
    found = np.take_along_axis(shares.numpy(), np.maximum(row, 0)[..., None], -1)[..., 0]
    assert np.allclose(found, largest, atol=1e-5)


def test_the_largest_area_of_any_view_counts():
    gaussians = round_gaussians([(16.0, 16.0, 2.0, 4.0, 0.9), (48.0, 48.0, 2.0, 1.0, 0.9)])
    areas = LargestAreas(2)
    for camera in (forward_camera(cx=200.0), forward_camera(), forward_camera(cx=40.0)):
        areas.observe(render(gaussians, camera, usage=True))
    dominated = [render(gaussians, camera, usage=True).dominated for camera in (forward_camera(), forward_camera(cx=40.0))]
    assert areas.share.tolist() == pytest.approx((torch.stack(dominated).amax(0) / 64**2).tolist()) and areas.share.min() > 0


def test_a_chords_centre_is_where_the_density_is_largest():
    """Along each ray, no point near it has a smaller Mahalanobis distance, which is computed here from the covariance."""
    model = small_dense(40)
    origin = torch.tensor([0.3, -2.0, 1.0])
    directions = model.means - origin + 0.2 * torch.randn(len(model), 3, generator=torch.Generator().manual_seed(1))
    centres = chord_centres(model, origin, directions)
    t = ((centres - origin) / directions)[:, :1]
    assert torch.allclose(origin + t * directions, centres, atol=1e-4)

    def distances(points):
        w, x, y, z = torch.nn.functional.normalize(model.quats.double(), dim=1).unbind(1)
        rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z),
                1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
        axes = torch.stack(rows, 1).reshape(-1, 3, 3) * torch.exp(model.log_scales.double())[:, None]
        covariance, offset = axes @ axes.transpose(1, 2), points.double() - model.means.double()
        return torch.einsum("ni,ni->n", offset, torch.linalg.solve(covariance, offset))

    least = distances(centres)
    for step in (-0.01, 0.01):
        assert (distances(centres + step * directions) > least).all()


def test_rays_go_through_pixel_centres(scene):
    camera = scene.cameras[scene.train[2]]
    origin, directions = pixel_rays(camera)
    point = (origin + 3.0 * directions) @ camera.rotation.T + camera.translation
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    assert np.allclose(point[..., 0] / point[..., 2] * camera.fx + camera.cx, columns)
    assert np.allclose(point[..., 1] / point[..., 2] * camera.fy + camera.cy, rows) and np.allclose(point[..., 2], 3.0)


def test_new_gaussians_are_at_what_pixels_show_in_their_colours():
    """Of red photographs all are red, and near a Gaussian of before; where masks hide pixels, none is."""
    scene = small_scene()
    red = np.zeros_like(scene.images)
    red[..., 0] = 255
    model = small_dense()
    made = reinitialised(model, replace(scene, images=red), 300, seed=1, counter=2)
    again = reinitialised(model, replace(scene, images=red), 300, seed=1, counter=2)
    other = reinitialised(model, replace(scene, images=red), 300, seed=1, counter=3)
    assert same(made, again) and not same(made, other) and 250 < len(made) <= 300
    colour = render(made, scene.cameras[scene.train[0]]).image
    assert float(colour[..., 0].max()) > 0.3 and float(colour[..., 1:].max()) < 1e-5
    near = torch.cdist(made.means, model.means).amin(dim=1)
    assert float(near.median()) < 0.2 * scene.extent
    hidden = replace(scene, images=red, masks=np.zeros(scene.images.shape[:3], bool))
    hidden.masks[:, :8] = True
    camera = scene.cameras[scene.train[0]]
    shown = reinitialised(model, replace(hidden, train=scene.train[:1]), 50, seed=1, counter=2)
    point = shown.means.double().numpy() @ camera.rotation.T + camera.translation
    assert (point[:, 1] / point[:, 2] * camera.fy + camera.cy < 8.01).all()


def test_blurred_gaussians_are_split_whatever_their_size():
    """The largest first, with at most half of the budget; the rest goes to gradients, as without."""
    gaussians = round_gaussians([(10.0 + 4 * i, 20.0, 2.0, 2.0, 0.9) for i in range(8)])
    blurred = torch.tensor([0.0, 0.3, 0, 0.5, 0.4, 0, 0, 0])
    gradient = torch.tensor([5.0, 9.0, 1.0, 0.0, 0.0, 3.0, 2.0, 1.0])

    def result(**more):
        optimiser = Optimiser(gaussians, RATES)
        added = densify(optimiser, gradient, threshold=1.5, budget=4, small=1e9, random=np.random.default_rng(0), **more)
        return added, optimiser.gaussians

    added, left = result(blurred=blurred)
    assert added == 4 and len(left) == 12
    split = [row for row in (3, 4) if not (left.means == gaussians.means[row]).all(dim=1).any()]
    assert split == [3, 4]  # the two largest, half of four
    doubled = [row for row in range(8) if (left.means == gaussians.means[row]).all(dim=1).sum() == 2]
    assert doubled == [0, 1]  # the two largest gradients of the others are cloned, as they are small
    added, plain = result()
    doubled = [row for row in range(8) if (plain.means == gaussians.means[row]).all(dim=1).sum() == 2]
    assert added == 4 and doubled == [0, 1, 5, 6]


def test_dense_training_replaces_all_and_a_resumed_run_is_the_uninterrupted_one():
    scene = small_scene()
    stage = DenseStage(scene, OPTIONS, seed=2)
    records, fresh = [], []
    while not stage.finished:
        records.append(stage.step())
        opacity = torch.sigmoid(stage.gaussians.opacity.detach())
        fresh += [stage.done] if torch.allclose(opacity, torch.tensor(0.1)) else []
    assert fresh == [12, 24]
    assert records[-1]["psnr"] > records[0]["psnr"] and len(stage.result()) <= 900
    for stop in (9, 25):
        first, second = (DenseStage(scene, OPTIONS, seed=2) for _ in range(2))
        while first.done < stop:
            first.step()
        second.load(first.state())
        while not second.finished:
            second.step()
        assert same(second.result(), stage.result())


@pytest.mark.parametrize(("changes", "told"), [({"blurred": 0.0}, "blurred"), ({"reinitialised": (1.0,)}, "reinitialised")])
def test_options_refuse(changes, told):
    with pytest.raises(ValueError, match=told):
        replace(OPTIONS, **changes)
